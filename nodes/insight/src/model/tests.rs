use dermis_model::{Indentation, Stimulus};
use dermis_skin::{Effect, SkinDescription};
use nalgebra::Vector3;

use super::*;

/// A thumb in few cells and pixels.
pub const SMALL: &str = r#"
schema = "dermis-skin/1"
name = "small"
sensor = "insight"
description = "a thumb of a test"
kind = "simulated"
frame_id = "thumb_link"
unit = "1"
rate = 40.0
noise = 0.001
range = [0.0, 1.0]
surface = { type = "thumb", radius = 0.020, height = 0.070, tip = 0.009, end = 0.0115, spacing = 0.005 }

[medium]
blocks = [10, 8]
skeleton = { beam = 0.0016, inside = 0.0008, rings = [0.020, 0.036, 0.052], meridians = [{ count = 4, from = 0.012, azimuth = 0.0 }] }
fovea = { from_tip = 0.028, azimuth = 0.8, size = [0.013, 0.011], thickness = 0.0012 }

[medium.elastomer]
thickness = 0.004
young_modulus = 70e3
poisson_ratio = 0.49
density = 1070.0
friction = 1.0
cells = [24, 5]
grid = 0.004
reach = 0.012

[medium.camera]
size = [104, 80]
focal = 795.0
height = 0.003
gains = [1.0, 1.0, 2.0]
exposure = 1.0
gamma = 2.2
blue_sees = [0.05, 0.1]

[medium.lamps]
colours = "RGBRGRBG"
azimuth = 0.0
radius = 0.009
height = 0.003
drive = [1.0, 1.0, 0.5]
hole = 0.0025
tilt = 0.0523599
beam = 0.005
spread = 0.21

[medium.finish]
diffuse = 0.5
specular = 0.3
shininess = 12.0
ambient = 0.1

[medium.noise]
difference = 0.012
read = 0.004
"#;

pub fn skin(text: &str) -> SkinDescription {
    dermis_skin::register(crate::FAMILY);
    SkinDescription::from_toml(text, "small").unwrap()
}

pub fn small(effects: Vec<Effect>) -> SkinDescription {
    let mut small = skin(SMALL);
    small.effects = effects;
    small
}

/// A ball of 4 mm that presses straight at a place of the outside, with some shear.
pub fn press(model: &ThumbModel, s: f64, azimuth: f64, force: f64, shear: f64) -> Indentation {
    let (p, _) = model.parameters().elastomer.thumb.point(s, azimuth, 0.0);
    let (at, normal) = model.surface().project(&p);
    let along = dermis_model::tangents(&normal)[0];
    Indentation::sphere(at, -normal * force + along * shear, 0.004)
}

fn touched(contacts: Vec<Indentation>) -> Stimulus {
    Stimulus { contacts, ..Stimulus::default() }
}

fn read(model: &ThumbModel, stimulus: &Stimulus) -> Vec<f64> {
    let mut out = vec![0.0; model.channels()];
    model.response(stimulus, &mut out).unwrap();
    out
}

fn rms(a: &[f64], b: &[f64]) -> f64 {
    (a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>() / a.len() as f64).sqrt()
}

#[test]
fn its_numbers_are_means_over_blocks_of_its_picture() {
    let model = ThumbModel::new(&small(vec![])).unwrap();
    assert_eq!(model.channels(), 3 * 80);
    for contacts in
        [vec![], vec![press(&model, 0.03, 0.7, 0.5, 0.2)], vec![press(&model, 0.006, -2.0, 0.3, 0.0)]]
    {
        let stimulus = touched(contacts);
        let found = read(&model, &stimulus);
        let image = model.capture(&stimulus, &mut || 0.0).unwrap().unwrap();
        let mut seen = vec![0.0; found.len()];
        assert!(model.observe(&image, &mut seen));
        // Bytes round by 1/510 at most, also those of pixels that come to the end of the scale or leave it.
        assert!(found.iter().zip(&seen).all(|(a, b)| (a - b).abs() < 1.001 / 510.0));
        assert!(rms(&found, &seen) < 8e-4, "{}", rms(&found, &seen));
    }
    let other = Image::new(2, 1, PixelFormat::Rgb8, vec![0; 6]).unwrap();
    assert!(!model.observe(&other, &mut vec![0.0; model.channels()]));
}

#[test]
fn a_press_changes_what_the_camera_sees_there_and_more_the_harder_it_is() {
    let model = ThumbModel::new(&small(vec![])).unwrap();
    let idle = read(&model, &Stimulus::default());
    assert!(idle.iter().all(|v| (0.0..=1.0).contains(v)));
    let mut last = 0.0;
    for force in [0.1, 0.3, 1.0] {
        let found = read(&model, &touched(vec![press(&model, 0.03, 2.0, force, 0.0)]));
        let off = rms(&found, &idle);
        assert!(off > 1.5 * last && off > 1e-4, "{force} N: {off}");
        last = off;
        // The block that changes most sees the place that is pressed. Its pixels cover 12°, 5 mm to either side there, and more along the wall,
        // which rays meet at 19°.
        let taxels = &small(vec![]).taxels;
        let change = |k: usize| (0..3).map(|c| (found[3 * k + c] - idle[3 * k + c]).abs()).sum::<f64>();
        let most = (0..taxels.len()).max_by(|a, b| change(*a).total_cmp(&change(*b))).unwrap();
        let at = press(&model, 0.03, 2.0, force, 0.0).position;
        assert!((taxels[most].point() - at).norm() < 0.02, "{most}");
    }
}

#[test]
fn shear_is_seen_and_slips_beyond_friction() {
    let model = ThumbModel::new(&small(vec![])).unwrap();
    let of = |shear: f64| read(&model, &touched(vec![press(&model, 0.03, 2.0, 0.4, shear)]));
    let straight = of(0.0);
    let idle = read(&model, &Stimulus::default());
    assert!(rms(&of(0.2), &straight) > 0.05 * rms(&straight, &idle));
    assert!(rms(&of(0.4), &of(0.8)) < 1e-12);
}

#[test]
fn contacts_that_lie_apart_add_up() {
    let model = ThumbModel::new(&small(vec![])).unwrap();
    let [a, b] = [press(&model, 0.03, 0.5, 0.3, 0.1), press(&model, 0.045, 2.5, 0.5, 0.0)];
    let idle = read(&model, &Stimulus::default());
    let [one, other, both] =
        [vec![a.clone()], vec![b.clone()], vec![a, b]].map(|contacts| read(&model, &touched(contacts)));
    let sum: Vec<f64> = one.iter().zip(&other).zip(&idle).map(|((a, b), i)| a + b - i).collect();
    assert!(rms(&sum, &both) < 0.02 * rms(&both, &idle), "{} of {}", rms(&sum, &both), rms(&both, &idle));
}

#[test]
fn depth_and_force_are_each_other_s_inverse() {
    let model = ThumbModel::new(&small(vec![])).unwrap();
    let at = press(&model, 0.028, 2.0, 0.3, 0.0).position;
    let mut last = 0.0;
    for force in [0.05, 0.3, 1.0] {
        let depth = model.depth_at(&at, 0.004, force).unwrap();
        assert!(depth > last);
        last = depth;
        let back = model.force_at(&at, 0.004, depth).unwrap();
        assert!((back / force - 1.0).abs() < 1e-6, "{force} N at {depth} m is {back} N");
    }
    assert_eq!(model.force_at(&at, 0.004, 0.0), Some(0.0));
    assert!(model.force_at(&at, 0.004, 1.0).is_none());
    let mut give = vec![0.0; model.surface().points.len()];
    assert!(model.displacement(&touched(vec![press(&model, 0.028, 2.0, 0.3, 0.0)]), &mut give).unwrap());
    let most = (0..give.len()).max_by(|a, b| give[*a].total_cmp(&give[*b])).unwrap();
    assert!((model.surface().points[most] - at).norm() < 0.006 && give[most] > 1e-4, "{}", give[most]);
}

#[test]
fn weight_is_seen_by_the_way_it_pulls() {
    let model = ThumbModel::new(&small(vec![])).unwrap();
    let of = |gravity: [f64; 3]| {
        read(&model, &Stimulus { gravity: Vector3::from(gravity), ..Stimulus::default() })
    };
    let idle = of([0.0; 3]);
    let [a, b, c] = [of([9.81, 0.0, 0.0]), of([-9.81, 0.0, 0.0]), of([19.62, 0.0, 0.0])];
    assert!(rms(&a, &idle) > 1e-6);
    let linear = rms(&c, &idle) / rms(&a, &idle);
    assert!((linear - 2.0).abs() < 0.1 && rms(&a, &b) > 1.8 * rms(&a, &idle), "{linear}");
}

fn ridged() -> SkinDescription {
    skin(&SMALL.replacen("blocks", "ridges = { pitch = 0.006, count = 12, height = 0.0008 }\nblocks", 1))
}

/// Of a light press, the numbers of ridges say more than the means do; both follow from the nodes as they do from the picture.
#[test]
fn blocks_say_how_far_their_ridges_have_moved() {
    let model = ThumbModel::new(&ridged()).unwrap();
    assert_eq!(model.channels(), 5 * 80);
    let idle = read(&model, &Stimulus::default());
    let stimulus = touched(vec![press(&model, 0.035, 0.7, 0.3, 0.1)]);
    let found = read(&model, &stimulus);
    let numbers = |image: Image| {
        let mut seen = vec![0.0; model.channels()];
        assert!(model.observe(&image, &mut seen));
        seen
    };
    let seen = numbers(model.capture(&stimulus, &mut || 0.0).unwrap().unwrap());
    let untouched = numbers(model.capture(&Stimulus::default(), &mut || 0.0).unwrap().unwrap());
    let split = |values: &[f64], other: &[f64]| {
        let off = values.iter().zip(other).map(|(a, b)| a - b).enumerate();
        let square = |ridges: bool| {
            off.clone().filter(|(i, _)| (i % 5 >= 3) == ridges).map(|(_, off)| off * off).sum::<f64>().sqrt()
        };
        [square(false), square(true)]
    };
    let change = split(&found, &idle);
    assert!(change[1] > 1.5 * change[0], "{change:?}");
    // Bytes round by 1/510, and a pixel sees ridges of its first harmonic only.
    let signal: Vec<f64> = seen.iter().zip(&untouched).zip(&idle).map(|((s, u), i)| s - u + i).collect();
    let [means, ridges] = split(&signal, &found);
    assert!(means < 0.3 * change[0] && ridges < 0.1 * change[1], "{means} {ridges} of {change:?}");
}

/// What noise makes of each number is what the model says of it.
#[test]
fn numbers_have_the_noise_that_they_are_said_to_have() {
    let model = ThumbModel::new(&ridged()).unwrap();
    let mut seeds = (0..).map(|i| 0.1 + f64::from(i));
    let mut take = || {
        let image = model.capture(&Stimulus::default(), &mut || seeds.next().unwrap()).unwrap().unwrap();
        let mut seen = vec![0.0; model.channels()];
        assert!(model.observe(&image, &mut seen));
        seen
    };
    let pairs = 40;
    let mut chi2 = [0.0; 2];
    for _ in 0..pairs {
        let (a, b) = (take(), take());
        for (i, noise) in model.noise().iter().enumerate() {
            chi2[usize::from(i % 5 >= 3)] += ((a[i] - b[i]) / noise).powi(2) / 2.0;
        }
    }
    for (chi2, each) in chi2.iter().zip([3.0, 2.0]) {
        let ratio = chi2 / (f64::from(pairs) * each * 80.0);
        // Rounding to bytes adds a percent or two.
        assert!((0.9..1.15).contains(&ratio), "{ratio}");
    }
}

/// The slopes that inversion follows are those of differences.
#[test]
fn slopes_are_those_of_small_differences() {
    for skin in [small(vec![]), ridged()] {
        let model = ThumbModel::new(&skin).unwrap();
        let contacts = vec![press(&model, 0.03, 2.0, 0.2, 0.04), press(&model, 0.05, 3.0, 0.3, -0.1)];
        let stimulus = touched(contacts);
        // Steps that 32-bit colours can tell.
        let differences = Differences {
            place: 2e-4,
            force: 0.2,
            least_force: 2e-3,
            moved_force: dermis_model::MovedForce::Turned,
            ..Differences::default()
        };
        let size = model.channels() * 2 * Unknowns::Full.count();
        let (mut quick, mut slow) = (vec![0.0; size], vec![0.0; size]);
        model.jacobian(&stimulus, Unknowns::Full, &differences, &mut quick).unwrap();
        differences.jacobian(&model, &stimulus, Unknowns::Full, &mut slow).unwrap();
        for (k, (quick, slow)) in
            quick.chunks(model.channels()).zip(slow.chunks(model.channels())).enumerate()
        {
            let off = rms(quick, slow) / rms(slow, &vec![0.0; slow.len()]);
            assert!(off < 0.1, "unknown {k}: {off}");
        }
    }
}

/// Where a strong press turns much of the inside to the lamps or away from them, pixels come to the end of their scale or leave it, and slopes are
/// those of the pixels that are open now.
#[test]
fn slopes_are_those_of_the_pixels_that_are_open_now() {
    let bright = skin(&SMALL.replace("exposure = 1.0", "exposure = 4.0"));
    let model = ThumbModel::new(&bright).unwrap();
    let stimulus = touched(vec![press(&model, 0.006, -2.0, 1.0, 0.1)]);
    let mut scratch = Scratch::default();
    model.see(&stimulus, &mut scratch).unwrap();
    let changes = &scratch.changes;
    let switches = model.picture.switches(changes, 1.0);
    let (by, size) = (1e-3, model.channels());
    let mut more = changes.clone();
    more.values.iter_mut().flatten().for_each(|value| *value *= 1.0 + by as f32);
    let [mut now, mut then, mut slope, mut blind] = [(); 4].map(|()| vec![0.0; size]);
    model.picture.respond(&[(changes, 1.0)], 1.0, &mut now);
    model.picture.respond(&[(&more, 1.0)], 1.0, &mut then);
    let differences: Vec<f64> = then.iter().zip(&now).map(|(then, now)| (then - now) / by).collect();
    model.picture.change(changes, &switches, 1.0, &mut slope);
    model.picture.change(changes, &[], 1.0, &mut blind);
    let whole = rms(&differences, &vec![0.0; size]);
    assert!(rms(&slope, &differences) < 0.01 * whole, "{}", rms(&slope, &differences) / whole);
    assert!(rms(&blind, &differences) > 0.1 * whole, "{}", rms(&blind, &differences) / whole);
}

/// Ridges that move change a picture by more than the shape that moves them.
#[test]
fn ridges_make_small_displacements_visible() {
    let ridges = "ridges = { pitch = 0.003, count = 24, height = 0.0005 }\nblocks";
    let [smooth, ridged] = [SMALL.to_owned(), SMALL.replacen("blocks", ridges, 1)].map(|text| {
        let model = ThumbModel::new(&skin(&text)).unwrap();
        let weight = Stimulus { gravity: Vector3::new(98.1, 0.0, 0.0), ..Stimulus::default() };
        let press = touched(vec![press(&model, 0.03, 2.0, 0.5, 0.1)]);
        let [idle, heavy, pressed] = [&Stimulus::default(), &weight, &press].map(|stimulus| {
            let image = model.capture(stimulus, &mut || 0.0).unwrap().unwrap();
            let mut seen = vec![0.0; model.channels()];
            assert!(model.observe(&image, &mut seen));
            assert!(rms(&read(&model, stimulus), &seen) < 4e-3, "{}", rms(&read(&model, stimulus), &seen));
            image
        });
        let difference = |a: &Image, b: &Image| {
            let [a, b] = [a, b].map(|image| image.data().iter().map(|v| f64::from(*v)).collect::<Vec<_>>());
            rms(&a, &b)
        };
        [difference(&heavy, &idle), difference(&pressed, &idle)]
    });
    // Of a press, some ridges move by more than a wave: four times and 1.3 times as much.
    assert!(ridged[0] > 2.0 * smooth[0] && ridged[1] > 1.1 * smooth[1], "{ridged:?} {smooth:?}");
}

#[test]
fn noise_is_as_requested_and_another_each_time() {
    let model = ThumbModel::new(&small(vec![])).unwrap();
    let take = |seed: f64| model.render(&Stimulus::default(), &mut || seed).unwrap().unwrap();
    let [clean, a, b, again] = [0.0, 0.3, -1.7, 0.3].map(take);
    assert_eq!(a, again);
    let difference = |p: &Image, q: &Image| {
        let square = |(p, q): (&u8, &u8)| (f64::from(*p) - f64::from(*q)).powi(2);
        (p.data().iter().zip(q.data()).map(square).sum::<f64>() / p.data().len() as f64).sqrt() / 255.0
    };
    let both = difference(&a, &b);
    // For a picture whose mean is not the one that noise is said for.
    assert!((0.009..0.015).contains(&both), "{both}");
    assert!((difference(&a, &clean) * 2f64.sqrt() / both - 1.0).abs() < 0.1);
}

/// Root mean square distances \[m\] of a contact's force from its middle, along and across the tip's own x.
fn spread(model: &ThumbModel, contact: &Indentation) -> [f64; 2] {
    let Pressed { footprint, .. } = model.footprint(0, contact).unwrap().unwrap();
    let locations = model.parameters().rings.locations();
    let own = |point: usize| {
        let (p, _) = model.parameters().elastomer.thumb.point(locations[point][0], locations[point][1], 0.0);
        contact.tip.orientation.inverse_transform_vector(&(p - contact.position))
    };
    let mean =
        |of: &dyn Fn(Vector3<f64>) -> f64| footprint.shares.iter().map(|(p, w)| of(own(*p)) * w).sum::<f64>();
    let middle = [mean(&|v| v.x), mean(&|v| v.y)];
    [mean(&|v| (v.x - middle[0]).powi(2)).sqrt(), mean(&|v| (v.y - middle[1]).powi(2)).sqrt()]
}

#[test]
fn tips_of_any_shape_press_where_their_faces_are() {
    let text = SMALL.replace("spacing = 0.005", "spacing = 0.002");
    let model = ThumbModel::new(&skin(&text)).unwrap();
    let contact = press(&model, 0.03, 2.0, 1.0, 0.0);
    let normal = model.surface().project(&contact.position).1;
    let with = |shape: TipShape, turn: f64| {
        let mut contact = contact.clone();
        contact.tip = Tip::standing(shape, &normal);
        contact.tip.orientation *= nalgebra::UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn);
        contact
    };
    let wedge = TipShape::Wedge { angle: 1.0, length: 0.012 };
    for turn in [0.0, 0.8, std::f64::consts::FRAC_PI_2] {
        // A sharp edge: its force lies along it, whichever way it is turned.
        let [along, across] = spread(&model, &with(wedge, turn));
        assert!(along > 1.8 * across, "{turn}: {along} {across}");
    }
    let square = spread(&model, &with(TipShape::Box { size: [0.008, 0.008] }, 0.0));
    // Along the meridian, which is straight: around the axis the surface bends away from a long face.
    let long = spread(&model, &with(TipShape::Box { size: [0.004, 0.016] }, 0.0));
    assert!(long[0] < 0.8 * square[0] && long[1] > 1.3 * square[1], "{long:?} {square:?}");
    // Blunter tips of one force sink in less deeply, and deeper ones bear more.
    let at = &contact.position;
    let depth = |shape: TipShape, force: f64| model.depth_of_tip(at, &shape, force).unwrap();
    let [sharp, blunt] = [0.6, 2.6].map(|angle| depth(TipShape::Wedge { angle, length: 0.012 }, 1.0));
    assert!(sharp > 1.2 * blunt, "{sharp} {blunt}");
    let rod = TipShape::Cylinder { diameter: 0.004, length: 0.010 };
    let force = model.force_of_tip(at, &rod, depth(rod, 0.7)).unwrap();
    assert!((force - 0.7).abs() < 0.01, "{force}");
    // All of the force is there, and pictures differ by shape.
    let read = |shape| {
        let mut out = vec![0.0; model.channels()];
        model.response(&touched(vec![with(shape, 0.0)]), &mut out).unwrap();
        out
    };
    let [triangle, hexagon] = [3, 6].map(|sides| read(TipShape::Polygon { sides, diameter: 0.012 }));
    let untouched = {
        let mut out = vec![0.0; model.channels()];
        model.response(&Stimulus::default(), &mut out).unwrap();
        out
    };
    assert!(rms(&triangle, &hexagon) > 0.03 * rms(&triangle, &untouched), "a triangle looks like a hexagon");
    let Pressed { footprint, force, .. } = model.footprint(0, &with(wedge, 0.3)).unwrap().unwrap();
    let sum: f64 = footprint.shares.iter().map(|(_, w)| w).sum();
    assert!((sum - 1.0).abs() < 1e-9 && (force.norm() - 1.0).abs() < 1e-9, "{sum} {force}");
}

#[test]
fn tips_that_look_away_are_refused() {
    let model = ThumbModel::new(&small(vec![])).unwrap();
    let mut contact = press(&model, 0.03, 2.0, 0.4, 0.0);
    let normal = model.surface().project(&contact.position).1;
    contact.tip = Tip::standing(TipShape::Box { size: [0.002, 0.002] }, &normal);
    contact.tip.orientation *= nalgebra::UnitQuaternion::from_axis_angle(&Vector3::x_axis(), 3.0);
    let error = model.response(&touched(vec![contact]), &mut vec![0.0; model.channels()]).unwrap_err();
    assert!(error.to_string().contains("box") && error.to_string().contains("looks away"), "{error}");
}

#[test]
fn numbers_that_cannot_be_are_refused_by_field() {
    dermis_skin::register(crate::FAMILY);
    for (from, to, field) in [
        ("thickness = 0.004", "thickness = 0.04", "medium.elastomer.thickness"),
        ("spacing = 0.005", "spacing = 1e-5", "surface.spacing"),
        ("tip = 0.009", "tip = 0.03", "surface.tip"),
        ("\"RGBRGRBG\"", "\"RGX\"", "medium.lamps.colours"),
        ("size = [104, 80]", "size = [104, 80000]", "medium.camera.size[1]"),
        ("blocks = [10, 8]", "blocks = [10, 800]", "medium.blocks[1]"),
        ("difference = 0.012", "difference = 0.001", "medium.noise.difference"),
        ("beam = 0.0016, inside", "beam = 0.0016, colour = 1.0, inside", "medium.skeleton.colour"),
    ] {
        let text = SMALL.replace(from, to);
        assert_ne!(text, SMALL);
        let error = match SkinDescription::from_toml(&text, "small") {
            Err(error) => error.to_string(),
            Ok(skin) => ThumbModel::new(&skin).unwrap_err().to_string(),
        };
        assert!(error.contains(field), "{field}: {error}");
    }
}
