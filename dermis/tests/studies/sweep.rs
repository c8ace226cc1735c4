use dermis_report::sweep::{html, text};
use dermis_studies::Unwatched;
use dermis_studies::sweep::{Findings, Request, of_skin, sweep};
use dermis_studies::variation::Parameter;

use crate::{FAMILIES, load, path};

fn request(skin: &str, vary: &[Parameter]) -> Request {
    Request { skin: path(skin), vary: vary.to_vec(), ..Request::default() }
}

fn sweeps(request: &Request) -> Findings {
    sweep(request, &FAMILIES, &Unwatched).expect("a skin that ships can be varied")
}

#[test]
fn noise_and_modulus_do_what_a_formula_says() {
    let options =
        Request { line: true, ..request("baro-line.toml", &[Parameter::Noise, Parameter::Modulus]) };
    let sweeps = sweeps(&options).sweeps;
    // Twice the noise, twice the error, and twice the reading that must be reached.
    let noise = sweeps[0].elasticity;
    approx_eq(noise.position, 1.0, 1e-3);
    approx_eq(noise.force, 1.0, 1e-3);
    approx_eq(noise.minimum_force, 1.0, 0.05);
    approx_eq(noise.factor, -1.0, 1e-3);
    // A given force makes the same stress in a stiffer medium, but for the smaller contact.
    let modulus = sweeps[1].elasticity;
    assert!(modulus.position.abs() < 0.1, "{modulus:?}");
}

#[test]
fn depth_is_a_compromise_and_said_so() {
    let options =
        Request { line: true, ..request("baro-line.toml", &[Parameter::Depth, Parameter::Thickness]) };
    let findings = sweeps(&options);
    let depth = &findings.sweeps[0];
    // Below the base of the medium there is none.
    assert!(depth.variants.len() >= 7 && depth.variants.iter().all(|v| v.value <= 0.0101));
    let text = text(&findings);
    assert!(text.contains("depth") && text.contains("thickness") && text.contains("helps"), "{text}");
    let html = html(&findings, &text).unwrap();
    assert_eq!(html.matches("<svg").count(), 8);
}

#[test]
fn what_cannot_be_built_is_left_out_and_named() {
    let options = Request { line: true, ..request("baro-line.toml", &[Parameter::Depth]) };
    let mut skin = load("baro-line.toml");
    // Twice as deep, the taxels lie below a thinner medium.
    *skin.medium.get_mut("thickness").unwrap() = 0.008.into();
    let sweeps = of_skin(skin, &options, &FAMILIES, &Unwatched).unwrap().sweeps;
    assert_eq!(sweeps[0].variants.len(), 8);
    insta::assert_snapshot!(sweeps[0].refused[0], @"depth of 10: skin `baro-line`: field `taxels[0].position`: z of `b0` is -0.01 m and must lie in the medium: below 0 and not below -0.008 m");
}

fn approx_eq(found: f64, expected: f64, within: f64) {
    assert!((found - expected).abs() < within, "{found}, not {expected}");
}

#[test]
fn what_cannot_be_varied_is_refused() {
    let mut options = request("baro-line.toml", &[]);
    options.force = -1.0;
    insta::assert_snapshot!(sweep(&options, &FAMILIES, &Unwatched).err().unwrap(), @"option `--force` is -1 N and must be positive");
}
