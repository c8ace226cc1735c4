//! Figures of the forward model, computed now, against closed forms, other people's figures and other programs.

use std::f64::consts::PI;

use dermis_mechanics::calculix::{self, PadReadings};
use dermis_mechanics::{Base, Case, Load, MechanicsError, Medium, PressureTable, SphereContact, VerifyError};
use dermis_model::{Indentation, Stimulus};
use dermis_skin::{SkinDescription, Taxel};
use nalgebra::{Point3, Vector3};

/// The pad that ships.
const PAD: &str = include_str!("../../../launch/skins/baro-grid.toml");
/// \[Pa\].
const YOUNG: f64 = 70e3;
const POISSON: f64 = 0.49;
/// \[m\] of the layer.
const THICKNESS: f64 = 0.010;
/// \[m\] at which sensors lie.
const DEPTH: f64 = 0.005;
/// \[m\] of the sphere.
const RADIUS: f64 = 0.002;

/// Every case of this family, in the order of their names.
///
/// # Errors
///
/// [`MechanicsError`] where a case cannot be computed at all.
pub fn cases() -> Result<Vec<Case>, MechanicsError> {
    let mut cases = points()?;
    cases.extend(disc()?);
    cases.extend(spheres()?);
    cases.extend(wings()?);
    cases.extend(shear()?);
    cases.push(tables()?);
    Ok(cases)
}

/// What CalculiX makes of a layer, of a pad with free sides and of a dome, and this model of the same: seconds of work.
///
/// # Errors
///
/// [`VerifyError`] where CalculiX is not installed, or fails.
pub fn judged() -> Result<Vec<Case>, VerifyError> {
    let mut cases = calculix::layer_cases()?;
    cases.extend(calculix::block_cases()?);
    cases.extend(calculix::dome_cases()?);
    cases.extend(rim()?);
    Ok(cases)
}

/// Forces \[N\] of a sphere of 4 mm, and where they press on the pad of 34 mm that ships: x \[m\], y is 0.
const RIM: [(f64, f64); 3] = [(0.3, 0.014), (1.0, 0.014), (1.0, 0.011)];
/// Largest share of a touch's strongest reading by which another may differ. Of 1.3 %, a part is the solids': with cells of
/// 0.5 mm it is 1.1 %.
const RIM_WITHIN: f64 = 0.015;

/// The pad that ships, with free sides, touched 3 mm and 6 mm from one: of each touch the worst reading of four.
fn rim() -> Result<Vec<Case>, VerifyError> {
    let medium = pad(Base::Bonded)?;
    let contacts = RIM
        .iter()
        .map(|(force, x)| Ok((*x, sphere_with(&medium, *force)?)))
        .collect::<Result<Vec<_>, MechanicsError>>()?;
    let PadReadings { points: sensors, stress: solids } = calculix::pad_readings(&contacts)?;
    let mut skin = SkinDescription::from_toml(PAD, "baro-grid.toml")?;
    let taxels = sensors.iter().enumerate().map(|(i, p)| Taxel {
        name: format!("s{i}"),
        position: (*p).into(),
        normal: [0.0, 0.0, 1.0],
        axis: None,
    });
    skin = skin.with_taxels(taxels.collect())?;
    let model = crate::model(&skin)?;
    let mut cases = Vec::new();
    for ((force, x), solid) in RIM.iter().zip(&solids) {
        let touch = Indentation::sphere(Point3::new(*x, 0.0, 0.0), -Vector3::z() * *force, 2.0 * RADIUS);
        let mut read = vec![0.0; model.channels()];
        model.response(&Stimulus { contacts: vec![touch], ..Stimulus::default() }, &mut read)?;
        let peak = solid.iter().fold(0.0f64, |peak, p| peak.max(p.abs()));
        let off = |k: &usize| (read[*k] - solid[*k]).abs();
        let Some(worst) = (0..read.len()).max_by(|a, b| off(a).total_cmp(&off(b))) else { continue };
        let at = sensors[worst] * 1e3;
        cases.push(Case::new(
            format!("rim-ccx-sphere-{}-{force}", (17.0 - x * 1e3).round()),
            format!(
                "pad with free sides, {force} N on a sphere of 4 mm {:.0} mm from one: the worst of four readings by the \
                 largest, at ({:.1}, {:.1}) mm",
                17.0 - x * 1e3, at.x, at.y
            ),
            "CalculiX ccx, run now",
            "Pa",
            [read[worst], solid[worst]],
            (RIM_WITHIN, peak),
        ));
    }
    Ok(cases)
}

/// The contact of the sphere that presses with `force` \[N\].
fn sphere_with(medium: &Medium, force: f64) -> Result<SphereContact, MechanicsError> {
    let (mut low, mut high) = (0.0, RADIUS);
    for _ in 0..50 {
        let middle = f64::midpoint(low, high);
        if SphereContact::new(medium, RADIUS, middle)?.force() < force {
            low = middle;
        } else {
            high = middle;
        }
    }
    SphereContact::new(medium, RADIUS, f64::midpoint(low, high))
}

fn half() -> Result<Medium, MechanicsError> {
    Medium::half_space(YOUNG, POISSON)
}

fn pad(base: Base) -> Result<Medium, MechanicsError> {
    Medium::layer(YOUNG, POISSON, THICKNESS, base)
}

/// B1: a point load on the half-space.
fn points() -> Result<Vec<Case>, MechanicsError> {
    let exact = (1.0 + POISSON) / (3.0 * PI * DEPTH * DEPTH);
    let got = half()?.pressure(&Load::Point { force: 1.0 }, DEPTH, 0.0)?;
    Ok(vec![Case::relative(
        "B1",
        "half-space, 1 N on a point: pressure 5 mm below",
        "Boussinesq, (1+ν)F/(3πz²)",
        "Pa",
        [got, exact],
        0.005,
    )])
}

/// B2: a disc on the bonded layer.
fn disc() -> Result<Vec<Case>, MechanicsError> {
    let (medium, load) = (pad(Base::Bonded)?, Load::Disc { force: 1.0, radius: 0.001 });
    let source = "another Hankel code; CalculiX CAX8R within 0.2 % of the peak";
    let peak = 6882.0;
    let mut cases = Vec::new();
    for (r, expected) in [(0.0, peak), (0.004, 3523.0), (0.010, 597.0), (0.020, 65.5)] {
        let got = medium.pressure(&load, DEPTH, r)?;
        cases.push(Case::new(
            format!("B2 r={}", r * 1e3),
            format!("bonded layer, 1 N on a disc of 1 mm: pressure {} mm beside the axis", r * 1e3),
            source,
            "Pa",
            [got, expected],
            (0.005, peak),
        ));
    }
    let got = medium.surface_displacement(&load, 0.0)?;
    let what = "the same: displacement of the surface under the disc";
    cases.push(Case::relative("B2 w", what, source, "m", [got, 6.313e-3], 0.005));
    Ok(cases)
}

/// Force \[N\] that presses the sphere `depth` \[m\] deep into the half-space: Sneddon's closed forms of the contact radius.
fn sneddon(depth: f64) -> f64 {
    let logarithm = |a: f64| ((RADIUS + a) / (RADIUS - a)).ln();
    let (mut low, mut high) = (0.0, RADIUS);
    for _ in 0..80 {
        let middle = (low + high) / 2.0;
        if middle / 2.0 * logarithm(middle) < depth {
            low = middle;
        } else {
            high = middle;
        }
    }
    let modulus = YOUNG / (1.0 - POISSON * POISSON);
    modulus * ((low * low + RADIUS * RADIUS) / 2.0 * logarithm(low) - low * RADIUS)
}

/// B3 and B4: a sphere on the half-space, and how much stiffer the layer is.
fn spheres() -> Result<Vec<Case>, MechanicsError> {
    let force = |medium: &Medium, depth: f64| {
        SphereContact::at_indentation(medium, RADIUS, depth).map(|contact| contact.force())
    };
    let (half, pad) = (half()?, pad(Base::Bonded)?);
    let mut cases = Vec::new();
    for depth in [0.0012, 0.0024] {
        cases.push(Case::relative(
            format!("B3 δ={}", depth * 1e3),
            format!("half-space, sphere of 4 mm pressed in by {} mm: force", depth * 1e3),
            "Sneddon 1965",
            "N",
            [force(&half, depth)?, sneddon(depth)],
            0.005,
        ));
    }
    for (depth, ratio) in [(0.0002, 1.074), (0.0005, 1.120), (0.0012, 1.185), (0.0024, 1.241)] {
        cases.push(Case::relative(
            format!("B4 δ={}", depth * 1e3),
            format!(
                "the same sphere {} mm deep: force on the bonded layer over the half-space's",
                depth * 1e3
            ),
            "boundary elements of another code",
            "",
            [force(&pad, depth)? / force(&half, depth)?, ratio],
            0.01,
        ));
    }
    Ok(cases)
}

/// B5: the sign of the pressure far from the contact.
fn wings() -> Result<Vec<Case>, MechanicsError> {
    let mut cases = Vec::new();
    for (id, base, expected) in [("B5 bonded", Base::Bonded, 65.0), ("B5 slip", Base::Slip, -12.0)] {
        let got = pad(base)?.pressure(&Load::Point { force: 1.0 }, DEPTH, 0.020)?;
        let what = format!("layer, {id}: pressure 20 mm beside 1 N", id = &id[3..]);
        cases.push(Case::relative(id, what, "another Hankel code", "Pa", [got, expected], 0.1));
    }
    Ok(cases)
}

/// B6: a force along the surface.
fn shear() -> Result<Vec<Case>, MechanicsError> {
    let (point, disc) = (Load::Point { force: 1.0 }, Load::Disc { force: 1.0, radius: 0.001 });
    let mut cases = Vec::new();
    let half = half()?;
    for x in [0.004, -0.010] {
        let distance = DEPTH.hypot(x);
        let exact = (1.0 + POISSON) * x / (3.0 * PI * distance.powi(3));
        cases.push(Case::relative(
            format!("B6 x={}", x * 1e3),
            format!("half-space, 1 N along x on a point: pressure 5 mm deep at x = {} mm", x * 1e3),
            "Cerruti, (1+ν)Qx/(3πR³)",
            "Pa",
            [half.pressure_of_shear(&point, DEPTH, x)?, exact],
            0.005,
        ));
    }
    for (name, base, expected) in [
        ("bonded", Base::Bonded, [2552.93, 1205.05, 265.80]),
        ("slip", Base::Slip, [2403.24, 1179.74, 425.94]),
    ] {
        for (x, expected) in [0.004, 0.010, 0.020].into_iter().zip(expected) {
            cases.push(Case::relative(
                format!("B6 {name} x={}", x * 1e3),
                format!("layer, {name}, 1 N along x on a disc of 1 mm: pressure at x = {} mm", x * 1e3),
                "transfer matrix of plane waves, by another code",
                "Pa",
                [pad(base)?.pressure_of_shear(&disc, DEPTH, x)?, expected],
                0.005,
            ));
        }
    }
    Ok(cases)
}

/// B7: what the sampler looks up, between the rows and columns of its table, against the contact's transform.
fn tables() -> Result<Case, MechanicsError> {
    let pad = pad(Base::Bonded)?;
    let table = PressureTable::sphere(&pad, 2.0 * RADIUS, DEPTH, 0.045, 5.0)?;
    let (mut got, mut peak) = (0.0f64, 0.0f64);
    for u in [0.03f64, 0.21, 0.52, 0.93, 1.4] {
        let contact = SphereContact::new(&pad, RADIUS, RADIUS * u.tanh())?;
        let profile = table.under(contact.force());
        for r in [0.0, 0.0007, 0.0021, 0.0043, 0.0066, 0.0117] {
            let exact = contact.pressure(&pad, DEPTH, r)?;
            peak = peak.max(exact / contact.force());
            got = got.max((profile.pressure(r) - exact).abs() / contact.force());
        }
    }
    Ok(Case::new(
        "B7",
        "bonded layer, sphere of 4 mm: largest error of the table per newton",
        "the integral itself",
        "Pa",
        [got, 0.0],
        (0.001, peak),
    ))
}

#[cfg(test)]
mod tests {
    use dermis_model::suite::all_pass;

    use super::*;

    #[test]
    fn every_case_passes() {
        let cases = cases().unwrap();
        all_pass(&cases);
        assert!(cases.len() >= 22, "{} cases", cases.len());
    }

    /// Half a minute of CalculiX.
    #[test]
    fn the_rim_agrees_with_solids() {
        if !calculix::available() {
            return println!("skipped: {}", calculix::CalculixError::Missing);
        }
        let cases = rim().unwrap();
        assert_eq!(cases.len(), RIM.len());
        all_pass(&cases);
    }

    #[test]
    fn names_are_unique() {
        let cases = cases().unwrap();
        for (i, case) in cases.iter().enumerate() {
            assert!(cases[..i].iter().all(|c| c.id != case.id), "{} is there twice", case.id);
        }
    }
}
