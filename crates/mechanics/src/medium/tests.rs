use super::*;
use approx::assert_relative_eq;
use proptest::prelude::*;

const E: f64 = 70e3;
const NU: f64 = 0.49;

fn pad(base: Base) -> Medium {
    Medium::layer(E, NU, 0.010, base).unwrap()
}

#[test]
fn point_load_on_half_space_is_boussinesq() {
    let medium = Medium::half_space(E, NU).unwrap();
    let load = Load::Point { force: 1.0 };
    for r in [0.0f64, 0.002, 0.005, 0.020, 0.060] {
        let z = 0.005f64;
        let exact = (1.0 + NU) / (3.0 * PI) * z / (r * r + z * z).powf(1.5);
        assert_relative_eq!(medium.pressure(&load, z, r).unwrap(), exact, max_relative = 1e-9);
    }
    assert_relative_eq!(medium.pressure(&load, 0.005, 0.0).unwrap(), 6324.0, max_relative = 1e-4);
}

/// Reference: an independent Hankel code, confirmed by axisymmetric quadratic finite elements.
#[test]
fn disc_on_bonded_layer() {
    let load = Load::Disc { force: 1.0, radius: 0.001 };
    let peak = 6882.0;
    for (r, expected) in [(0.0, 6882.0), (0.004, 3523.0), (0.010, 597.0), (0.020, 65.5)] {
        let p = pad(Base::Bonded).pressure(&load, 0.005, r).unwrap();
        assert!((p - expected).abs() < 5e-4 * peak, "p({r}) = {p}, expected {expected}");
    }
    let w = pad(Base::Bonded).surface_displacement(&load, 0.0).unwrap();
    assert_relative_eq!(w, 6.313e-3, max_relative = 5e-4);
}

#[test]
fn only_a_slipping_base_has_negative_wings() {
    let load = Load::Point { force: 1.0 };
    let wing = |base| pad(base).pressure(&load, 0.005, 0.020).unwrap();
    assert_relative_eq!(wing(Base::Bonded), 65.0, max_relative = 0.1);
    assert_relative_eq!(wing(Base::Slip), -12.0, max_relative = 0.1);
}

#[test]
fn deep_layer_is_a_half_space() {
    let load = Load::Hertz { force: 0.5, radius: 0.002 };
    let half = Medium::half_space(E, NU).unwrap();
    for base in [Base::Bonded, Base::Slip] {
        let deep = Medium::layer(E, NU, 20.0, base).unwrap();
        for r in [0.0, 0.003, 0.012] {
            let [a, b] = [deep, half].map(|m| m.pressure(&load, 0.004, r).unwrap());
            assert_relative_eq!(a, b, max_relative = 1e-3);
            let [a, b] = [deep, half].map(|m| m.surface_displacement(&load, r).unwrap());
            assert_relative_eq!(a, b, max_relative = 2e-3);
        }
    }
}

#[test]
fn closed_forms_of_the_surface_meet_at_the_edge() {
    let half = Medium::half_space(E, NU).unwrap();
    for load in [Load::Disc { force: 1.0, radius: 0.002 }, Load::Hertz { force: 1.0, radius: 0.002 }] {
        let w = |r| half.surface_displacement(&load, r).unwrap();
        assert_relative_eq!(w(0.002 - 1e-12), w(0.002 + 1e-12), max_relative = 1e-6);
        let far = half.surface_displacement(&Load::Point { force: 1.0 }, 0.5).unwrap();
        assert_relative_eq!(w(0.5), far, max_relative = 1e-5);
    }
}

#[test]
fn shear_on_half_space_is_cerruti() {
    let medium = Medium::half_space(E, NU).unwrap();
    let load = Load::Point { force: 1.0 };
    for r in [0.0f64, 0.002, 0.005, 0.020, -0.020] {
        let z = 0.005f64;
        let exact = (1.0 + NU) / (3.0 * PI) * r / (r * r + z * z).powf(1.5);
        let found = medium.pressure_of_shear(&load, z, r).unwrap();
        assert_relative_eq!(found, exact, max_relative = 1e-9, epsilon = 1e-12);
    }
}

/// [`Medium::kernels`] by another way: the plane wave's displacements and tractions (U, W, T, Σ) obey y' = Ay
/// through the layer, so that expm(Ah) takes them from the surface to the base, where two of them vanish.
fn by_transfer(k: f64, h: f64, depth: f64, base: Base) -> [f64; 2] {
    use nalgebra::{Matrix2, Matrix4, Vector2, Vector4};
    // Lengths in 1/k, stresses in the shear modulus.
    let (mu, lambda) = (1.0, 2.0 * NU / (1.0 - 2.0 * NU));
    let m = lambda + 2.0 * mu;
    // U' = T + W, W' = (Σ − λU)/m, T' = mU + λW', Σ' = −T.
    let a = Matrix4::new(
        0.0,
        1.0,
        1.0 / mu,
        0.0,
        -lambda / m,
        0.0,
        0.0,
        1.0 / m,
        m - lambda * lambda / m,
        0.0,
        0.0,
        lambda / m,
        0.0,
        0.0,
        -1.0,
        0.0,
    );
    let through = (a * (k * h)).exp();
    let held = if base == Base::Bonded { [0, 1] } else { [1, 2] };
    let block = |c: [usize; 2]| Matrix2::from_fn(|i, j| through[(held[i], c[j])]);
    [(Vector2::new(0.0, -1.0), 1.0), (Vector2::new(-1.0, 0.0), -1.0)].map(|(tractions, sign)| {
        let top = block([0, 1]).lu().solve(&(-(block([2, 3]) * tractions))).unwrap();
        let y = (a * (k * depth)).exp() * Vector4::new(top[0], top[1], tractions[0], tractions[1]);
        let sxx = m * y[0] + lambda * (y[3] - lambda * y[0]) / m;
        // The stress under a shear that goes as a sine goes as minus a cosine.
        -sign * (1.0 + NU) / 3.0 * (sxx + y[3])
    })
}

#[test]
fn kernels_agree_with_the_transfer_matrix() {
    for base in [Base::Bonded, Base::Slip] {
        for k in [5.0, 20.0, 70.0, 200.0, 500.0] {
            for depth in [0.001, 0.005, 0.010] {
                let (found, expected) = (pad(base).kernels(k, depth), by_transfer(k, 0.010, depth, base));
                for i in 0..2 {
                    assert_relative_eq!(found[i], expected[i], max_relative = 1e-6, epsilon = 1e-7);
                }
            }
        }
    }
}

#[test]
fn long_waves_of_shear_have_their_limits() {
    for (base, power) in [(Base::Bonded, 1.0), (Base::Slip, -1.0)] {
        let at = |alpha: f64| pad(base).shear_kernel(alpha / 0.010, 0.005);
        for alpha in [1e-5, 9.99e-4, 1.001e-3, 3e-3] {
            assert_relative_eq!(at(alpha), at(0.01) * (alpha / 0.01).powf(power), max_relative = 1e-2);
        }
    }
}

#[test]
fn a_base_between_is_that_mixture() {
    let load = Load::Hertz { force: 1.0, radius: 0.001 };
    for slip in [0.0, 0.3, 1.0] {
        let medium = Medium::mixed(E, NU, 0.010, slip).unwrap();
        for r in [0.0, 0.004, 0.020] {
            let normal = |m: &Medium| m.pressure(&load, 0.005, r).unwrap();
            let shear = |m: &Medium| m.pressure_of_shear(&load, 0.005, r).unwrap();
            let ends = |f: &dyn Fn(&Medium) -> f64| {
                (1.0 - slip) * f(&pad(Base::Bonded)) + slip * f(&pad(Base::Slip))
            };
            assert_relative_eq!(normal(&medium), ends(&normal), max_relative = 1e-9);
            assert_relative_eq!(shear(&medium), ends(&shear), max_relative = 1e-9);
        }
    }
    assert_eq!(Medium::mixed(E, NU, 0.010, 0.0), Medium::layer(E, NU, 0.010, Base::Bonded));
}

#[test]
fn kernels_stay_finite_from_the_longest_to_the_shortest_wave() {
    for base in [Base::Bonded, Base::Slip] {
        for exponent in -120..=80 {
            let k = 10f64.powf(f64::from(exponent) / 10.0);
            let p = pad(base).pressure_kernel(k, 0.005);
            let w = pad(base).displacement_kernel(k);
            assert!(p.is_finite() && p.abs() < 2.0, "{base:?} k={k}: {p}");
            assert!((k * pad(base).shear_kernel(k, 0.005)).is_finite(), "{base:?} k={k}");
            assert!(w.is_finite() && w > 0.0, "{base:?} k={k}: {w}");
        }
    }
}

#[test]
fn impossible_numbers_are_refused_by_name() {
    let refused = |m: Result<Medium, MechanicsError>| m.unwrap_err().to_string();
    insta::assert_snapshot!(refused(Medium::half_space(-1.0, NU)), @"Young's modulus [Pa] is -1 and must be a positive number");
    insta::assert_snapshot!(refused(Medium::half_space(E, 0.5)), @"Poisson's ratio is 0.5 and must be between 0 and 0.4999");
    insta::assert_snapshot!(refused(Medium::layer(E, NU, f64::NAN, Base::Slip)), @"thickness [m] is NaN and must be a positive number");
    insta::assert_snapshot!(refused(Medium::mixed(E, NU, 0.01, 1.1)), @"share of slip at the base is 1.1 and must be between 0 and 1");
    let deep = pad(Base::Bonded).pressure(&Load::Point { force: 1.0 }, 0.011, 0.0).unwrap_err();
    insta::assert_snapshot!(deep, @"depth is 0.011 m and must lie between the surface and the base of the layer at 0.01 m");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn field_is_linear_in_force_and_even(
        nu in 0.0..0.4999f64, h in 0.002..0.05f64, part in 0.05..1.0f64, r in 0.0..0.05f64, force in 0.01..10.0f64,
        slip in any::<bool>(),
    ) {
        let base = if slip { Base::Slip } else { Base::Bonded };
        let medium = Medium::layer(E, nu, h, base).unwrap();
        let z = part * h;
        let one = medium.pressure(&Load::Point { force: 1.0 }, z, r).unwrap();
        let many = medium.pressure(&Load::Point { force }, z, -r).unwrap();
        prop_assert!((many - force * one).abs() <= 1e-9 * force * one.abs() + 1e-9);
        let axis = medium.pressure(&Load::Point { force: 1.0 }, z, 0.0).unwrap();
        prop_assert!(axis >= one.abs(), "{} on the axis, {} off it", axis, one);
    }
}
