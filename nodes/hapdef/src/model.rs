//! Forward model: what strain gauges on the inner side of a shell read when the outside is touched.
//!
//! The shell is a thin one by Kirchhoff and Love, or one that shears across its thickness by Reissner and Mindlin
//! (`medium.theory`). A touch spreads its force over a patch of the shell. By reciprocity the strain of a gauge under every force is one solution of
//! the shell with the gauge's row as its load, so that after one factorisation and one solution a gauge, a touch costs a few
//! products. Several touches add up; what a stiffer, deflected shell takes away (`geometric-stiffening`) is taken at each.

mod nodes;
mod solved;

use std::sync::OnceLock;

use dermis_mechanics::shell::{Action, Face, Gauge, Shell};
use dermis_model::{DeviceState, ForwardModel, Indentation, Stepped, Stimulus};
use dermis_skin::cache::{self, Bytes, Keep, Key};
use dermis_skin::{ModelError, SkinDescription, Surface};
use nalgebra::{Point3, Vector3};
use pulp::{Arch, Simd, WithSimd};

use crate::effects::{self, Dynamics};
use crate::parameters::{Parameters, StrainGauge, impossible};
use nodes::Nodes;
pub use solved::Solved;
pub(crate) use solved::{Triangles, shell, shell_on};

/// Points of a map that are summed at once: they stay in the nearest cache.
const PIECE: usize = 512;
/// Of a gauge's rectangle that must lie on material.
pub(crate) const COVERED: f64 = 0.98;

/// Strain gauges on a shell: readings (strain) for touches of its outside.
#[derive(Debug)]
pub struct ShellModel {
    surface: Surface,
    nodes: Nodes,
    /// What the shell is made of, and the shell itself where it was solved already.
    design: Design,
    /// Strain of every channel per force \[1/N\] along x, y and z on every point: three numbers a channel, channels of a point
    /// together.
    influence: Vec<f64>,
    noise: Vec<f64>,
    thickness: f64,
    patch: f64,
    stiffening: f64,
    compliance: OnceLock<Compliance>,
    dynamics: Dynamics,
}

/// What a shell is solved from, and the factorised shell once it was needed: a node whose results are in the cache never needs it.
#[derive(Debug)]
struct Design {
    skin: SkinDescription,
    parameters: Parameters,
    shell: OnceLock<Result<Shell, ModelError>>,
}

impl Design {
    fn shell(&self) -> Result<&Shell, ModelError> {
        self.shell.get_or_init(|| shell(&self.skin, &self.parameters)).as_ref().map_err(Clone::clone)
    }

    /// Everything that a result for this shell depends on.
    fn key(&self, kind: &str) -> Key {
        Key::new(kind).debug(&self.parameters)
    }
}

/// How every point gives way, for a touch at every point.
#[derive(Debug)]
struct Compliance {
    nodes: usize,
    /// Inwards, by touches: shares of each touch's scale, in 32767ths. Half the size, and so half the time to read it; rounded
    /// to 2·10⁻⁵ of the largest displacement.
    values: Vec<i16>,
    /// \[m/N\] of one step of each touch.
    scales: Vec<f32>,
}

impl Keep for Compliance {
    fn put(&self, out: &mut Vec<u8>) {
        self.values.put(out);
        self.scales.put(out);
    }

    fn take(from: &mut Bytes<'_>) -> Option<Self> {
        let (values, scales) = (Vec::take(from)?, Vec::take(from)?);
        let nodes = scales.len();
        (nodes.checked_mul(nodes)? == values.len()).then_some(Self { nodes, values, scales })
    }
}

impl Compliance {
    /// Of all points for a touch at `node`, and \[m/N\] of one step.
    fn column(&self, node: usize) -> (&[i16], f32) {
        (&self.values[node * self.nodes..(node + 1) * self.nodes], self.scales[node])
    }
}

/// A column of steps, and how much one is.
type Scaled<'a> = (&'a [i16], f32);

/// The sum of all columns, each in its own steps, to every point.
struct AddUp<'a> {
    columns: &'a [[Scaled<'a>; 3]],
    out: &'a mut [f64],
}

impl WithSimd for AddUp<'_> {
    type Output = ();

    // Plain loops: inlined, they are compiled for the instructions of each kind of processor.
    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        for (piece, out) in self.out.chunks_mut(PIECE).enumerate() {
            let mut sum = [0.0f32; PIECE];
            let sum = &mut sum[..out.len()];
            for [(a, wa), (b, wb), (c, wc)] in self.columns {
                let range = piece * PIECE..piece * PIECE + out.len();
                let (a, b, c) = (&a[range.clone()], &b[range.clone()], &c[range]);
                for (((sum, a), b), c) in sum.iter_mut().zip(a).zip(b).zip(c) {
                    *sum += f32::from(*a) * wa + f32::from(*b) * wb + f32::from(*c) * wc;
                }
            }
            for (out, sum) in out.iter_mut().zip(sum) {
                *out = f64::from(*sum);
            }
        }
    }
}

/// A gauge as mechanics knows it, across its axis where it is turned by a right angle.
pub(crate) fn rectangle(gauge: &StrainGauge, thickness: f64, across: bool) -> Gauge {
    let [length, width] = gauge.size;
    let centre = gauge.position + gauge.normal * (thickness / 2.0);
    if across {
        let along = gauge.normal.cross(&gauge.axis);
        Gauge { centre, along, length: width, width: length, face: Face::Inner }
    } else {
        Gauge { centre, along: gauge.axis, length, width, face: Face::Inner }
    }
}

/// Strain of every channel per force on every point, as [`ShellModel`] keeps it.
fn strains(design: &Design) -> Result<Vec<f64>, ModelError> {
    let (skin, parameters) = (&design.skin, &design.parameters);
    let shell = design.shell()?;
    let gauges = &parameters.gauges;
    let taxels = skin.channel_taxels();
    let mut rows = Vec::with_capacity(gauges.len());
    let of = |across| gauges.iter().map(move |g| (g, across));
    let rectangles =
        |across| of(across).map(|(g, across)| rectangle(g, parameters.thickness, across)).collect::<Vec<_>>();
    let wrong = |channel: usize| format!("taxels[{}].position", taxels[channel]);
    for (channel, along) in
        shell.gauges(&rectangles(false)).map_err(impossible(skin, "taxels"))?.into_iter().enumerate()
    {
        if along.covered < COVERED {
            let [length, width] = gauges[channel].size.map(|s| s * 1e3);
            return Err(skin.refusal(
                &wrong(channel),
                format!(
                    "only {:.0} % of its {length} x {width} mm lie on the shell: move it away from the edge",
                    100.0 * along.covered
                ),
            ));
        }
        rows.push(along.row);
    }
    if gauges.iter().any(|g| g.transverse != 0.0) {
        let across = shell.gauges(&rectangles(true)).map_err(impossible(skin, "taxels"))?;
        for ((row, across), gauge) in rows.iter_mut().zip(across).zip(gauges) {
            *row = Action::sum([(1.0, &*row), (gauge.transverse, &across.row)]);
        }
    }
    let influences = shell.solve(&rows).map_err(impossible(skin, "taxels"))?;
    let channels = gauges.len();
    let mut influence = vec![0.0; 3 * channels * parameters.surface.points.len()];
    for (channel, (found, gauge)) in influences.iter().zip(gauges).enumerate() {
        let nodes = influence.chunks_exact_mut(3 * channels).zip(&parameters.surface.normals);
        for (node, (all, normal)) in nodes.enumerate() {
            // What acts on the outside also turns the shell, where it acts along it.
            let turned = found.rotation(node).cross(&(normal * parameters.arm()));
            let per_force = (found.displacement(node) + turned) * gauge.gain;
            all[3 * channel..][..3].copy_from_slice(per_force.as_slice());
        }
    }
    Ok(influence)
}

impl ShellModel {
    /// The model of a skin whose `medium` names `thickness` \[m\], `young_modulus` \[Pa\], `poisson_ratio`, `gauge` (length and
    /// width \[m\]), and may name `patch` \[m\], `clamp` and `bridge`. Takes some tenths of a second for a shell of 3,000 points;
    /// displacements, when they are first requested, some seconds more.
    ///
    /// # Errors
    ///
    /// [`ModelError::Description`] names the field that is missing, unknown or impossible, effects included.
    pub fn new(skin: &SkinDescription) -> Result<Self, ModelError> {
        let mut parameters = Parameters::nominal(skin)?;
        effects::shape(skin, &mut parameters)?;
        Self::from_parameters(skin, parameters)
    }

    pub(crate) fn from_parameters(
        skin: &SkinDescription,
        parameters: Parameters,
    ) -> Result<Self, ModelError> {
        let design = Design { skin: skin.clone(), parameters, shell: OnceLock::new() };
        let what = "how the gauges of the shell feel a force anywhere (finite elements)";
        let influence: Vec<f64> = cache::kept(what, design.key("shell-strains"), || strains(&design))?;
        Self::of(design, influence)
    }

    /// On another shell of the same surface, whose results are not kept.
    pub(crate) fn on(
        skin: &SkinDescription,
        parameters: Parameters,
        shell: Shell,
    ) -> Result<Self, ModelError> {
        let design = Design { skin: skin.clone(), parameters, shell: OnceLock::from(Ok(shell)) };
        let influence = strains(&design)?;
        Self::of(design, influence)
    }

    fn of(design: Design, influence: Vec<f64>) -> Result<Self, ModelError> {
        let Design { parameters, skin, .. } = &design;
        let channels = parameters.gauges.len();
        if influence.len() != 3 * channels * parameters.surface.points.len() {
            return Err(skin.refusal("surface", "has other points than were solved".into()));
        }
        Ok(Self {
            nodes: Nodes::new(&parameters.surface, parameters.patch),
            noise: skin.channel_noise(),
            thickness: parameters.thickness,
            patch: parameters.patch,
            stiffening: parameters.stiffening,
            compliance: OnceLock::new(),
            dynamics: Dynamics::new(skin, parameters.bridge)?,
            surface: parameters.surface.clone(),
            design,
            influence,
        })
    }

    /// \[m\] radius over which a touch presses in maps of displacement.
    #[must_use]
    pub fn patch(&self) -> f64 {
        self.patch
    }

    /// The shell itself; solved where that was not needed yet.
    ///
    /// # Errors
    ///
    /// [`ModelError::Description`] where the shell cannot be.
    pub fn shell(&self) -> Result<&Shell, ModelError> {
        self.design.shell()
    }

    /// How every point gives way \[m/N\] for touches of the nominal patch at every point.
    fn compliance(&self) -> &Compliance {
        self.compliance.get_or_init(|| {
            let what = "how the shell gives way to a touch anywhere (finite elements)";
            cache::kept(what, self.design.key("shell-compliance"), || self.give_way())
                .ok()
                .filter(|found| found.nodes == self.surface.points.len())
                .unwrap_or_else(|| self.rigid())
        })
    }

    /// What is taken where a shell cannot be solved, which was when its gauges were.
    fn rigid(&self) -> Compliance {
        let nodes = self.surface.points.len();
        Compliance { nodes, values: vec![0; nodes * nodes], scales: vec![0.0; nodes] }
    }

    fn give_way(&self) -> Result<Compliance, ModelError> {
        let Compliance { nodes, mut values, mut scales } = self.rigid();
        let mut sum = vec![0.0f32; nodes];
        let refused = impossible(&self.design.skin, "surface");
        let green = self.shell()?.normal_green_of_first(&self.surface.normals).map_err(refused)?;
        let mut patch = Vec::new();
        for ((node, out), scale) in values.chunks_exact_mut(nodes).enumerate().zip(&mut scales) {
            let (p, n) = (self.surface.points[node], self.surface.normals[node]);
            self.nodes.patch(&self.surface, &p, &n, self.patch, &mut patch);
            sum.fill(0.0);
            for &(i, weight) in &patch {
                let weight = weight as f32;
                sum.iter_mut().zip(green.column(i)).for_each(|(o, g)| *o += weight * g);
            }
            *scale = sum.iter().fold(0.0f32, |m, v| m.max(v.abs())) / f32::from(i16::MAX);
            if *scale > 0.0 {
                out.iter_mut().zip(&sum).for_each(|(o, v)| *o = (v / *scale).round() as i16);
            }
        }
        Ok(Compliance { nodes, values, scales })
    }

    /// \[m/N\] by which the surface gives way at the first place for a touch at the second.
    fn gives(&self, at: &[(usize, f64); 3], touch: &[(usize, f64); 3]) -> f64 {
        let compliance = self.compliance();
        let column = |&(j, wj): &(usize, f64)| {
            let (column, scale) = compliance.column(j);
            wj * f64::from(scale) * at.iter().map(|&(i, wi)| wi * f64::from(column[i])).sum::<f64>()
        };
        touch.iter().map(column).sum()
    }

    /// Deflection of the stiffened shell for that of the linear one \[m\]: u + βu³/h² is the linear one.
    fn deflection(&self, linear: f64) -> f64 {
        let (beta, h) = (self.stiffening, self.thickness);
        if beta == 0.0 || linear == 0.0 {
            return linear;
        }
        // Cardano, for the one real root of x³ + x/β = linear/(βh), by hyperbolic functions.
        let p = 1.0 / beta;
        let q = linear / (h * beta);
        let scale = 2.0 * (p / 3.0).sqrt();
        h * scale * ((1.5 * q / p * (3.0 / p).sqrt()).asinh() / 3.0).sinh()
    }

    /// Share of the linear response that each touch keeps.
    fn kept(&self, contacts: &[(&Indentation, Vector3<f64>)]) -> Vec<f64> {
        if self.stiffening == 0.0 {
            return vec![1.0; contacts.len()];
        }
        let locations: Vec<_> =
            contacts.iter().map(|(c, n)| self.nodes.corners(&self.surface, &c.position, n)).collect();
        locations
            .iter()
            .map(|at| {
                let touches = contacts.iter().zip(&locations);
                let linear: f64 =
                    touches.map(|((c, n), place)| -c.force.dot(n) * self.gives(at, place)).sum();
                if linear == 0.0 { 1.0 } else { self.deflection(linear) / linear }
            })
            .collect()
    }

    /// What touches, each with the normal there.
    fn checked<'a>(
        &self,
        stimulus: &'a Stimulus,
    ) -> Result<Vec<(&'a Indentation, Vector3<f64>)>, ModelError> {
        let contacts = stimulus.contacts.iter().enumerate();
        contacts.map(|(i, c)| Ok((c, c.check(i, &self.surface)?))).collect()
    }
}

impl ForwardModel for ShellModel {
    fn channels(&self) -> usize {
        self.noise.len()
    }

    fn surface(&self) -> &Surface {
        &self.surface
    }

    /// Strain at each gauge.
    fn response(&self, stimulus: &Stimulus, out: &mut [f64]) -> Result<(), ModelError> {
        assert_eq!(out.len(), self.channels());
        out.fill(0.0);
        let contacts = self.checked(stimulus)?;
        let kept = self.kept(&contacts);
        let mut patch = Vec::with_capacity(32);
        for ((contact, normal), kept) in contacts.iter().zip(kept) {
            let radius = contact.diameter() / 2.0;
            self.nodes.patch(&self.surface, &contact.position, normal, radius, &mut patch);
            let force = contact.force * kept;
            let width = 3 * out.len();
            for &(node, weight) in &patch {
                let [x, y, z] = [force.x * weight, force.y * weight, force.z * weight];
                let influence = &self.influence[node * width..(node + 1) * width];
                for (strain, per_force) in out.iter_mut().zip(influence.chunks_exact(3)) {
                    *strain += per_force[0] * x + per_force[1] * y + per_force[2] * z;
                }
            }
        }
        Ok(())
    }

    /// Of the linear shell under the normal part of each force, spread over the nominal patch.
    fn displacement(&self, stimulus: &Stimulus, out: &mut [f64]) -> Result<bool, ModelError> {
        assert_eq!(out.len(), self.surface.points.len());
        let contacts = self.checked(stimulus)?;
        if contacts.is_empty() {
            out.fill(0.0);
            return Ok(true);
        }
        let kept = self.kept(&contacts);
        let compliance = self.compliance();
        let columns: Vec<[Scaled; 3]> = contacts
            .iter()
            .zip(kept)
            .map(|((contact, normal), kept)| {
                let pressing = -contact.force.dot(normal) * kept;
                let corners = self.nodes.corners(&self.surface, &contact.position, normal);
                corners.map(|(node, w)| {
                    let (column, scale) = compliance.column(node);
                    (column, (w * pressing) as f32 * scale)
                })
            })
            .collect();
        // With the widest instructions that the machine has: it takes most of the time of a sample.
        Arch::new().dispatch(AddUp { columns: &columns, out });
        Ok(true)
    }

    fn noise(&self) -> &[f64] {
        &self.noise
    }

    fn start(&self, seed: u64) -> Box<dyn DeviceState + '_> {
        Box::new(Stepped::new(self, self.dynamics.start(seed)))
    }

    /// Of the shell under a touch of the nominal patch, whatever the tip: a hard shell gives way as a whole.
    fn force_at(&self, at: &Point3<f64>, diameter: f64, depth: f64) -> Option<f64> {
        let linear = depth * (1.0 + self.stiffening * (depth / self.thickness).powi(2));
        Some(linear / self.own(at, diameter)?)
    }

    fn depth_at(&self, at: &Point3<f64>, diameter: f64, force: f64) -> Option<f64> {
        Some(self.deflection(force * self.own(at, diameter)?))
    }
}

impl ShellModel {
    /// \[m/N\] by which a place gives way to a touch there; `None` where it is held, or for a tip that cannot be.
    fn own(&self, at: &Point3<f64>, diameter: f64) -> Option<f64> {
        let (at, normal) = self.surface.project(at);
        let place = self.nodes.corners(&self.surface, &at, &normal);
        let gives = self.gives(&place, &place);
        (Indentation::DIAMETERS.contains(&diameter) && gives > 0.0).then_some(gives)
    }
}

#[cfg(test)]
mod tests;
