#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    fn options(skin: &str, vary: &[Parameter]) -> Options {
        Options {
            skin: Path::new(env!("CARGO_MANIFEST_DIR")).join("../launch/skins").join(skin),
            vary: vary.to_vec(),
            force: 0.3,
            diameter: 0.004,
            line: false,
            out: None,
            json: false,
        }
    }

    fn sweeps(options: &Request) -> (Figures, Vec<Sweep>, SkinDescription) {
        let mut skin = SkinDescription::load(&options.skin).unwrap();
        coarsen(&mut skin);
        let model = (crate::registry::family(&skin).unwrap().model)(&skin).unwrap();
        let nominal = figures(&skin, model.as_ref(), options).unwrap();
        let progress = ProgressBar::hidden();
        let sweeps = sweep(&options.vary, &skin, (&model, nominal), options, &progress).unwrap();
        (nominal, sweeps, skin)
    }

    #[test]
    fn noise_and_modulus_do_what_a_formula_says() {
        let options =
            Options { line: true, ..options("baro-line.toml", &[Parameter::Noise, Parameter::Modulus]) };
        let (_, sweeps, _) = sweeps(&options);
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
            Options { line: true, ..options("baro-line.toml", &[Parameter::Depth, Parameter::Thickness]) };
        let (nominal, sweeps, skin) = sweeps(&options);
        let depth = &sweeps[0];
        // Below the base of the medium there is none.
        assert!(depth.variants.len() >= 7 && depth.variants.iter().all(|v| v.value <= 0.0101));
        let text = text(&skin, nominal, &sweeps, &options);
        assert!(text.contains("depth") && text.contains("thickness") && text.contains("helps"), "{text}");
        let html = html(&skin, &text, &sweeps).unwrap();
        assert_eq!(html.matches("<svg").count(), 8);
    }

    #[test]
    fn what_cannot_be_built_is_left_out_and_named() {
        let options = Options { line: true, ..options("baro-line.toml", &[Parameter::Depth]) };
        let mut skin = SkinDescription::load(&options.skin).unwrap();
        // Twice as deep, the taxels lie below a thinner medium.
        *skin.medium.get_mut("thickness").unwrap() = 0.008.into();
        let model = (crate::registry::family(&skin).unwrap().model)(&skin).unwrap();
        let nominal = figures(&skin, model.as_ref(), &options).unwrap();
        let progress = ProgressBar::hidden();
        let sweeps = sweep(&options.vary, &skin, (&model, nominal), &options, &progress).unwrap();
        assert_eq!(sweeps[0].variants.len(), FACTORS.len() - 1);
        insta::assert_snapshot!(sweeps[0].refused[0], @"depth of 10: skin `baro-line`: field `taxels[0].position`: z of `b0` is -0.01 m and must lie in the medium: below 0 and not below -0.008 m");
    }

    fn approx_eq(found: f64, expected: f64, within: f64) {
        assert!((found - expected).abs() < within, "{found}, not {expected}");
    }

    #[test]
    fn what_cannot_be_varied_is_refused() {
        let mut options = options("baro-line.toml", &[]);
        options.force = -1.0;
        insta::assert_snapshot!(run(&options).unwrap_err(), @"option `--force` is -1 N and must be positive");
    }
}
