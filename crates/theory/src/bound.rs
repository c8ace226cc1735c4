//! The Cramér–Rao bound of the contacts that one frame shows.
//!
//! Problem: which error of place and force must every estimator without bias make? Method: inverse of the Fisher information (S. M. Kay,
//! *Fundamentals of Statistical Signal Processing* I, 3.9) by the singular values of the whitened derivatives. Assumptions: Gaussian
//! noise of constant variance, independent from channel to channel; one frame. Cost: one Jacobian of the model, and a decomposition of
//! channels × unknowns.

use dermis_model::{Differences, ForwardModel, Stimulus, Unknown, Unknowns, Untouched};
use nalgebra::DMatrix;
use serde::Serialize;

use crate::TheoryError;

/// \[m\] and \[N\] that are of the same order in touch: the scale on which unknowns are compared.
const SCALE: (f64, f64) = (1e-3, 1.0);
/// Singular values below this share of the largest count as 0: the channels do not determine what they stand for.
const BLIND: f64 = 1e-9;

/// Least standard deviations that an estimator without bias can have for one contact, from one frame. Infinite where the
/// channels do not determine the quantity at all.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ContactBound {
    /// \[m\] root of the sum of both variances along the surface.
    pub position: f64,
    /// \[m\] along both directions of the surface; on a flat one x and y. The second is 0 along a line.
    pub along: [f64; 2],
    /// \[N\] of the pressing force.
    pub normal_force: f64,
    /// \[N\] root of the sum of both variances along the surface; `None` where shear is not an unknown.
    pub shear: Option<f64>,
}

/// Least standard deviations of all contacts of a stimulus, in their order, when all of them are estimated from the same
/// frame: the inverse of the Fisher information JᵀR⁻¹J, with the derivatives J of the model by every unknown and the
/// variances R of the channels (S. M. Kay, *Fundamentals of Statistical Signal Processing* I, 3.9, Gaussian noise of
/// constant variance).
///
/// # Errors
///
/// [`TheoryError::Model`] where the model has no answer near the stimulus, [`TheoryError::Noise`] where a channel has no
/// noise.
pub fn cramer_rao(
    model: &dyn ForwardModel,
    stimulus: &Stimulus,
    unknowns: Unknowns,
) -> Result<Vec<ContactBound>, TheoryError> {
    Ok(bounds(&derivatives(model, stimulus, unknowns)?, unknowns))
}

/// The bounds that derivatives give.
pub(crate) fn bounds(derivatives: &Derivatives, unknowns: Unknowns) -> Vec<ContactBound> {
    let list = unknowns.list();
    let per_contact = list.len();
    let variances = variances(derivatives);
    variances
        .chunks_exact(per_contact)
        .map(|v| {
            let root = |of: fn(&Unknown) -> bool| {
                list.iter().zip(v).filter(|(unknown, _)| of(unknown)).map(|(_, v)| v).sum::<f64>().sqrt()
            };
            ContactBound {
                position: root(|u| matches!(u, Unknown::Along(_))),
                along: [root(|u| *u == Unknown::Along(0)), root(|u| *u == Unknown::Along(1))],
                normal_force: root(|u| *u == Unknown::Pressing),
                shear: (unknowns == Unknowns::Full).then(|| root(|u| matches!(u, Unknown::Shear(_)))),
            }
        })
        .collect()
}

/// Derivatives of every channel by every unknown of every contact, in units of the channel's noise and of the unknown's
/// scale; and the scales.
pub(crate) struct Derivatives {
    whitened: DMatrix<f64>,
    scales: Vec<f64>,
}

pub(crate) fn derivatives(
    model: &dyn ForwardModel,
    stimulus: &Stimulus,
    unknowns: Unknowns,
) -> Result<Derivatives, TheoryError> {
    let noise = model.noise();
    if let Some((channel, &noise)) = noise.iter().enumerate().find(|(_, n)| !(n.is_finite() && **n > 0.0)) {
        return Err(TheoryError::Noise { channel, noise });
    }
    let list = unknowns.list();
    let per_contact = list.len();
    let channels = noise.len();
    let columns = per_contact * stimulus.contacts.len();
    let mut jacobian = vec![0.0; channels * columns];
    model.jacobian(stimulus, unknowns, &Differences::default(), &mut jacobian)?;
    let mut whitened = DMatrix::from_vec(channels, columns, jacobian);
    let mut scales = Vec::with_capacity(columns);
    for (mut column, unknown) in whitened.column_iter_mut().zip(list.iter().cycle()) {
        let scale = if matches!(unknown, Unknown::Along(_)) { SCALE.0 } else { SCALE.1 };
        scales.push(scale);
        column.iter_mut().zip(noise).for_each(|(slope, sigma)| *slope *= scale / sigma);
    }
    Ok(Derivatives { whitened, scales })
}

/// What the bands of the isolines of as many channels as there are unknowns leave open of a contact, to first order: half
/// of the box around the volume in which all of them overlap (thesis 5.4; along a line 5.14). The channels are those whose
/// signal is largest, three on a surface.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct BandBox {
    /// \[m\] along both directions of the surface; the second is 0 along a line. Infinite where the bands do not close.
    pub along: [f64; 2],
    /// \[N\] of the pressing force.
    pub normal_force: f64,
}

/// The box of a stimulus with one contact.
///
/// # Errors
///
/// As [`cramer_rao`].
pub fn strongest_bands(
    model: &dyn ForwardModel,
    stimulus: &Stimulus,
    unknowns: Unknowns,
) -> Result<BandBox, TheoryError> {
    let derivatives = derivatives(model, stimulus, unknowns)?;
    let mut signal = vec![0.0; model.channels()];
    model.response(stimulus, &mut signal)?;
    Untouched::of(model)?.subtract(&mut signal);
    Ok(bands(&derivatives, &signal, unknowns))
}

/// The box that derivatives and a signal give.
pub(crate) fn bands(derivatives: &Derivatives, signal: &[f64], unknowns: Unknowns) -> BandBox {
    let Derivatives { whitened, scales } = derivatives;
    let mut order: Vec<usize> = (0..signal.len()).collect();
    order.sort_by(|a, b| signal[*b].total_cmp(&signal[*a]));
    order.truncate(scales.len());
    let enough = order.len() == scales.len();
    let inverse = enough.then(|| whitened.select_rows(&order).try_inverse()).flatten();
    let half = |unknown: Unknown| {
        let Some(k) = unknowns.list().iter().position(|u| *u == unknown) else { return 0.0 };
        // The farthest corner: every band's end pushes the same way.
        inverse.as_ref().map_or(f64::INFINITY, |m| m.row(k).iter().map(|v| v.abs()).sum::<f64>() * scales[k])
    };
    BandBox {
        along: [half(Unknown::Along(0)), half(Unknown::Along(1))],
        normal_force: half(Unknown::Pressing),
    }
}

/// Variances of all unknowns from their whitened and scaled derivatives.
fn variances(derivatives: &Derivatives) -> Vec<f64> {
    let scales = &derivatives.scales;
    let svd = derivatives.whitened.clone().svd(false, true);
    let Some(v) = svd.v_t else { return vec![f64::INFINITY; scales.len()] };
    let largest = svd.singular_values.iter().copied().fold(0.0, f64::max);
    scales
        .iter()
        .enumerate()
        .map(|(k, scale)| {
            let mut seen = 0.0;
            let mut sum = 0.0;
            for (j, s) in svd.singular_values.iter().enumerate() {
                if *s > BLIND * largest {
                    seen += v[(j, k)] * v[(j, k)];
                    sum += (v[(j, k)] / s).powi(2);
                }
            }
            // What lies in directions that no channel determines is unbounded.
            if seen < 1.0 - 1e-9 { f64::INFINITY } else { sum * scale * scale }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use nalgebra::{Point3, Vector3};
    use proptest::prelude::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    use dermis_fixtures::Analytic;
    use dermis_model::{Indentation, TipShape};

    use super::*;
    use crate::over_surface_and_bands;
    use crate::testing::{DEPTH, grid, row, shifted, toy};

    fn press(x: f64, y: f64, newtons: f64) -> Indentation {
        Indentation::sphere(Point3::new(x, y, 0.0), Vector3::new(0.0, 0.0, -newtons), 0.004)
    }

    fn one(model: &Analytic, contact: Indentation) -> ContactBound {
        let stimulus = Stimulus { contacts: vec![contact], ..Stimulus::default() };
        cramer_rao(model, &stimulus, Unknowns::Normal).unwrap()[0]
    }

    #[test]
    fn it_is_what_a_known_case_gives() {
        // Above the middle of the grid position and force decouple by symmetry; the derivatives are written down.
        let model = grid();
        let (force, mut by_x, mut by_force) = (0.7, 0.0, 0.0);
        for element in &model.elements {
            let (x, y) = (element.at.x, element.at.y);
            let r = x * x + y * y + DEPTH * DEPTH;
            by_x += (force * DEPTH * 2.0 * x / (r * r) / 2.0).powi(2);
            by_force += (DEPTH / r / 2.0).powi(2);
        }
        let bound = one(&model, press(0.0, 0.0, force));
        approx::assert_relative_eq!(bound.position, (2.0 / by_x).sqrt(), max_relative = 1e-4);
        approx::assert_relative_eq!(bound.normal_force, (1.0 / by_force).sqrt(), max_relative = 1e-6);
        assert_eq!(bound.shear, None);
    }

    #[test]
    fn least_squares_reaches_it_where_the_noise_is_small() {
        // Gauss–Newton from the truth, on a thousand noisy frames.
        let mut model = grid();
        model.noise.fill(0.05);
        let (truth, steps) = ([0.002, -0.003, 0.8], 4);
        let bound = one(&model, press(truth[0], truth[1], truth[2]));
        let read = |p: &[f64; 3]| model.read(&[press(p[0], p[1], p[2])]);
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(3);
        let (mut position, mut force) = (0.0, 0.0);
        let frames = 1000;
        for _ in 0..frames {
            let noisy: Vec<f64> = read(&truth)
                .iter()
                .map(|v| {
                    let noise: f64 = StandardNormal.sample(&mut random);
                    v + 0.05 * noise
                })
                .collect();
            let mut p = truth;
            for _ in 0..steps {
                let now = read(&p);
                let jacobian = DMatrix::from_fn(9, 3, |i, k| {
                    let h = if k < 2 { 1e-6 } else { 1e-5 };
                    let (mut a, mut b) = (p, p);
                    a[k] += h;
                    b[k] -= h;
                    (read(&a)[i] - read(&b)[i]) / (2.0 * h)
                });
                let residual = DMatrix::from_fn(9, 1, |i, _| noisy[i] - now[i]);
                let step = jacobian.svd(true, true).solve(&residual, 0.0).unwrap();
                (0..3).for_each(|k| p[k] += step[k]);
            }
            position += (p[0] - truth[0]).powi(2) + (p[1] - truth[1]).powi(2);
            force += (p[2] - truth[2]).powi(2);
        }
        let (position, force) = ((position / f64::from(frames)).sqrt(), (force / f64::from(frames)).sqrt());
        approx::assert_relative_eq!(position, bound.position, max_relative = 0.08);
        approx::assert_relative_eq!(force, bound.normal_force, max_relative = 0.08);
    }

    #[test]
    fn bands_of_the_strongest_hold_what_the_bound_does() {
        let stimulus = |x, y| Stimulus { contacts: vec![press(x, y, 0.7)], ..Stimulus::default() };
        // On a line the box is the closed form: F = S (h + d²/h), as of two taxels.
        let row = row(2);
        let found = strongest_bands(&row, &stimulus(0.001, 0.0), Unknowns::Line).unwrap();
        let (d1, d2) = (0.001 + 0.00325, 0.001 - 0.00325);
        let c = |d: f64| DEPTH + d * d / DEPTH;
        let m = |d: f64| 2.0 * 0.7 / c(d) * d / DEPTH;
        let exact = 2.0 * (c(d1) + c(d2)) / (m(d1) - m(d2)).abs();
        approx::assert_relative_eq!(found.along[0], exact, max_relative = 1e-4);
        assert_eq!(found.along[1], 0.0);
        // On a surface three bands close, and their box is wider than what the best use of them leaves.
        let three = toy(&[(0.0, 0.004), (-0.004, -0.003), (0.004, -0.003)]);
        let contact = stimulus(0.0005, 0.0003);
        let found = strongest_bands(&three, &contact, Unknowns::Normal).unwrap();
        let bound = cramer_rao(&three, &contact, Unknowns::Normal).unwrap()[0];
        assert!((0..2).all(|i| found.along[i] > bound.along[i] && found.along[i] < 2.0 * bound.along[i]));
        assert!(found.normal_force > bound.normal_force);
        approx::assert_relative_eq!(
            bound.along[0].hypot(bound.along[1]),
            bound.position,
            max_relative = 1e-9
        );
        // Two taxels do not close on a surface.
        let open = strongest_bands(&row, &stimulus(0.001, 0.0), Unknowns::Normal).unwrap();
        assert!(open.along[0].is_infinite());
    }

    #[test]
    fn a_model_that_reads_something_untouched_has_the_same_bounds() {
        let (plain, resting) = (grid(), shifted(grid()));
        for at in [(0.0005, 0.0003), (0.006, 0.0075)] {
            let contact = Stimulus { contacts: vec![press(at.0, at.1, 0.7)], ..Stimulus::default() };
            let (a, b) = (&plain as &dyn ForwardModel, &resting as &dyn ForwardModel);
            let bound = |model| cramer_rao(model, &contact, Unknowns::Normal).unwrap()[0];
            approx::assert_relative_eq!(bound(a).position, bound(b).position, max_relative = 1e-6);
            // The channels whose signal is largest, not those whose reading is.
            let bands = |model| strongest_bands(model, &contact, Unknowns::Normal).unwrap();
            let (a, b) = (bands(a), bands(b));
            approx::assert_relative_eq!(a.normal_force, b.normal_force, max_relative = 1e-6);
            for k in 0..2 {
                approx::assert_relative_eq!(a.along[k], b.along[k], max_relative = 1e-6);
            }
        }
    }

    #[test]
    fn boxes_over_a_surface_are_those_of_each_point() {
        let model = shifted(grid());
        let (map, boxes) =
            over_surface_and_bands(&model, 0.7, TipShape::Sphere { diameter: 0.004 }, Unknowns::Normal)
                .unwrap();
        assert_eq!(
            map,
            crate::over_surface(&model, 0.7, TipShape::Sphere { diameter: 0.004 }, Unknowns::Normal).unwrap()
        );
        for (at, found) in model.surface().points.iter().zip(&boxes) {
            let contact = Stimulus { contacts: vec![press(at.x, at.y, 0.7)], ..Stimulus::default() };
            assert_eq!(*found, strongest_bands(&model, &contact, Unknowns::Normal).unwrap());
        }
    }

    #[test]
    fn what_no_channel_tells_is_unbounded() {
        // Two taxels on a line cannot tell to which side of it a touch lies, nor three unknowns at all.
        let bound = one(&toy(&[(-0.004, 0.0), (0.004, 0.0)]), press(0.001, 0.0, 0.5));
        assert!(bound.position.is_infinite());
        // Where it is known to lie on the line, they can.
        let row = toy(&[(-0.004, 0.0), (0.004, 0.0)]);
        let stimulus = Stimulus { contacts: vec![press(0.001, 0.0, 0.5)], ..Stimulus::default() };
        let line = cramer_rao(&row, &stimulus, Unknowns::Line).unwrap()[0];
        assert!(line.position.is_finite() && line.normal_force.is_finite());
        // A touch without force is nowhere.
        let bound = one(&grid(), press(0.001, 0.002, 0.0));
        assert!(bound.position.is_infinite() && bound.normal_force.is_finite());
        // Shear along y moves no taxel of this skin.
        let stimulus = Stimulus { contacts: vec![press(0.001, 0.002, 0.5)], ..Stimulus::default() };
        let full = cramer_rao(&grid(), &stimulus, Unknowns::Full).unwrap()[0];
        assert!(full.shear.unwrap().is_infinite() && full.position.is_finite());
    }

    #[test]
    fn at_the_edge_it_looks_inwards() {
        let (edge, near) = (one(&grid(), press(0.02, 0.0, 0.5)), one(&grid(), press(0.0199, 0.0, 0.5)));
        approx::assert_relative_eq!(edge.position, near.position, max_relative = 0.05);
    }

    #[test]
    fn a_channel_without_noise_is_refused() {
        let mut model = grid();
        model.noise[4] = 0.0;
        let error = cramer_rao(&model, &Stimulus::default(), Unknowns::Normal).unwrap_err();
        insta::assert_snapshot!(error, @"channel 4: its noise is 0 and must be a positive number; set `noise` in the skin description");
    }

    proptest! {
        #[test]
        fn more_unknowns_never_help(x in -0.015..0.015f64, y in -0.015..0.015f64, f in 0.05..2.0f64) {
            let model = grid();
            let alone = one(&model, press(x, y, f));
            let pair = Stimulus { contacts: vec![press(x, y, f), press(-y, x + 0.001, f)], ..Stimulus::default() };
            let both = cramer_rao(&model, &pair, Unknowns::Normal).unwrap()[0];
            prop_assert!(both.position >= alone.position * (1.0 - 1e-6));
            prop_assert!(both.normal_force >= alone.normal_force * (1.0 - 1e-6));
        }

        #[test]
        fn it_scales_as_it_must(x in -0.015..0.015f64, y in -0.015..0.015f64, f in 0.05..2.0f64) {
            let model = grid();
            let (a, b) = (one(&model, press(x, y, f)), one(&model, press(x, y, 2.0 * f)));
            // The field is linear in the force: twice the force halves the error of the position.
            prop_assert!((a.position / b.position - 2.0).abs() < 1e-3);
            prop_assert!((a.normal_force / b.normal_force - 1.0).abs() < 1e-3);
            let mut louder = grid();
            louder.noise.fill(6.0);
            let c = one(&louder, press(x, y, f));
            prop_assert!((c.position / a.position - 3.0).abs() < 1e-6);
        }
    }
}
