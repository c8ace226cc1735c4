//! A shell with strain gauges, across processes: a device behind a pseudo-terminal in both of its protocols, the program, and
//! what a planner hears: contacts, maps, and which gauges are out of order.

#![expect(clippy::unwrap_used, reason = "a panic is the report of a failed test")]

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Receiver;
use std::time::Duration;

use dermis_estimate::testing::linear_graph;
use dermis_inference::{
    Baseline, Bundle, BundleWriter, CorrectionSection, FeatureConfig, MAP_DISPLACEMENT, Manifest,
    ModelSection, OutputConfig, OutputSpec, PeakSection, TrainingSection,
};
use dermis_integration_tests::{Peer, client_python, program, root};
use dermis_inversion::{Correction, CorrectionSettings, ForcePrior, PeakSettings, Search, Settings};
use dermis_model::Indentation;
use dermis_msgs::diagnostic_msgs::msg::DiagnosticStatus;
use dermis_msgs::msg::{Contact, ContactArray, DisplacementMap, ForceMap};
use dermis_node::Qos;
use dermis_skin::{SkinDescription, Surface};
use dermis_transport::Pty;
use nalgebra::{DMatrix, Point3, Vector3};

use limb::{FAILED, Limb, PRESS, TWO, both, model, pressed, presses, strain};
use operator::Operator;

mod limb;
mod operator;

const SOON: Duration = Duration::from_secs(90);
/// \[N\] of every press.
const FORCE: f64 = 12.0;
/// \[m\] of the tip.
const TIP: f64 = 0.01;

fn shin() -> PathBuf {
    root().join("launch/skins/hapdef-shin.toml")
}

/// The shin with another line, and gauges that tell a broken one from a press.
fn wired(folder: &Path, protocol: &str, rate: f64) -> PathBuf {
    let text = std::fs::read_to_string(shin()).unwrap();
    let replaced = ["wire =", "rate =", "condition ="];
    let skin = SkinDescription::load(shin()).unwrap();
    let (scale, offset) = (skin.wire.scale, skin.wire.offset);
    let mut lines: Vec<String> =
        text.lines().filter(|l| !replaced.iter().any(|r| l.starts_with(r))).map(str::to_owned).collect();
    let at = lines.iter().position(|l| l.starts_with("surface")).unwrap();
    lines.insert(
        at,
        format!(
            "rate = {rate:?}\ncondition = {{ coupled = true }}\n\
             wire = {{ protocol = \"{protocol}\", scale = {scale:e}, offset = {offset:e}, counts = [0, 4095] }}"
        ),
    );
    let path = folder.join(format!("shin-{protocol}.toml"));
    std::fs::write(&path, lines.join("\n")).unwrap();
    path
}

/// The place of the outside next to x and y \[m\].
fn place(surface: &Surface, x: f64, y: f64) -> (Point3<f64>, Vector3<f64>) {
    let away = |i: &usize| (surface.points[*i].x - x).hypot(surface.points[*i].y - y);
    let nearest = (0..surface.points.len()).min_by(|a, b| away(a).total_cmp(&away(b))).unwrap();
    (surface.points[nearest], surface.normals[nearest])
}

/// A bundle that has learned nothing: all that is found, the forward model finds, with these settings.
fn bundle(folder: &Path, settings: Settings) -> PathBuf {
    let skin = SkinDescription::load(shin()).unwrap();
    let channels = skin.channels().len();
    let middle = place(&skin.surface(), 0.0, 0.0).0;
    let input = FeatureConfig::newest(vec![0.0; channels], vec![1e-4; channels]);
    let answers = [
        ("position.x", "m", middle.x),
        ("position.y", "m", middle.y),
        ("position.z", "m", middle.z),
        ("force.normal", "N", 5.0),
    ];
    let output = OutputConfig {
        values: answers
            .iter()
            .map(|(name, unit, value)| OutputSpec::new(*name, *unit, *value, 1.0))
            .collect(),
    };
    let weights = vec![0.0; channels * answers.len()];
    let graph = linear_graph("nothing", [channels, answers.len()], &weights);
    let mut manifest =
        Manifest::new("shin", &skin, Baseline::Tared, input, output, TrainingSection::default());
    manifest.force_range = Some([0.0, 35.0]);
    manifest.inversion = Some(settings);
    let path = folder.join("bundle");
    BundleWriter::new(manifest).write(&path, &graph).unwrap();
    path
}

fn pressing(contact: &Contact) -> f64 {
    -(contact.force.x * contact.normal.x
        + contact.force.y * contact.normal.y
        + contact.force.z * contact.normal.z)
}

fn apart(contact: &Contact, place: &Point3<f64>) -> f64 {
    (Point3::new(contact.position.x, contact.position.y, contact.position.z) - place).norm()
}

/// \[m\] standard deviation of a contact's place, all directions together.
fn deviation(contact: &Contact) -> f64 {
    let c = &contact.position_covariance;
    (c[0] + c[4] + c[8]).sqrt()
}

fn untouched(array: &ContactArray) -> bool {
    array.status == ContactArray::STATUS_OK && array.contacts.is_empty()
}

/// A simulated limb on this line, pressed in two locations over and over: both are found, and the maps say the same.
fn pressed_and_found(protocol: &str, rate: f64) {
    let mut operator = Operator::new();
    let skin = wired(operator.folder.path(), protocol, rate);
    let surface = SkinDescription::load(&skin).unwrap().surface();
    let locations = [place(&surface, 0.03, 0.005).0, place(&surface, -0.04, -0.02).0];
    let at: Vec<String> = locations.iter().map(|p| format!("[{:.6}, {:.6}, {:.6}]", p.x, p.y, p.z)).collect();
    let plan = operator.path("plan.toml");
    std::fs::write(
        &plan,
        format!(
            "schema = \"dermis-plan/1\"\nname = \"two\"\nseed = 1\ndiameter = {TIP}\n[timing]\napproach = [0.1, 0.1]\n\
             load = [0.3, 0.3]\nhold = [1.5, 1.5]\nunload = [0.3, 0.3]\ngap = [1.0, 1.0]\n\
             [[steps]]\nkind = \"idle\"\nduration = 8.0\n\
             [[steps]]\nkind = \"locations\"\nat = [{}]\nforces = [{FORCE:?}]\n",
            at.join(", ")
        ),
    )
    .unwrap();
    let forces: Receiver<ForceMap> = operator.listen("force_map", Qos::sensor_data());
    let displacements: Receiver<DisplacementMap> = operator.listen("displacement_map", Qos::sensor_data());
    // The device begins untouched, and the node takes its zero there: it must be there first.
    let _node = operator.start(&skin, &[]);
    operator.contacts_say("that no device is there", |a| a.status == ContactArray::STATUS_STALE);
    let mut device = Peer::start(
        Command::new(program("dermis"))
            .args(["device", "simulate"])
            .arg(&skin)
            .arg("--plan")
            .arg(&plan)
            .arg("--link")
            .arg(operator.path("tty")),
    );
    device.expect("", SOON);
    operator.contacts_say("that nothing touches", untouched);

    let held = |c: &Contact| (pressing(c) - FORCE).abs() < 0.1 * FORCE;
    for place in &locations {
        // First guesses say that they are: a search takes its time on a machine at full load.
        let found = operator.contacts_say("where it is pressed", |array| {
            let searched = array.status == ContactArray::STATUS_OK;
            searched && array.contacts.iter().any(|c| held(c) && apart(c, place) < 0.004)
        });
        assert_eq!((found.status, found.contacts.len()), (ContactArray::STATUS_OK, 1), "{found:#?}");
        let contact = &found.contacts[0];
        assert!(contact.track_id > 0 && deviation(contact) < 0.01, "{contact:#?}");
        // The same contact for as long as it is found there: \[s\] and identity, frame by frame. At its very end, when it fades
        // into the noise, its place is open.
        let seconds = |array: &ContactArray| array.header.stamp.as_nanos() as f64 * 1e-9;
        let mut seen = vec![(seconds(&found), contact.track_id)];
        operator.contacts_say("that it ended", |array| {
            let there = array.contacts.iter().filter(|c| apart(c, place) < 0.01);
            seen.extend(there.map(|c| (seconds(array), c.track_id)));
            array.contacts.is_empty()
        });
        // A device that this machine left no time to sends nothing for a while, and begins anew.
        let longest = 0.1_f64.max(2.0 / rate);
        let changed = seen.windows(2).find(|pair| pair[1].0 - pair[0].0 < longest && pair[1].1 != pair[0].1);
        assert_eq!(changed, None, "{seen:?}");
    }

    let map = operator.hears(&forces, "which forces press", |map| map.forces.iter().any(|f| *f > 1.0));
    assert_eq!((map.kind, map.forces.len()), (ForceMap::KIND_NORMAL, surface.points.len()));
    let sum = |map: &ForceMap| map.forces.iter().map(|f| f64::from(*f)).sum::<f64>();
    let whole = operator.hears(&forces, "the whole force", |map| (sum(map) - FORCE).abs() < 0.1 * FORCE);
    assert!(whole.geometry_id.starts_with("hapdef-shin/") && whole.header.frame_id == "shin_link");
    // The deepest point is where it is pressed.
    let deepest = |map: &DisplacementMap| {
        let at = (0..map.displacements.len())
            .max_by(|a, b| map.displacements[*a].total_cmp(&map.displacements[*b]));
        at.map_or((Point3::origin(), 0.0), |i| (surface.points[i], map.displacements[i]))
    };
    let pushed = operator.hears(&displacements, "how far it gives way", |map| deepest(map).1 > 3e-4);
    assert_eq!((pushed.displacements.len(), pushed.geometry_id), (surface.points.len(), whole.geometry_id));
    operator.hears(&displacements, "that it is deepest under the press", |map| {
        let (point, depth) = deepest(map);
        depth > 3e-4 && locations.iter().any(|place| (point - place).norm() < 0.015)
    });
    let flat = |map: &DisplacementMap| map.displacements.iter().all(|d| *d == 0.0);
    operator.hears(&displacements, "that nothing touches", flat);
}

#[test]
fn a_limb_that_sends_frames_a_thousand_times_a_second() {
    pressed_and_found("native", 1000.0);
}

#[test]
fn a_limb_that_sends_lines_of_counts_ten_times_a_second() {
    pressed_and_found("ascii", 10.0);
}

/// What tells a gauge that fails from a press (`condition.coupled` of the skin).
#[test]
fn no_press_is_detected_by_one_gauge_alone() {
    let skin = SkinDescription::load(shin()).unwrap();
    let [_, rail] = skin.channels()[0].range.unwrap();
    let mut least = f64::INFINITY;
    for (position, normal) in model().surface().points.iter().zip(&model().surface().normals) {
        let press = Indentation::sphere(*position, -normal * FORCE, TIP);
        let mut strain: Vec<f64> = strain(vec![press]).iter().map(|s| s.abs()).collect();
        strain.sort_by(f64::total_cmp);
        // Only one that is at its rail comes into question, and a harder press is detected more by the others, too.
        if strain[9] > 0.02 * rail {
            least = least.min(strain[8] / strain[9]);
        }
    }
    assert!(least > 1.0 / 15.0, "the second feels 1/{:.0} of the first", 1.0 / least);
}

#[test]
fn gauges_that_fail_are_left_out_and_named() {
    let operator = Operator::new();
    let skin = wired(operator.folder.path(), "native", f64::from(Limb::RATE));
    let limb = Limb::plug(&operator.path("tty"));
    let _node = operator.start(&skin, &["--mask", "g9"]);
    let named = |array: &ContactArray, gauges: &[&str]| {
        array.status == ContactArray::STATUS_DEGRADED && gauges.iter().all(|g| array.status_text.contains(g))
    };
    let gone = ["2 of 10 channels are impaired", "g6 (dead, saturated)", "g9 (masked)"];
    operator.contacts_say("what is out of order", |a| named(a, &gone) && a.contacts.is_empty());
    let status = operator.hears(&operator.diagnostics, "which gauges", |s| s.message.contains("g6 (dead"));
    let value = |key: &str| status.values.iter().find(|v| v.key == key).map_or("", |v| v.value.as_str());
    assert_eq!((value("dead channels"), value("masked channels")), ("g6", "g9"));
    assert_eq!(status.level, DiagnosticStatus::WARN);

    // The other eight find it.
    let there = |c: &Contact| (pressing(c) - FORCE).abs() < 0.15 * FORCE && apart(c, &pressed().0) < 0.008;
    limb.becomes(PRESS);
    let eight = operator.contacts_say("the press", |a| named(a, &gone) && a.contacts.iter().any(there));
    assert!(deviation(&eight.contacts[0]) > 0.0 && eight.contacts[0].confidence < 0.9, "{eight:#?}");

    let before = median_deviation(&operator, there);

    // One more fails while nothing touches: it is never taken for a contact, and the other seven go on.
    limb.becomes(0);
    operator.contacts_say("the release", |a| a.contacts.is_empty());
    limb.becomes(FAILED);
    let gone = ["3 of 10 channels are impaired", "g1 (saturated, stuck)"];
    let mut contacts = 0;
    operator.contacts_say("that it is broken", |a| {
        contacts += a.contacts.len();
        named(a, &gone) && a.contacts.is_empty()
    });
    assert_eq!(contacts, 0, "a gauge that fails is no contact");
    limb.becomes(FAILED | PRESS);
    let seven = operator.contacts_say("the press again", |a| named(a, &gone) && a.contacts.iter().any(there));
    assert!(deviation(&seven.contacts[0]) > 0.0, "{seven:#?}");
    let now = median_deviation(&operator, there);
    assert!(now > before, "with seven gauges {now} m, with eight {before} m");
}

/// Median over frames of how well a contact's place is known \[m\]: one frame's word for it depends on its noise.
fn median_deviation(operator: &Operator, there: impl Fn(&Contact) -> bool) -> f64 {
    let mut seen = Vec::new();
    operator.contacts_say("where it is pressed, many times", |array| {
        seen.extend(array.contacts.iter().filter(|c| there(c)).map(deviation));
        seen.len() >= 200
    });
    seen.sort_by(f64::total_cmp);
    seen[seen.len() / 2]
}

/// Settings of an inversion that tells two contacts apart.
fn two() -> Settings {
    let mut settings = Settings::new(TIP, 40.0);
    (settings.contacts, settings.distance) = (2, 0.012);
    (settings.force_prior, settings.search) = (ForcePrior::Log, Search::Pairs);
    settings
}

/// Adds a correction to a bundle: gauges that read so many times what the design says, learned from a few presses.
fn correct(path: &Path, gains: &[f64]) {
    let mut bundle = Bundle::load(path, &SkinDescription::load(shin()).unwrap()).unwrap();
    let all = presses(&[both()[0], both()[1], pressed().0]);
    let read: Vec<Vec<f32>> = all
        .iter()
        .map(|press| strain(vec![press.clone()]).iter().zip(gains).map(|(s, g)| (s * g) as f32).collect())
        .collect();
    let labelled: Vec<_> = all.iter().zip(read.iter().map(Vec::as_slice)).collect();
    let settings = CorrectionSettings::default();
    let correction = Correction::fit(model().as_ref(), &labelled, gains, &settings).unwrap();
    let left = [0.0, correction.remainder(model().as_ref(), &labelled).unwrap()];
    assert!(left[1] < 0.1, "{left:?}");
    let mut manifest = bundle.manifest().clone();
    manifest.correction =
        Some(CorrectionSection { data_hash: "sha256:0".into(), presses: 3, left, ..Default::default() });
    bundle.amend(manifest, Some(correction)).unwrap();
}

/// Both contacts are there, each near its place, with identities of their own that last; the sum of their forces.
fn both_are_found(operator: &Operator, near: f64) -> f64 {
    let found = |array: &ContactArray| {
        array.contacts.len() == 2
            && both().iter().all(|place| array.contacts.iter().any(|c| apart(c, place) < near))
    };
    let first = operator.contacts_say("two contacts", found);
    let ids = |array: &ContactArray| {
        both().map(|place| {
            let nearest = |a: &&Contact, b: &&Contact| apart(a, &place).total_cmp(&apart(b, &place));
            array.contacts.iter().min_by(nearest).map_or(0, |c| c.track_id)
        })
    };
    let seconds = |array: &ContactArray| array.header.stamp.as_nanos() as f64 * 1e-9;
    let mut seen = vec![(seconds(&first), ids(&first))];
    operator.contacts_say("them again and again", |array| {
        if found(array) {
            seen.push((seconds(array), ids(array)));
        }
        seen.len() > 20
    });
    assert!(seen.iter().all(|(_, [a, b])| a != b && *a > 0 && *b > 0), "{seen:?}");
    // Frames that lie further apart have been dropped.
    let changed = seen.windows(2).find(|pair| pair[1].0 - pair[0].0 < 0.1 && pair[1].1 != pair[0].1);
    assert_eq!(changed, None, "{seen:?}");
    first.contacts.iter().map(pressing).sum()
}

#[test]
fn two_contacts_on_a_limb_that_is_not_as_designed() {
    let mut operator = Operator::new();
    let skin = wired(operator.folder.path(), "native", f64::from(Limb::RATE));
    let gains = [1.2, 0.85, 1.1, 0.9, 0.8, 1.15, 1.2, 0.85, 1.1, 0.9];
    let model = bundle(operator.folder.path(), two());
    correct(&model, &gains);
    let displacements: Receiver<DisplacementMap> = operator.listen("displacement_map", Qos::sensor_data());
    let forces: Receiver<ForceMap> = operator.listen("force_map", Qos::sensor_data());
    let limb = Limb::made(&operator.path("tty"), None, gains);
    let _node = operator.start_with(&skin, &model, &[]);
    operator.contacts_say("that nothing touches", untouched);
    limb.becomes(TWO);
    let sum = both_are_found(&operator, 0.004);
    assert!((sum - 2.0 * FORCE).abs() < 0.1 * FORCE, "{sum} N");
    // Both maps are of both.
    let surface = SkinDescription::load(&skin).unwrap().surface();
    let under = |place: &Point3<f64>, values: &[f32], reach: f64| {
        let near = surface.points.iter().zip(values).filter(|(p, _)| (*p - place).norm() < reach);
        near.map(|(_, v)| *v).fold(0.0, f32::max)
    };
    operator.hears(&forces, "forces in both locations", |map| {
        both().iter().all(|place| under(place, &map.forces, 0.008) > 0.5)
    });
    operator.hears(&displacements, "that both locations give way", |map| {
        both().iter().all(|place| under(place, &map.displacements, 0.004) > 3e-4)
    });
    limb.becomes(0);
    operator.contacts_say("the release", untouched);
}

#[test]
fn two_contacts_a_thousand_times_a_second_are_looked_for_in_the_newest_frame() {
    let operator = Operator::new();
    let skin = wired(operator.folder.path(), "native", 1000.0);
    let at: Vec<String> = both().iter().map(|p| format!("[{:.6}, {:.6}, {:.6}]", p.x, p.y, p.z)).collect();
    let plan = operator.path("plan.toml");
    std::fs::write(
        &plan,
        format!(
            "schema = \"dermis-plan/1\"\nname = \"many\"\nseed = 1\ndiameter = {TIP}\n[timing]\napproach = [0.1, 0.1]\n\
             load = [0.3, 0.3]\nhold = [3.0, 3.0]\nunload = [0.3, 0.3]\ngap = [1.0, 1.0]\n\
             [[steps]]\nkind = \"idle\"\nduration = 8.0\n\
             [[steps]]\nkind = \"multi\"\ncount = 20\ncontacts = [2, 2]\ndistance = 0.05\nforce = [10.0, 30.0]\n\
             [[steps]]\nkind = \"locations\"\nat = [{}]\nforces = [{FORCE:?}]\n",
            at.join(", ")
        ),
    )
    .unwrap();
    let _node = operator.start_with(&skin, &bundle(operator.folder.path(), two()), &[]);
    operator.contacts_say("that no device is there", |a| a.status == ContactArray::STATUS_STALE);
    let mut simulate = Command::new(program("dermis"));
    simulate.args(["device", "simulate"]).arg(&skin).arg("--plan").arg(&plan);
    let mut device = Peer::start(simulate.arg("--link").arg(operator.path("tty")));
    device.expect("", SOON);
    operator.contacts_say("that nothing touches", untouched);
    operator.contacts_say("two contacts", |a| a.contacts.len() == 2);
    let status = operator.hears(&operator.diagnostics, "that frames are dropped", |s| {
        s.message.contains("the newest is taken and others are dropped")
    });
    assert_eq!(status.level, DiagnosticStatus::WARN);
    let value = |key: &str| {
        let found = status.values.iter().find(|v| v.key == key).map(|v| v.value.clone());
        found.unwrap_or_else(|| panic!("{key} is not in {status:#?}"))
    };
    assert!(value("frames dropped").parse::<u64>().unwrap() > 0, "{status:#?}");
    assert_eq!(value("bytes dropped"), "0", "nothing of the line is lost");
    assert!(value("undetectable [% of surface]").contains("(a press of 4.00 N)"), "{status:#?}");
}

/// A bundle whose network knows two presses: the map of any readings is the sum of a bell about either place, as high as
/// what of the readings is along what that press reads.
fn maps_bundle(folder: &Path) -> PathBuf {
    let skin = SkinDescription::load(shin()).unwrap();
    let (channels, points) = (skin.channels().len(), skin.surface().points.len());
    let columns: Vec<f64> = both().iter().flat_map(|place| strain(presses(&[*place]))).collect();
    let signals = DMatrix::from_column_slice(channels, 2, &columns);
    let amplitudes = signals.pseudo_inverse(1e-12).unwrap();
    let bells = DMatrix::from_fn(points, 2, |i, k| {
        let distance = (skin.surface().points[i] - both()[k]).norm();
        DEEP * (-distance * distance / (2.0 * 0.012 * 0.012)).exp()
    });
    // Inputs × outputs, row by row, for inputs in units of 1e-4.
    let weights: Vec<f32> = (bells * amplitudes * 1e-4).iter().map(|v| *v as f32).collect();
    let graph = linear_graph("maps", [channels, points], &weights);
    let sensitivity = linear_graph("sensitivity", [4, 1], &[0.0, 0.0, 0.0, (FORCE / DEEP) as f32]);
    let mut map = OutputSpec::new(MAP_DISPLACEMENT, "m", 0.0, 1.0);
    map.count = points;
    let input = FeatureConfig::newest(vec![0.0; channels], vec![1e-4; channels]);
    let output = OutputConfig { values: vec![map] };
    let mut manifest =
        Manifest::new("maps", &skin, Baseline::Tared, input, output, TrainingSection::default());
    manifest.force_range = Some([0.0, 35.0]);
    manifest.peaks = Some(PeakSection {
        settings: PeakSettings { least_force: 2.0, share: 0.2, ..PeakSettings::default() },
        weights: Vec::new(),
        position_sigma: Some(0.003),
        force_sigma: Some(0.5),
        sensitivity: ModelSection::default(),
    });
    let mut writer = BundleWriter::new(manifest);
    writer.sensitivity = Some(sensitivity);
    let path = folder.join("maps");
    writer.write(&path, &graph).unwrap();
    path
}

/// \[m\] by which the surface of [`maps_bundle`] gives way.
const DEEP: f64 = 1e-3;

#[test]
fn contacts_are_the_peaks_of_a_map_where_a_bundle_says_so() {
    let mut operator = Operator::new();
    let skin = wired(operator.folder.path(), "native", f64::from(Limb::RATE));
    let displacements: Receiver<DisplacementMap> = operator.listen("displacement_map", Qos::sensor_data());
    let forces: Receiver<ForceMap> = operator.listen("force_map", Qos::sensor_data());
    let limb = Limb::made(&operator.path("tty"), None, [1.0; 10]);
    let _node = operator.start_with(&skin, &maps_bundle(operator.folder.path()), &[]);
    operator.contacts_say("that nothing touches", untouched);
    limb.becomes(TWO);
    let sum = both_are_found(&operator, 0.005);
    assert!((sum - 2.0 * FORCE).abs() < 0.1 * FORCE, "{sum} N");
    let deepest = |map: &DisplacementMap| map.displacements.iter().copied().fold(0.0, f32::max);
    operator.hears(&displacements, "how far it gives way", |map| {
        (f64::from(deepest(map)) - DEEP).abs() < 0.1 * DEEP
    });
    let whole = |map: &ForceMap| map.forces.iter().map(|f| f64::from(*f)).sum::<f64>();
    operator.hears(&forces, "both forces", |map| (whole(map) - sum).abs() < 0.1 * FORCE);
    limb.becomes(0);
    operator.contacts_say("the release", untouched);
}

/// The bundle of networks that ships: learned on a limb with the default effects, so that this one, as designed, is another device.
#[test]
fn the_networks_that_ship_find_a_press_and_map_it() {
    let mut operator = Operator::new();
    let skin = wired(operator.folder.path(), "native", f64::from(Limb::RATE));
    let displacements: Receiver<DisplacementMap> = operator.listen("displacement_map", Qos::sensor_data());
    let limb = Limb::made(&operator.path("tty"), None, [1.0; 10]);
    let _node = operator.start_with(&skin, &root().join("models/hapdef-shin-x"), &["--strict"]);
    operator.contacts_say("that nothing touches", untouched);
    limb.becomes(PRESS);
    let there = |c: &Contact| apart(c, &pressed().0) < 0.015 && (pressing(c) - FORCE).abs() < 0.5 * FORCE;
    let found = operator.contacts_say("the press", |array| array.contacts.iter().any(there));
    assert!(found.contacts.len() <= 4, "{found:#?}");
    let surface = SkinDescription::load(&skin).unwrap().surface();
    operator.hears(&displacements, "that the shell gives way there", |map| {
        let deepest = (0..map.displacements.len())
            .max_by(|a, b| map.displacements[*a].total_cmp(&map.displacements[*b]))
            .unwrap();
        map.displacements.len() == surface.points.len()
            && (surface.points[deepest] - pressed().0).norm() < 0.02
    });
    limb.becomes(0);
    operator.contacts_say("the release", untouched);
}

#[test]
fn a_correction_of_another_skin_or_a_damaged_one_is_refused() {
    let operator = Operator::new();
    let skin = wired(operator.folder.path(), "native", f64::from(Limb::RATE));
    let model = bundle(operator.folder.path(), two());
    correct(&model, &[1.0; 10]);
    let path = model.join("correction.json");
    let text = std::fs::read_to_string(&path).unwrap();
    std::fs::write(&path, text.replacen("\"gains\":[1.0", "\"gains\":[NaN", 1)).unwrap();
    let _limb = Limb::made(&operator.path("tty"), None, [1.0; 10]);
    let _node = operator.start_with(&skin, &model, &[]);
    let array = operator.contacts_say("what is wrong", |a| a.status == ContactArray::STATUS_UNCALIBRATED);
    assert!(
        array.status_text.contains("correction.json")
            && array.status_text.contains("field `correction.hash`"),
        "{}",
        array.status_text
    );
}

#[test]
fn lines_that_no_converter_sends_are_refused_in_a_sentence() {
    let operator = Operator::new();
    let skin = wired(operator.folder.path(), "ascii", 100.0);
    let mut pty = Pty::open().unwrap();
    pty.link(operator.path("tty")).unwrap();
    let stop = Arc::new(AtomicBool::new(false));
    let ended = Arc::clone(&stop);
    // A converter of more bits than the skin's.
    let sender = std::thread::spawn(move || {
        while !ended.load(Ordering::Acquire) {
            let _ = pty.write_lossy(b"2048,2050,2047,33120,2048,2049,2051,2048,2047,2048\r\n");
            std::thread::sleep(Duration::from_millis(2));
        }
    });
    let _node = operator.start(&skin, &[]);
    let fault = operator.contacts_say("a fault", |a| a.status == ContactArray::STATUS_FAULT);
    stop.store(true, Ordering::Release);
    sender.join().unwrap();
    assert!(
        fault.status_text.contains("column 4 is `33120`, not a whole number from 0 to 4095"),
        "{}",
        fault.status_text
    );
    assert!(fault.contacts.is_empty());
}

#[test]
fn maps_are_heard_without_ros() {
    let Some(python) = client_python() else { return };
    let operator = Operator::new();
    let skin = wired(operator.folder.path(), "native", f64::from(Limb::RATE));
    let limb = Limb::plug(&operator.path("tty"));
    let _node = operator.start(&skin, &[]);
    let _bridge = Peer::start(Command::new(program("dermis")).args(["bridge", "--robot", "rig"]));
    operator.contacts_say("that nothing touches", |a| a.status <= ContactArray::STATUS_DEGRADED);
    limb.becomes(PRESS);
    let script = root().join("integration-tests/python/zenoh/maps.py");
    let mut client = Peer::start(Command::new(python).arg(script).arg("hapdef-shin"));
    let points = model().surface().points.len();
    assert_eq!(client.expect("displacement_map ", SOON), format!("displacement_map {points}"));
    assert_eq!(client.expect("force_map ", SOON), format!("force_map {points}"));
}
