use std::sync::Mutex;

use dermis_estimate::testing::{STRETCHED, TestBundle, membrane, nine, write_force_map, write_map};
use dermis_fixtures::SkinFile;
use dermis_inversion::{Search, Settings};
use dermis_learn::Run;
use dermis_model::Indentation;
use dermis_skin::{EstimateError, Estimator, Frame};

use super::*;
use crate::Unwatched;

fn skin() -> SkinDescription {
    SkinFile::new("pad")
        .set("noise", "2.0")
        .taxels([("left", [-0.005, 0.0, -0.005]), ("right", [0.005, 0.0, -0.005])])
        .tables("[condition]\ntare_duration = 0.03\n")
        .read()
}

/// One contact at x \[m\], or none.
fn truth(at: Option<(f64, Vector3<f64>)>) -> Truth {
    let contact = |(x, force)| TruthContact {
        position: Point3::new(x, 0.0, 0.0),
        normal: Vector3::z(),
        force,
        components: ForceComponents::Full,
        diameter: 0.004,
        flat: false,
    };
    Truth { press: 0, location: 0, idle: at.is_none(), contacts: at.map(contact).into_iter().collect() }
}

/// Twice ten untouched frames, from the first of which the zero is taken, and three touched ones.
fn data() -> Dataset {
    let skin = skin();
    let (mut frames, mut labels) = (Vec::new(), Vec::new());
    for k in 0..26_i64 {
        let touched = k % 13 >= 10;
        let values = if touched { vec![1100.0, 1000.0] } else { vec![1000.0; 2] };
        frames.push(Frame::new((k + 1) * 10_000_000, k as u64, values));
        labels.push(Some(truth(touched.then_some((0.001, Vector3::new(0.0, 0.0, -1.0))))));
    }
    let run = Run::of_frames(("made.bag".into(), "made".into(), String::new()), frames, labels, &skin, true);
    Dataset::from_runs(&skin, vec![run])
}

/// Notes its calls, has no answer to the first touched frame after a reset, and is 2 mm off in the others.
struct Noting {
    calls: Arc<Mutex<Vec<String>>>,
    early: bool,
}

impl ContactFinder for Noting {
    fn find(&mut self, frame: &ConditionedFrame<'_>) -> Result<Vec<Contact>, FindError> {
        self.calls.lock().unwrap().push(format!("find {:?}", frame.signal));
        if std::mem::take(&mut self.early) {
            return Err(FindError::History("made up".into()));
        }
        let mut contact = Contact::at(Point3::new(0.003, 0.0, 0.0), Vector3::z());
        contact.force = Vector3::new(0.0, 0.0, -1.0);
        contact.force_components = ForceComponents::Normal;
        Ok(vec![contact])
    }

    fn pass(&mut self, _: &ConditionedFrame<'_>) -> Result<(), FindError> {
        self.calls.lock().unwrap().push("pass".into());
        Ok(())
    }

    fn reset(&mut self) {
        self.early = true;
        self.calls.lock().unwrap().push("reset".into());
    }
}

#[test]
fn finders_see_every_frame_and_answer_the_sampled_ones() {
    let data = data();
    let calls = Arc::new(Mutex::new(Vec::new()));
    let noting = Noting { calls: Arc::clone(&calls), early: false };
    let targets: Vec<SampleId> = [10, 12, 24].map(|sample| SampleId { run: 0, sample }).to_vec();
    let finders: Vec<Named> = vec![("noting".into(), Box::new(noting))];
    let rows = answer(finders, &data, &targets, &[0.0], None, &Unwatched).unwrap();
    let mut expected = vec!["reset", "reset"];
    expected.extend(["pass"; 10]);
    expected.extend(["find [100.0, 0.0]", "pass", "find [100.0, 0.0]", "reset"]);
    expected.extend(["pass"; 11]);
    expected.push("find [100.0, 0.0]");
    // What lies behind the last target frame is not read.
    assert_eq!(*calls.lock().unwrap(), expected);
    let [(name, evaluation)] = rows.as_slice() else { panic!("{} rows", rows.len()) };
    assert_eq!((name.as_str(), evaluation.frames), ("noting", 3));
    // A history that is not filled is no contact: one after either zero.
    let missed = evaluation.missed.unwrap();
    assert!((missed - 2.0 / 3.0).abs() < 1e-12, "{missed}");
    assert!((evaluation.quantities["position found"].rms - 0.002).abs() < 1e-12);
    // The other two are 1 mm from the middle of the surface.
    assert!((evaluation.quantities["position"].rms - 2.0_f64.sqrt() * 1e-3).abs() < 1e-9);
}

/// Sixty untouched frames of the pad of nine and ten of a press that grows.
fn pressed(skin: &SkinDescription) -> Dataset {
    let forward = membrane(skin);
    let (mut frames, mut labels) = (Vec::new(), Vec::new());
    for k in 0..70_i32 {
        let (touched, force) = (k >= 60, Vector3::new(0.0, 0.0, -0.2 * f64::from(k - 58)));
        let press = Indentation::sphere(Point3::new(0.003, 0.0, 0.0), force, 0.004);
        let signal = if touched { forward.read(&[press]) } else { vec![0.0; 9] };
        let values = signal.iter().map(|v| 101_325.0 + *v as f32).collect();
        frames.push(Frame::new(i64::from(k + 1) * 10_000_000, k as u64, values));
        labels.push(Some(truth(touched.then_some((0.003, force)))));
    }
    let run = Run::of_frames(("made.bag".into(), "made".into(), String::new()), frames, labels, skin, true);
    Dataset::from_runs(skin, vec![run])
}

/// Notes the contacts of every frame.
struct Kept<T>(T, Arc<Mutex<Vec<Vec<Contact>>>>);

impl<T> Kept<T> {
    fn keep(&self, contacts: &[Contact]) {
        self.1.lock().unwrap().push(contacts.to_vec());
    }
}

impl ContactFinder for Kept<Box<dyn ContactFinder>> {
    fn find(&mut self, frame: &ConditionedFrame<'_>) -> Result<Vec<Contact>, FindError> {
        self.0.find(frame)
    }

    fn estimate(&mut self, frame: &ConditionedFrame<'_>) -> Result<Estimate, FindError> {
        self.0.estimate(frame).inspect(|estimate| self.keep(&estimate.contacts))
    }

    fn pass(&mut self, frame: &ConditionedFrame<'_>) -> Result<(), FindError> {
        self.0.pass(frame)
    }

    fn reset(&mut self) {
        self.0.reset();
    }
}

impl Estimator for Kept<Box<dyn Estimator>> {
    fn estimate(&mut self, frame: &Frame) -> Result<Estimate, EstimateError> {
        self.0.estimate(frame).inspect(|estimate| self.keep(&estimate.contacts))
    }

    fn tare(&mut self) {
        self.0.tare();
    }

    fn reset(&mut self) {
        self.0.reset();
    }
}

#[test]
fn a_bundle_is_compared_by_the_contacts_and_maps_that_it_is_evaluated_by() {
    let skin = nine();
    let (data, runtime) = (pressed(&skin), Runtime::load(&RuntimeConfig::default()).unwrap());
    let forward: Arc<dyn ForwardModel> = Arc::new(membrane(&skin));
    let targets: Vec<SampleId> = (60..70).map(|sample| SampleId { run: 0, sample }).collect();
    let pairs = || {
        let mut settings = Settings::new(0.004, 5.0);
        (settings.contacts, settings.distance, settings.search) = (2, 0.006, Search::Pairs);
        Some(settings)
    };
    type Write = fn(&SkinDescription, &std::path::Path, Option<Settings>);
    let network: Write =
        |skin, folder, inversion| TestBundle { inversion, ..TestBundle::default() }.write(skin, folder);
    let cases: [(Write, Option<Settings>, &str, Option<&str>); 5] = [
        (network, None, "network", None),
        (write_map, None, "peaks", Some("map.normal")),
        (write_force_map, None, "peaks", Some("map.normal")),
        (network, pairs(), "with forward model", Some("map.normal")),
        (write_force_map, pairs(), "with forward model", Some("map.normal")),
    ];
    for (write, inversion, name, map) in cases {
        let dir = tempfile::tempdir().unwrap();
        write(&skin, dir.path(), inversion.clone());
        let bundle = Bundle::load(dir.path(), &skin).unwrap();
        let mut methods = of_bundle("made", &bundle, &skin, &forward, runtime).unwrap();
        assert_eq!(methods.len(), if inversion.is_some() { 2 } else { 1 });
        let (called, finder) = methods.pop().unwrap();
        assert_eq!(called, format!("made: {name}"));
        let [compared, evaluated] = [(); 2].map(|()| Arc::new(Mutex::new(Vec::new())));
        let finders: Vec<Named> = vec![(called, Box::new(Kept(finder, Arc::clone(&compared))))];
        let rows = answer(finders, &data, &targets, &[0.0], Some(&forward), &Unwatched).unwrap();

        let estimator =
            dermis_estimate::estimator(STRETCHED, &skin, &[dir.path().to_owned()], &[], runtime).unwrap();
        let mut estimator = Kept(estimator, Arc::clone(&evaluated));
        let maps = Maps::new(&skin, Some(Arc::clone(&forward)), &[]).unwrap();
        let mut evaluator = Evaluator::of(&data).by_force(&[0.0]).with_maps(maps);
        evaluator.run(&mut estimator, &data, Some(&targets)).unwrap();

        let (compared, evaluated) = (compared.lock().unwrap(), evaluated.lock().unwrap());
        assert_eq!(compared.len(), targets.len());
        for (found, contacts) in compared.iter().zip(&evaluated[60..]) {
            assert_eq!((found.len(), contacts.len()), (1, 1), "{name}: {found:?}, {contacts:?}");
            let of = |c: &Contact| (c.position, c.force, c.position_covariance, c.force_covariance);
            assert_eq!(of(&found[0]), of(&contacts[0]), "{name}");
        }
        let maps = |e: &Evaluation| serde_json::to_value(&e.maps).unwrap();
        let evaluation = evaluator.finish("made");
        assert_eq!(maps(&rows[0].1), maps(&evaluation), "{name}");
        assert_eq!(map.is_some(), evaluation.maps.contains_key("map.normal"), "{name}");
        assert_eq!(rows[0].1.quantities, evaluation.quantities, "{name}");
    }
}

fn sample(values: [f32; 2], x: f64, force: Vector3<f64>) -> (SampleId, Sample) {
    let frame = Frame::new(10_000_000, 0, values.to_vec());
    let sample = Sample {
        frame,
        tared: values.to_vec(),
        tare: false,
        image: Vec::new(),
        image_tared: Vec::new(),
        truth: Some(truth(Some((x, force)))),
    };
    (SampleId { run: 0, sample: 0 }, sample)
}

#[test]
fn neighbours_answer_with_the_contacts_whose_readings_are_nearest() {
    let learned = [
        sample([100.0, 0.0], -0.005, Vector3::new(0.1, 0.0, -1.0)),
        sample([0.0, 100.0], 0.005, Vector3::new(0.3, 0.2, -2.0)),
    ];
    let ask = |count, components, values: [f32; 2]| {
        let mut finder = neighbours(count, &skin(), &learned, components).unwrap().unwrap();
        let (_, sample) = sample(values, 0.0, Vector3::zeros());
        finder.find(&sample.conditioned()).unwrap().remove(0)
    };
    let near = ask(1, ForceComponents::Normal, [10.0, 90.0]);
    assert!((near.position - Point3::new(0.005, 0.0, 0.0)).norm() < 1e-12);
    assert_eq!(near.force_components, ForceComponents::Normal);
    assert!((near.force - Vector3::new(0.0, 0.0, -2.0)).norm() < 1e-12, "{}", near.force);
    // As far from the one as from the other: their mean.
    let between = ask(2, ForceComponents::Full, [50.0, 50.0]);
    assert!((between.position - Point3::origin()).norm() < 1e-12, "{}", between.position);
    assert_eq!(between.force_components, ForceComponents::Full);
    assert!((between.force - Vector3::new(0.2, 0.1, -1.5)).norm() < 1e-12, "{}", between.force);
    // A channel without a reading counts as untouched.
    let blind = ask(1, ForceComponents::Normal, [90.0, f32::NAN]);
    assert!((blind.position - Point3::new(-0.005, 0.0, 0.0)).norm() < 1e-12);

    let mut unknown = learned.clone();
    for (_, sample) in &mut unknown {
        sample.truth.as_mut().unwrap().contacts[0].components = ForceComponents::None;
    }
    assert!(neighbours(1, &skin(), &unknown, ForceComponents::Normal).unwrap().is_none());
    assert!(neighbours(0, &skin(), &learned, ForceComponents::Normal).is_err());
}
