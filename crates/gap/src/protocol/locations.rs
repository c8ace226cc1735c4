//! Where to press a skin.
//!
//! Problem: locations that a few presses should be spread over, so that every channel is heard and no two presses say the same. Method:
//! a maximin design (Johnson, Moore and Ylvisaker 1990) chosen one place after another, each as far as can be from those before
//! (Kennard and Stone 1969), where the distance of two locations is that of what the skin reads there, in shares of both: so the skin's own
//! sensitivity says how finely its surface is resolved. What is hardly read is not pressed.
//!
//! Cost: one response for each candidate, and candidates × locations distances.

use dermis_model::{ForwardModel, Indentation, Stimulus};
use nalgebra::{Point3, Vector3};

use crate::GapError;
use crate::constants::protocol::{CANDIDATES, SEEN};

/// Locations \[m\] that say most of a skin, the first the one that it feels best; at most `count`. `may` says where it may be pressed at
/// all; `force` \[N\] and `tip` \[m\] are those of an ordinary press.
///
/// # Errors
///
/// [`GapError::Model`] where the model has no answer at any place.
pub fn locations(
    model: &dyn ForwardModel,
    (force, tip): (f64, f64),
    count: usize,
    may: impl Fn(&Point3<f64>) -> bool,
) -> Result<Vec<Point3<f64>>, GapError> {
    let surface = model.surface();
    let fail = |source| GapError::Model { what: "a press of the protocol".to_owned(), source };
    let mut rest = vec![0.0; model.channels()];
    model.response(&Stimulus::default(), &mut rest).map_err(fail)?;
    let noise = model.noise();
    let mut read: Vec<(Point3<f64>, Vec<f64>, f64)> = Vec::new();
    let mut refused = None;
    let every = surface.points.len().div_ceil(CANDIDATES).max(1);
    let mut out = vec![0.0; model.channels()];
    for point in surface.points.iter().step_by(every).filter(|p| may(p)) {
        let (at, normal) = surface.project(point);
        let contact = Indentation::sphere(at, Vector3::from(normal * -force), tip);
        let stimulus = Stimulus { contacts: vec![contact], ..Stimulus::default() };
        if let Err(source) = model.response(&stimulus, &mut out) {
            refused = Some(source);
            continue;
        }
        let signal = out.iter().zip(&rest).zip(noise).map(|((v, r), n)| (v - r) / n.max(f64::MIN_POSITIVE));
        let signal: Vec<f64> = signal.map(|v| if v.is_finite() { v } else { 0.0 }).collect();
        let size = signal.iter().map(|v| v * v).sum::<f64>().sqrt();
        read.push((at, signal, size));
    }
    if let (true, Some(source)) = (read.is_empty(), refused) {
        return Err(fail(source));
    }
    let most = read.iter().map(|(.., size)| *size).fold(0.0, f64::max);
    read.retain(|(.., size)| *size >= SEEN * most);
    // How far each candidate is from the nearest place that was chosen.
    let mut away: Vec<f64> = read.iter().map(|(.., size)| 2.0 + size / most.max(1e-300)).collect();
    let mut chosen = Vec::new();
    while chosen.len() < count {
        let Some(next) = (0..read.len()).max_by(|a, b| away[*a].total_cmp(&away[*b])) else { break };
        if away[next] <= 0.0 {
            break;
        }
        chosen.push(read[next].0);
        for i in 0..read.len() {
            let apart: f64 =
                read[i].1.iter().zip(&read[next].1).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
            away[i] = away[i].min(apart / (read[i].2 + read[next].2));
        }
        away[next] = 0.0;
    }
    Ok(chosen)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{skin, small};

    #[test]
    fn places_begin_above_what_feels_best_and_spread_from_there() {
        let model = small(&skin(), 300.0).unwrap();
        let found = locations(model.as_ref(), (0.5, 0.004), 9, |_| true).unwrap();
        assert_eq!(found.len(), 9);
        // Three taxels, each of which is pressed nearby.
        for taxel in [[-0.009, -0.004], [0.0, 0.005], [0.009, -0.004]] {
            let near = found.iter().map(|p| (p.x - taxel[0]).hypot(p.y - taxel[1])).fold(1.0, f64::min);
            assert!(near < 0.005, "{taxel:?}: {near}");
        }
        let apart = |i: usize| found[..i].iter().map(|p| (p - found[i]).norm()).fold(1.0, f64::min);
        assert!((1..9).all(|i| apart(i) > 0.003), "{found:?}");
        let right = locations(model.as_ref(), (0.5, 0.004), 9, |p| p.x > 0.0).unwrap();
        assert!(right.iter().all(|p| p.x > 0.0));
    }
}
