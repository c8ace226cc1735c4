use dermis_model::{Indentation, Tip};
use nalgebra::{Point3, UnitQuaternion, Vector3};

use super::*;

/// Rests at 10 and drifts by 1 from press to press; each press adds 5.
fn drifting_recording() -> Recording {
    let mut recording = Recording::new("drifting", 1);
    for i in 0..400_u32 {
        let (press, within) = (u64::from(i / 200) + 1, i % 200);
        let touched = (150..180).contains(&within);
        let label = FrameLabel {
            time: f64::from(i) * 0.01,
            run: 0,
            press,
            location: 1,
            phase: if touched { Phase::Hold } else { Phase::Idle },
            stimulus: Some(Stimulus::default()),
            temperature: f64::NAN,
        };
        let value = 9.0 + press as f32 + if touched { 5.0 } else { 0.0 };
        recording.push(label, &[value]);
    }
    recording
}

fn drifting(zero: Zero) -> Vec<f32> {
    let mut recording = drifting_recording();
    recording.tare(zero);
    [10, 160, 190, 360].map(|i| recording.readings[i]).to_vec()
}

#[test]
fn signatures_of_one_tip_or_gravity_are_none_of_another() {
    let hash = |change: &dyn Fn(&mut Stimulus)| {
        let contact = Indentation::sphere(Point3::new(0.0, 0.0, 0.0), Vector3::new(0.0, 0.0, -1.0), 0.004);
        let mut stimulus = Stimulus { contacts: vec![contact], ..Stimulus::default() };
        change(&mut stimulus);
        let mut recording = Recording::new("one", 1);
        let label = FrameLabel {
            time: 0.0,
            run: 0,
            press: 1,
            location: 1,
            phase: Phase::Hold,
            stimulus: Some(stimulus),
            temperature: f64::NAN,
        };
        recording.push(label, &[1.0]);
        recording.stimulus_hash()
    };
    let turned = |by: f64| UnitQuaternion::from_euler_angles(0.0, 0.0, by);
    let punch = |turn: f64| Tip { shape: TipShape::FlatPunch { diameter: 0.004 }, orientation: turned(turn) };
    let all = [
        hash(&|_| ()),
        hash(&|s| s.gravity.z = -9.81),
        hash(&|s| s.contacts[0].tip = punch(0.0)),
        hash(&|s| s.contacts[0].tip = punch(0.3)),
        hash(&|s| {
            s.contacts[0].tip.shape = TipShape::Cylinder { diameter: 0.002, length: 0.004 };
        }),
        // As long as the one before.
        hash(&|s| {
            s.contacts[0].tip.shape = TipShape::Cylinder { diameter: 0.003, length: 0.004 };
        }),
    ];
    for (i, a) in all.iter().enumerate() {
        assert!(all[..i].iter().all(|b| a != b), "{i}");
    }
    assert_eq!(all[0], hash(&|s| s.contacts[0].tip.orientation = turned(0.3)), "a sphere was turned");
}

#[test]
fn a_place_keeps_its_identity_over_the_runs_of_a_recording() {
    let mut recording = Recording::new("three bags", 1);
    let mut press = |run: u32, location: u32, x: f64| {
        let at = Point3::new(x, 0.0, 0.0);
        let contact = Indentation::sphere(at, Vector3::new(0.0, 0.0, -1.0), 0.004);
        let label = FrameLabel {
            time: 0.0,
            run,
            press: u64::from(location),
            location,
            phase: Phase::Hold,
            stimulus: Some(Stimulus { contacts: vec![contact], ..Stimulus::default() }),
            temperature: f64::NAN,
        };
        recording.push(label, &[0.0]);
    };
    press(0, 1, 0.001);
    press(0, 2, 0.005);
    // Within a run the rig says which locations are one.
    press(0, 3, 0.005);
    press(1, 1, 0.005);
    press(1, 2, 0.0051);
    press(2, 1, 0.0010001);
    assert_eq!(recording.locations(), [(0, 1), (0, 2), (0, 3), (0, 2), (1, 2), (0, 1)]);
}

#[test]
fn a_rate_is_that_of_the_frames_whatever_is_lost_of_them() {
    let mut recording = drifting_recording();
    for frame in [300, 120, 40, 39] {
        recording.labels.remove(frame);
    }
    approx::assert_relative_eq!(recording.rate().unwrap(), 100.0, max_relative = 1e-9);
    recording.labels.truncate(1);
    assert_eq!(recording.rate(), None);
}

#[test]
fn frames_know_what_their_zero_was_measured_from() {
    let mut recording = drifting_recording();
    assert_eq!(recording.zeros.of(10), None);
    recording.tare(Zero::Start);
    let zero = recording.zeros.of(399).unwrap();
    assert_eq!((zero.index, zero.frames, zero.presses), (0, 101, 0));
    approx::assert_abs_diff_eq!(zero.time, 0.5, epsilon = 1e-9);
    // Half a second before the second press is from the first one's end on.
    let mut recording = drifting_recording();
    recording.tare(Zero::Press);
    let of = |frame| recording.zeros.of(frame).map(|zero| (zero.index, zero.frames));
    assert_eq!([0, 399].map(|frame| recording.zeros.of(frame).unwrap().presses), [0, 1]);
    assert_eq!(
        [of(0), of(349), of(350), of(399)],
        [Some((0, 50)), Some((0, 50)), Some((1, 50)), Some((1, 50))]
    );
    assert_eq!(recording.zeros.of(0).unwrap().variance(), 1.0 / 50.0);
    assert_eq!(ZeroMean { frames: 0, ..recording.zeros.of(0).unwrap() }.variance(), 0.0);
}

#[test]
fn readings_count_from_the_zero_that_was_asked_for() {
    assert_eq!(drifting(Zero::AsRead), [10.0, 15.0, 10.0, 16.0]);
    assert_eq!(drifting(Zero::Start), [0.0, 5.0, 0.0, 6.0]);
    assert_eq!(drifting(Zero::Press), [0.0, 5.0, 0.0, 5.0]);
}
