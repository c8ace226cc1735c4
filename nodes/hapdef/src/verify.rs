//! Figures of the forward model, computed now, against closed forms, other people's figures and other programs.

use dermis_mechanics::calculix::{self, CalculixError, Panel};
use dermis_mechanics::shell::{Quads, ShellMesh, shell_cases};
use dermis_mechanics::{Case, MechanicsError};
use dermis_skin::{ModelError, SkinDescription, SurfaceSpec};
use nalgebra::{Point3, Vector3};

use crate::model::rectangle;
use crate::parameters::Parameters;

/// The limb itself.
const SHIN: &str = include_str!("../../../launch/skins/hapdef-shin.toml");

/// Why the cases cannot be computed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum VerifyError {
    /// One cannot be computed at all.
    #[error(transparent)]
    Mechanics(#[from] MechanicsError),
    /// CalculiX has no answer.
    #[error(transparent)]
    Calculix(#[from] CalculixError),
    /// The limb cannot be.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// Its file cannot be read.
    #[error(transparent)]
    Skin(#[from] dermis_skin::SkinError),
}

/// Every case of this family: H1 to H6.
///
/// # Errors
///
/// [`VerifyError`] where a case cannot be computed at all.
pub fn cases() -> Result<Vec<Case>, VerifyError> {
    Ok(shell_cases()?)
}

/// What CalculiX makes of a roof, of a piece of a limb and of the limb that ships, and this model of the same: a minute of work.
///
/// # Errors
///
/// [`VerifyError`] where CalculiX is not installed, or fails.
pub fn judged() -> Result<Vec<Case>, VerifyError> {
    let mut cases = calculix::shell_cases()?;
    cases.extend(limb()?);
    Ok(cases)
}

/// One touch of the limb that ships, on a beam in its middle, and what its ten gauges read.
fn limb() -> Result<Vec<Case>, VerifyError> {
    let skin = SkinDescription::from_toml(SHIN, "hapdef-shin.toml")?;
    let parameters = Parameters::nominal(&skin)?;
    let surface = &parameters.surface;
    let points = surface.points.iter().zip(&surface.normals);
    let mesh = ShellMesh {
        points: points.map(|(p, n)| parameters.middle(p, n)).collect(),
        triangles: surface.triangles.clone(),
    };
    // A panel has two triangles a cell, and the shin is one.
    let (Some(quads), SurfaceSpec::Panel { radius, .. }) = (Quads::join(&mesh), &skin.surface) else {
        return Ok(Vec::new());
    };
    let gauges: Vec<_> =
        parameters.gauges.iter().map(|g| rectangle(g, parameters.thickness, false)).collect();
    // A beam around the limb, between two openings.
    let out = Vector3::z();
    let centre = parameters.middle(&Point3::from(Vector3::x() * 0.012857 + out * *radius), &out);
    Ok(calculix::panel_cases(&Panel {
        name: "shin",
        quads: &quads,
        section: &parameters.sections[0],
        clamped: &parameters.held,
        centre,
        patch: parameters.patch,
        gauges: &gauges,
        within: [0.10, 0.10],
    })?)
}
