use std::sync::LazyLock;

use approx::assert_relative_eq;
use dermis_mechanics::shell::Action;
use dermis_skin::SurfaceSpec;
use proptest::prelude::*;

use super::*;

const SHIN: &str = include_str!("../../../../launch/skins/hapdef-shin.toml");

/// The shin as a thin shell on a coarser mesh, which solves in milliseconds.
fn coarse() -> SkinDescription {
    let text = SHIN.replace("spacing = 0.00245", "spacing = 0.005");
    let mut skin = SkinDescription::from_toml(&text, "hapdef-shin.toml").unwrap();
    skin.medium.insert("theory".into(), "kirchhoff-love".into());
    skin
}

static MODEL: LazyLock<ShellModel> = LazyLock::new(|| ShellModel::new(&coarse()).unwrap());

fn press(model: &ShellModel, at: Point3<f64>, force: f64) -> Indentation {
    let (position, normal) = model.surface.project(&at);
    Indentation::sphere(position, -normal * force, 0.010)
}

fn read(model: &ShellModel, contacts: Vec<Indentation>) -> Vec<f64> {
    let mut out = vec![f64::NAN; model.channels()];
    model.response(&Stimulus { contacts, ..Stimulus::default() }, &mut out).unwrap();
    out
}

fn map(model: &ShellModel, contacts: Vec<Indentation>) -> Vec<f64> {
    let mut out = vec![f64::NAN; model.surface.points.len()];
    assert!(model.displacement(&Stimulus { contacts, ..Stimulus::default() }, &mut out).unwrap());
    out
}

/// A place on the material, by the unrolled panel.
fn at(x: f64, arc: f64) -> Point3<f64> {
    let (sin, cos) = (arc / 0.045).sin_cos();
    Point3::new(x, 0.045 * sin, 0.045 * cos)
}

fn refused(from: &str, to: &str) -> String {
    assert!(SHIN.contains(from), "{from} is not in the file");
    let skin = SkinDescription::from_toml(&SHIN.replace(from, to), "hapdef-shin.toml").unwrap();
    ShellModel::new(&skin).unwrap_err().to_string()
}

#[test]
fn the_shin_is_as_large_and_as_fine_as_the_one_of_the_thesis() {
    let skin = SkinDescription::from_toml(SHIN, "hapdef-shin.toml").unwrap();
    let points = skin.surface().points.len();
    assert!((3000..=3300).contains(&points), "{points} points");
    let SurfaceSpec::Panel { size, .. } = skin.surface else { panic!("no panel") };
    assert_eq!((size, skin.channels().len()), ([0.200, 0.120], 10));
    let bridge = Parameters::nominal(&skin).unwrap().bridge.unwrap();
    // What the wire calls a count is what the bridge makes of one.
    assert_relative_eq!(bridge.count(), skin.wire.scale, max_relative = 1e-6);
    assert_relative_eq!(-2048.0 * bridge.count(), skin.wire.offset, max_relative = 1e-6);
}

#[test]
fn a_touch_reads_as_the_shell_under_the_same_forces() {
    let model = &MODEL;
    let contact = press(model, at(0.010, 0.0108), 12.0);
    let mut patch = Vec::new();
    let (_, normal) = model.surface.project(&contact.position);
    model.nodes.patch(&model.surface, &contact.position, &normal, 0.005, &mut patch);
    let load = Action::sum(
        patch
            .iter()
            .map(|(n, w)| (*w, Action::force(*n, contact.force)))
            .collect::<Vec<_>>()
            .iter()
            .map(|(w, a)| (*w, a)),
    );
    let direct = &model.shell().unwrap().solve(&[load]).unwrap()[0];
    let parameters = Parameters::nominal(&coarse()).unwrap();
    for (gauge, strain) in parameters.gauges.iter().zip(read(model, vec![contact])) {
        let row = model.shell().unwrap().gauge(&rectangle(gauge, parameters.thickness, false)).unwrap().row;
        assert_relative_eq!(direct.dot(&row), strain, max_relative = 1e-6, epsilon = 1e-12);
    }
}

/// The coarser shin, computed by the theory that shears.
fn shearing() -> ShellModel {
    let mut skin = coarse();
    skin.medium.insert("theory".into(), "reissner-mindlin".into());
    ShellModel::new(&skin).unwrap()
}

#[test]
fn a_shell_that_shears_is_touched_on_its_outside() {
    let model = shearing();
    let shell = model.shell().unwrap();
    let surface = &model.surface;
    // Refined, and the first nodes under the surface's points.
    assert!(shell.mesh().points.len() > 2 * surface.points.len());
    let thickness = 0.002;
    for ((p, n), middle) in surface.points.iter().zip(&surface.normals).zip(&shell.mesh().points) {
        assert!((p - n * (thickness / 2.0) - middle).norm() < 1e-12);
    }
    let (position, normal) = surface.project(&at(0.010, 0.0108));
    let contact = Indentation::sphere(position, -normal * 12.0 + Vector3::x() * 5.0, 0.010);
    let mut patch = Vec::new();
    model.nodes.patch(surface, &position, &normal, 0.005, &mut patch);
    let parts: Vec<(f64, Action)> = patch
        .iter()
        .flat_map(|&(n, w)| {
            let arm = surface.normals[n] * (thickness / 2.0);
            [(w, Action::force(n, contact.force)), (w, Action::moment(n, arm.cross(&contact.force)))]
        })
        .collect();
    let load = Action::sum(parts.iter().map(|(w, part)| (*w, part)));
    let direct = shell.solve(&[load]).unwrap().remove(0);
    let parameters = Parameters::nominal(&coarse()).unwrap();
    for (gauge, strain) in parameters.gauges.iter().zip(read(&model, vec![contact])) {
        let row = shell.gauge(&rectangle(gauge, thickness, false)).unwrap().row;
        assert_relative_eq!(direct.dot(&row), strain, max_relative = 1e-6, epsilon = 1e-12);
    }
}

#[test]
fn a_shell_that_shears_gives_way_more() {
    let (thin, shearing) = (&MODEL, shearing());
    let contacts = || vec![press(thin, at(0.010, 0.0108), 12.0)];
    let norm = |all: &[f64]| all.iter().map(|v| v * v).sum::<f64>().sqrt();
    let strain = norm(&read(&shearing, contacts())) / norm(&read(thin, contacts()));
    assert!((1.02..1.4).contains(&strain), "{strain}");
    let depth = norm(&map(&shearing, contacts())) / norm(&map(thin, contacts()));
    assert!((1.02..1.4).contains(&depth), "{depth}");
}

#[test]
fn effects_that_differ_from_triangle_to_triangle_reach_its_pieces() {
    let skin = |theory: &str| {
        let mut skin = coarse();
        skin.medium.insert("theory".into(), theory.into());
        skin
    };
    let mut with = skin("reissner-mindlin");
    with.effects = vec![dermis_skin::Effect::new("thickness-field")];
    let [even, uneven] = [&skin("reissner-mindlin"), &with].map(|skin| ShellModel::new(skin).unwrap());
    let contacts = || vec![press(&even, at(0.010, 0.0108), 12.0)];
    let (a, b) = (read(&even, contacts()), read(&uneven, contacts()));
    let change: f64 =
        a.iter().zip(&b).map(|(a, b)| (a - b).abs()).sum::<f64>() / a.iter().map(|a| a.abs()).sum::<f64>();
    assert!((0.005..0.5).contains(&change), "{change}");
}

#[test]
fn a_theory_that_is_none_is_refused() {
    let wrong = refused("\"reissner-mindlin\"", "\"thick\"");
    assert!(wrong.contains("medium.theory") && wrong.contains("reissner-mindlin"), "{wrong}");
}

#[test]
fn a_patch_carries_its_force_where_the_touch_is() {
    let surface = &MODEL.surface;
    let mut patch = Vec::new();
    // On a beam, in the middle of a solid end, on an edge.
    for place in [at(0.010, 0.0108), at(-0.0931, 0.02), at(0.0, 0.060)] {
        let (p, n) = surface.project(&place);
        MODEL.nodes.patch(surface, &p, &n, 0.005, &mut patch);
        let sum: f64 = patch.iter().map(|(_, w)| w).sum();
        assert_relative_eq!(sum, 1.0, max_relative = 1e-9);
        let middle: Vector3<f64> = patch.iter().map(|(i, w)| surface.points[*i].coords * *w).sum();
        let off = middle - p.coords;
        // Along the surface; its chord lies below it.
        assert!((off - n * off.dot(&n)).norm() < 1e-6, "{off}");
    }
}

#[test]
fn the_surface_gives_way_where_it_is_touched() {
    let model = &MODEL;
    let place = at(0.002, 0.0108);
    let found = map(model, vec![press(model, place, 10.0)]);
    let depth = model.depth_at(&place, 0.010, 10.0).unwrap();
    let (deepest, most) = found.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1)).unwrap();
    assert!((model.surface.points[deepest] - place).norm() < 0.006);
    assert!((0.9..1.1).contains(&(most / depth)), "{most} m of {depth} m");
    assert_relative_eq!(model.force_at(&place, 0.010, depth).unwrap(), 10.0, max_relative = 1e-9);
    // Held ends stay where they are, and give no depth.
    let ends = model.surface.points.iter().zip(&found).filter(|(p, _)| p.x.abs() > 0.0999);
    assert!(ends.clone().count() > 20 && ends.into_iter().all(|(_, d)| *d == 0.0));
    assert_eq!(model.depth_at(&at(0.1, 0.0), 0.010, 10.0), None);
}

#[test]
fn what_is_no_touch_is_refused() {
    let wrong = |contact: Indentation| {
        let mut out = [0.0; 10];
        let stimulus = Stimulus { contacts: vec![contact], ..Stimulus::default() };
        MODEL.response(&stimulus, &mut out).unwrap_err().to_string()
    };
    let good = press(&MODEL, at(0.002, 0.0108), 1.0);
    insta::assert_snapshot!(wrong(Indentation { force: Vector3::repeat(f64::NAN), ..good.clone() }), @"contact 0: its position or force is not a number");
    insta::assert_snapshot!(wrong(Indentation { position: Point3::new(0.0, 0.0, 0.045), ..good.clone() }), @"contact 0: (0, 0, 0.045) m lies 0.006794 m off the surface");
    insta::assert_snapshot!(wrong(Indentation { force: -good.force, ..good.clone() }), @"contact 0: it pulls with 0.9999999999999999 N, and this model knows no adhesion");
    insta::assert_snapshot!(wrong(good.with_diameter(0.0)), @"contact 0: its diameter is 0 m and must be 0.0001 to 0.1 m");
}

#[test]
fn refusals_name_field_and_remedy() {
    insta::assert_snapshot!(refused("unit = \"1\"", "unit = \"V\""), @r#"skin `hapdef-shin`: field `unit`: is "V" where strain gauges read "1""#);
    insta::assert_snapshot!(refused("thickness = 0.002", "thickness = -0.002"), @"skin `hapdef-shin`: field `medium.thickness`: is -0.002 and must be a positive number");
    insta::assert_snapshot!(refused("poisson_ratio = 0.394", "poisson_ratio = 0.5"), @"skin `hapdef-shin`: field `medium.poisson_ratio`: is 0.5 and must be at least 0 and below 0.5");
    insta::assert_snapshot!(refused("patch = 0.005", "pach = 0.005"), @"skin `hapdef-shin`: field `medium.pach`: unknown field `pach`, expected one of `thickness`, `young_modulus`, `poisson_ratio`, `gauge`, `patch`, `theory`, `clamp`, `bridge`");
    insta::assert_snapshot!(refused("gain = 330.0", "gain = 0.0"), @"skin `hapdef-shin`: field `medium.bridge.gain`: is 0 and must be a positive number");
    // Gauge g0 above the surface, over an opening, without a direction, and with a foreign normal.
    let first = SHIN.lines().find(|l| l.contains("\"g0\"")).unwrap();
    let gauge = |position: &str, rest: &str| {
        refused(first, &format!("    {{ name = \"g0\", position = {position}{rest} }},"))
    };
    let rest = ", normal = [0.0, 0.0, 1.0], axis = [1.0, 0.0, 0.0]";
    insta::assert_snapshot!(gauge("[0.0129, 0.0, 0.049]", rest), @"skin `hapdef-shin`: field `taxels[0].position`: (0.0129, 0, 0.049) m lies 0.0060 m off the inner face of the shell, whose nearest point is (0.0129, 0.0000, 0.0430) m");
    insta::assert_snapshot!(gauge("[0.0175, 0.0, 0.043]", rest), @"skin `hapdef-shin`: field `taxels[0].position`: only 54 % of its 8 x 5 mm lie on the shell: move it away from the edge");
    insta::assert_snapshot!(gauge("[0.0129, 0.0, 0.043]", ", normal = [0.0, 0.0, 1.0]"), @"skin `hapdef-shin`: field `taxels[0].axis`: is missing: a strain gauge measures along a direction");
    insta::assert_snapshot!(gauge("[0.0129, 0.0, 0.043]", ", normal = [0.0, 1.0, 0.0], axis = [1.0, 0.0, 0.0]"), @"skin `hapdef-shin`: field `taxels[0].normal`: is not that of the surface there, which is [0.0000, 0.0000, 1.0000]");
    insta::assert_snapshot!(refused("patch = 0.005", "clamp = [{ min = [1.0, 1.0, 1.0], max = [2.0, 2.0, 2.0] }]\npatch = 0.005"), @"skin `hapdef-shin`: field `medium.clamp`: holds 0 points of the surface: at least three are needed");
}

#[test]
fn a_mesh_from_a_file_is_a_shell_like_the_panel_it_was_drawn_from() {
    let skin = coarse();
    let surface = skin.surface();
    let folder = tempfile::tempdir().unwrap();
    let mut obj = String::new();
    for p in &surface.points {
        obj += &format!("v {} {} {}\n", p.x * 1e3, p.y * 1e3, p.z * 1e3);
    }
    for t in &surface.triangles {
        obj += &format!("f {} {} {}\n", t[0] + 1, t[1] + 1, t[2] + 1);
    }
    std::fs::write(folder.path().join("shin.obj"), obj).unwrap();
    let panel = SHIN.lines().find(|l| l.starts_with("surface = ")).unwrap();
    let mesh = "surface = { type = \"mesh\", file = \"shin.obj\", scale = 0.001, rims = 36 }";
    let clamp = "clamp = [{ min = [-0.101, -1, -1], max = [-0.0999, 1, 1] }, { min = [0.0999, -1, -1], max = [0.101, 1, 1] }]\n";
    let text = SHIN.replace(panel, mesh).replace("patch = 0.005", &format!("{clamp}patch = 0.005"));
    let text = text.replace("reissner-mindlin", "kirchhoff-love");
    let file = folder.path().join("shin.toml");
    std::fs::write(&file, &text).unwrap();
    let drawn = ShellModel::new(&SkinDescription::load(&file).unwrap()).unwrap();
    let place = at(0.010, 0.0108);
    let (a, b) =
        (read(&MODEL, vec![press(&MODEL, place, 10.0)]), read(&drawn, vec![press(&drawn, place, 10.0)]));
    let most = a.iter().copied().map(f64::abs).fold(0.0, f64::max);
    for (a, b) in a.iter().zip(&b) {
        // Locations lie on chords there, and on arcs here.
        assert_relative_eq!(a, b, epsilon = 0.05 * most);
    }
    // Without saying where it is held, a mesh is no shell.
    std::fs::write(&file, text.replace(clamp, "")).unwrap();
    insta::assert_snapshot!(ShellModel::new(&SkinDescription::load(&file).unwrap()).unwrap_err(), @"skin `hapdef-shin`: field `medium.clamp`: is missing: say where the shell is held, as [{ min = [x, y, z], max = [x, y, z] }] in metres");
}

#[test]
fn stiffening_is_that_of_duffing() {
    let mut parameters = Parameters::nominal(&coarse()).unwrap();
    parameters.stiffening = 0.3;
    let stiff = ShellModel::from_parameters(&coarse(), parameters).unwrap();
    let place = at(0.002, 0.0108);
    let (linear, less) =
        (MODEL.depth_at(&place, 0.01, 20.0).unwrap(), stiff.depth_at(&place, 0.01, 20.0).unwrap());
    let x = less / 0.002;
    assert_relative_eq!(x + 0.3 * x.powi(3), linear / 0.002, max_relative = 1e-9);
    assert_relative_eq!(stiff.force_at(&place, 0.01, less).unwrap(), 20.0, max_relative = 1e-9);
    let (a, b) =
        (read(&MODEL, vec![press(&MODEL, place, 20.0)]), read(&stiff, vec![press(&stiff, place, 20.0)]));
    for (a, b) in a.iter().zip(&b) {
        assert_relative_eq!(b / a, less / linear, max_relative = 1e-6);
    }
}

fn locations() -> impl Strategy<Value = Point3<f64>> {
    (-0.095..0.095f64, -0.058..0.058f64).prop_map(|(x, arc)| MODEL.surface.project(&at(x, arc)).0)
}

proptest! {
    #[test]
    fn touches_add_up(p in locations(), q in locations(), f in 0.5..30.0f64, g in 0.5..30.0f64) {
        let (a, b) = (press(&MODEL, p, f), press(&MODEL, q, g));
        let (one, other, both) =
            (read(&MODEL, vec![a.clone()]), read(&MODEL, vec![b.clone()]), read(&MODEL, vec![a.clone(), b.clone()]));
        for i in 0..both.len() {
            prop_assert!((one[i] + other[i] - both[i]).abs() < 1e-12);
        }
        let (one, other, both) = (map(&MODEL, vec![a.clone()]), map(&MODEL, vec![b.clone()]), map(&MODEL, vec![a, b]));
        for i in 0..both.len() {
            prop_assert!((one[i] + other[i] - both[i]).abs() < 1e-9);
        }
    }

    /// Maxwell and Betti: the place of the touch and the place of the reading may change sides.
    #[test]
    fn displacement_is_reciprocal(p in locations(), q in locations()) {
        let corners = |p: &Point3<f64>| MODEL.nodes.corners(&MODEL.surface, p, &MODEL.surface.project(p).1);
        let (a, b) = (corners(&p), corners(&q));
        let (there, back) = (MODEL.gives(&a, &b), MODEL.gives(&b, &a));
        let scale = (MODEL.gives(&a, &a) * MODEL.gives(&b, &b)).sqrt();
        // The load has a patch and the reading has none: alike where the two are apart.
        prop_assume!((p - q).norm() > 0.02);
        prop_assert!((there - back).abs() < 0.1 * scale, "{there}, {back} of {scale}");
    }

    #[test]
    fn readings_are_smooth_in_the_place(p in locations(), turn in 0.0..std::f64::consts::TAU) {
        let [first, second] = dermis_model::tangents(&MODEL.surface.project(&p).1);
        let step = 5e-5;
        let by = (first * turn.cos() + second * turn.sin()) * step;
        let q = MODEL.surface.project(&(p + by)).0;
        let (a, b) = (read(&MODEL, vec![press(&MODEL, p, 10.0)]), read(&MODEL, vec![press(&MODEL, q, 10.0)]));
        for (a, b) in a.iter().zip(&b) {
            // 10 N make some hundred microstrain, and a gauge's own width is 8 mm.
            prop_assert!((a - b).abs() < 3e-5, "{a} {b}");
        }
    }
}
