//! Every short sequence of events, and random long ones, against a plain description of what must happen.

use proptest::prelude::*;

use super::*;

/// What can happen in a step of 5 ms.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Step {
    Free,
    Light,
    Between,
    Heavy,
    Blind,
    Silence,
    Release,
}

const STEPS: [Step; 7] =
    [Step::Free, Step::Light, Step::Between, Step::Heavy, Step::Blind, Step::Silence, Step::Release];

/// What the machine must do, written down once more in the plainest way: by looking at the whole past. Thresholds 5 and 4 N,
/// `hold` 0, `quiet` 10 ms, timeout 20 ms; a step takes 5 ms. Returns whether it acts after the last step.
fn oracle(steps: &[Step]) -> bool {
    let mut acts = false;
    let mut quiet_ms = 0;
    // Since the last message, and what it said.
    let (mut silent_ms, mut last) = (0, Step::Free);
    for step in steps {
        match step {
            Step::Silence => {}
            Step::Release => acts &= quiet_ms < 10,
            said => (silent_ms, last) = (0, *said),
        }
        // The instant of the step, and the 5 ms after it.
        for passed in 0..=5 {
            let late = silent_ms + passed >= 20;
            let triggers = late || matches!(last, Step::Heavy | Step::Blind);
            let holds = triggers || last == Step::Between;
            acts |= triggers;
            if holds {
                quiet_ms = 0;
            } else if passed > 0 {
                quiet_ms += 1;
            }
        }
        silent_ms += 5;
    }
    acts
}

fn run(steps: &[Step]) -> (Rig, bool) {
    let mut rig = Rig::new("clear", &format!("{FORCE}\nquiet = 0.01"));
    rig.palm(&[]);
    rig.wait(15 * MS);
    rig.palm(&[]);
    let mut consistent = !rig.acts();
    for step in steps {
        let before = rig.acts();
        match step {
            Step::Free => rig.palm(&[]),
            Step::Light => rig.palm(&[3.0]),
            Step::Between => rig.palm(&[4.5]),
            Step::Heavy => rig.palm(&[3.0, 6.0]),
            Step::Blind => rig.blind(),
            Step::Silence => {}
            Step::Release => {
                let _ = rig.release();
            }
        }
        // Only a release ends a latched stop.
        consistent &= rig.acts() || !before || *step == Step::Release;
        let before = rig.acts();
        rig.wait(5 * MS);
        consistent &= rig.acts() || !before;
    }
    (rig, consistent)
}

#[test]
fn every_sequence_of_five_steps_does_what_the_plain_description_says() {
    let mut steps = [Step::Free; 5];
    for number in 0..STEPS.len().pow(5) {
        let mut rest = number;
        for step in &mut steps {
            *step = STEPS[rest % STEPS.len()];
            rest /= STEPS.len();
        }
        let (rig, consistent) = run(&steps);
        assert!(consistent, "{steps:?}");
        assert_eq!(rig.acts(), oracle(&steps), "{steps:?}");
    }
}

fn any_step() -> impl Strategy<Value = Step> {
    (0..STEPS.len()).prop_map(|i| STEPS[i])
}

proptest! {
    /// Whatever happens, a latched stop ends by a release only, and is repeated every 10 ms while it lasts.
    #[test]
    fn a_latched_stop_never_ends_by_itself(steps in prop::collection::vec(any_step(), 1..60)) {
        let (rig, consistent) = run(&steps);
        prop_assert!(consistent);
        prop_assert_eq!(rig.acts(), oracle(&steps));
        let mut last_stop: Option<Duration> = None;
        for (at, order) in &rig.sent {
            match order {
                Order::Bool(true) => {
                    prop_assert!(last_stop.is_none_or(|last| *at - last <= 10 * MS));
                    last_stop = Some(*at);
                }
                Order::Bool(false) => last_stop = None,
                _ => {}
            }
        }
        if rig.acts() {
            prop_assert!(last_stop.is_some_and(|last| rig.now - last < 10 * MS));
        }
    }

    /// After any gap of an input that is as long as its timeout, the stop is out at that very time, not later.
    #[test]
    fn a_gap_acts_within_the_stated_time(
        gaps in prop::collection::vec(1_u32..30_000, 1..50),
        force in 0.0..4.0,
    ) {
        let mut rig = Rig::new("clear", FORCE);
        rig.palm(&[]);
        rig.quietly(250 * MS);
        rig.palm(&[force]);
        let mut expected = None;
        for gap in gaps {
            let gap = Duration::from_micros(gap.into());
            if gap >= 20 * MS {
                expected.get_or_insert(rig.now + 20 * MS);
            }
            rig.wait(gap);
            rig.palm(&[force]);
        }
        let stops = rig.sent.iter().filter(|(at, order)| *order == Order::Bool(true) && *at > 250 * MS);
        prop_assert_eq!(stops.map(|(at, _)| *at).next(), expected);
    }

    /// A heavier force never acts later, and acts in the call that brings it.
    #[test]
    fn a_force_above_the_threshold_acts_at_once(force in 0.0..100.0, other in 0.0..5.0) {
        let mut rig = Rig::new("clear", FORCE);
        rig.quietly(300 * MS);
        let before = rig.stops();
        rig.palm(&[other, force, other]);
        prop_assert_eq!(rig.stops() > before, force > 5.0);
    }

    /// A release succeeds only where nothing holds, and then nothing acts.
    #[test]
    fn a_release_is_all_or_nothing(steps in prop::collection::vec(any_step(), 1..40)) {
        let (mut rig, _) = run(&steps);
        let acted = rig.acts();
        match rig.release() {
            Ok(()) => prop_assert!(!rig.acts()),
            Err(_) => prop_assert!(acted && rig.acts()),
        }
    }

    /// Any numbers in a message, not finite ones included, neither panic nor end a stop.
    #[test]
    fn any_message_is_taken(
        numbers in prop::collection::vec(any::<f64>(), 9),
        diameter in any::<f32>(),
        status in any::<u8>(),
        components in any::<u8>(),
        stamp in any::<i32>(),
        age in any::<i64>(),
    ) {
        let mut rig = Rig::new("stopped", "force = { above = 5.0 }\npressure = { above = 1.0 }\nspeed = { above = 1.0 }\nsigmas = 1.0\nlimits = 'person'");
        let mut message = rig.message("palm", status, &[1.0]);
        message.header.stamp.sec = stamp;
        let contact = &mut message.contacts[0];
        contact.force = Vector3 { x: numbers[0], y: numbers[1], z: numbers[2] };
        contact.normal = Vector3 { x: numbers[3], y: numbers[4], z: numbers[5] };
        (contact.position.x, contact.position.y) = (numbers[6], numbers[7]);
        contact.force_covariance[0] = numbers[8];
        (contact.diameter, contact.force_components) = (diameter, components);
        let done = rig.reflex.skin(PALM, &message, rig.now, age);
        rig.note(&done);
        rig.wait(5 * MS);
        prop_assert!(rig.acts());
    }
}
