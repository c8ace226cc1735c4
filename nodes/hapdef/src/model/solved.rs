//! The shell that a skin's model is solved from.

use dermis_mechanics::shell::{PlateTheory, Refined, Section, Shell, ShellMesh, Support};
use dermis_skin::{ModelError, SkinDescription};
use nalgebra::Point3;

use crate::effects;
use crate::parameters::{Clamp, Parameters, impossible};

/// The shell of these numbers. Its first nodes lie under the points of the surface.
pub(crate) fn shell(skin: &SkinDescription, parameters: &Parameters) -> Result<Shell, ModelError> {
    let graded = parameters.theory == PlateTheory::ReissnerMindlin;
    shell_on(skin, parameters, Triangles { halvings: 0, graded })
}

/// The triangles of a shell, from those of its surface.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Triangles {
    /// How often every one is split into four.
    pub(crate) halvings: usize,
    /// Whether those at edges and corners are split further, which is what a shell that shears takes.
    pub(crate) graded: bool,
}

/// The same on other triangles.
pub(crate) fn shell_on(
    skin: &SkinDescription,
    parameters: &Parameters,
    triangles: Triangles,
) -> Result<Shell, ModelError> {
    let surface = &parameters.surface;
    let points = surface.points.iter().zip(&surface.normals);
    let mut mesh = ShellMesh {
        points: points.map(|(p, n)| parameters.middle(p, n)).collect(),
        triangles: surface.triangles.clone(),
    };
    let place = |p: Point3<f64>| {
        let (outside, normal) = surface.project(&p);
        parameters.middle(&outside, &normal)
    };
    let (mut held, mut sections) = (parameters.held.clone(), parameters.sections.clone());
    let mut take = |refined: Refined| {
        held = refined.inherit(&held);
        if sections.len() > 1 {
            sections = refined.parents.iter().map(|t| sections[*t as usize].clone()).collect();
        }
        refined.mesh
    };
    if triangles.halvings > 0 {
        mesh = take(mesh.finer(triangles.halvings, place));
    }
    if triangles.graded {
        mesh = take(mesh.graded(place));
    }
    let supports = supports(parameters, &held);
    Shell::new(mesh, &sections, &supports).map_err(impossible(skin, "surface"))
}

/// What a skin's model is solved from.
#[derive(Debug)]
pub struct Solved {
    /// The shell, factored. Its first nodes lie under the points of the surface, in their order.
    pub shell: Shell,
    /// What it is made of; where that differs from triangle to triangle, of the first.
    pub section: Section,
    /// Points of the surface that are held.
    pub held: Vec<usize>,
}

impl Solved {
    /// Factors the shell of a skin by the theory that its `medium` names, effects included.
    ///
    /// # Errors
    ///
    /// As [`ShellModel::new`](super::ShellModel::new).
    pub fn new(skin: &SkinDescription) -> Result<Self, ModelError> {
        let mut parameters = Parameters::nominal(skin)?;
        effects::shape(skin, &mut parameters)?;
        let shell = shell(skin, &parameters)?;
        let section = parameters.sections.into_iter().next();
        let section = section.ok_or_else(|| skin.refusal("medium", "says nothing of the material".into()))?;
        Ok(Self { shell, section, held: parameters.held })
    }
}

fn supports(parameters: &Parameters, held: &[usize]) -> Vec<Support> {
    let share = 1.0 / held.len() as f64;
    let support = |&node: &usize| match parameters.clamp {
        Clamp::Rigid => Support::clamped(node),
        Clamp::Springs { translation, rotation } => {
            Support::spring(node, translation * share, rotation * share)
        }
    };
    held.iter().map(support).collect()
}
