use super::*;

const MS: i64 = 1_000_000;

fn config(taps: Taps) -> FeatureConfig {
    FeatureConfig { taps, ..FeatureConfig::newest(vec![1.0, 0.0], vec![2.0, 1.0]) }
}

#[test]
fn newest_frame_is_normalised_and_a_gap_in_it_is_the_mean() {
    let mut f = Features::new(FeatureConfig { missing: Missing::Mask, ..config(Taps::default()) }).unwrap();
    assert_eq!(f.input(), None);
    f.push(5, &[3.0, f32::INFINITY]).unwrap();
    assert_eq!(f.input().unwrap(), [1.0, 0.0, 1.0, 0.0]);
    f.push(6, &[f32::NAN, f32::NAN]).unwrap();
    assert_eq!(f.input(), None, "no channel to infer from");
}

#[test]
fn frames_taps_wait_for_their_history() {
    let mut f = Features::new(config(Taps::Frames(vec![0, 2]))).unwrap();
    for i in 0..5_i64 {
        f.push(i * MS, &[1.0 + 2.0 * i as f32, i as f32]).unwrap();
        let i = i as f32;
        if i < 2.0 {
            assert_eq!(f.input(), None);
        } else {
            assert_eq!(f.input().unwrap(), [i, i, i - 2.0, i - 2.0]);
        }
    }
    assert_eq!(f.history.len(), 3);
}

#[test]
fn seconds_taps_follow_acquisition_time_not_frame_count() {
    // Both channels rise linearly in time; frames come at irregular instants.
    let mut f = Features::new(config(Taps::Seconds(vec![0.0, 0.025]))).unwrap();
    for t in [0, 7, 11, 30, 38, 61, 66] {
        f.push(t * MS, &[1.0 + 2.0 * t as f32, t as f32]).unwrap();
        if let Some(input) = f.input() {
            let (t, past) = (t as f32, t as f32 - 25.0);
            for (got, want) in input.iter().zip([t, t, past, past]) {
                assert!((got - want).abs() < 1e-3, "at {t}: {input:?}");
            }
        } else {
            assert!(t < 25);
        }
    }
}

#[test]
fn interpolation_uses_the_valid_neighbour() {
    let mut f = Features::new(config(Taps::Seconds(vec![0.005]))).unwrap();
    f.push(0, &[1.0, 4.0]).unwrap();
    f.push(10 * MS, &[3.0, f32::NAN]).unwrap();
    assert_eq!(f.input().unwrap(), [0.5, 4.0]);
}

#[test]
fn low_pass_is_that_of_continuous_time_at_any_rate() {
    let low = FeatureConfig { low_pass: vec![0.1], ..config(Taps::default()) };
    let answer = |steps: &[i64]| {
        let mut f = Features::new(low.clone()).unwrap();
        f.push(0, &[1.0, 0.0]).unwrap();
        for t in steps {
            f.push(t * MS, &[3.0, f32::NAN]).unwrap();
        }
        f.input().unwrap()[2]
    };
    let want = 1.0 - (-1.0_f32).exp();
    assert!((answer(&[100]) - want).abs() < 1e-6);
    assert!((answer(&[1, 30, 31, 77, 100]) - want).abs() < 1e-6);
}

#[test]
fn difference_is_rate_times_span() {
    let mut f = Features::new(FeatureConfig { difference: vec![0.02], ..config(Taps::default()) }).unwrap();
    for t in (0..=50).step_by(10) {
        f.push(t * MS, &[1.0, 0.5 * t as f32]).unwrap();
    }
    let input = f.input().unwrap();
    assert_eq!(input[2], 0.0);
    assert!((input[3] - 10.0).abs() < 1e-4);
}

#[test]
fn gaps_and_clocks_that_go_back_restart_the_history() {
    let mut f = Features::new(config(Taps::Frames(vec![1]))).unwrap();
    f.push(0, &[1.0, 1.0]).unwrap();
    f.push(400 * MS, &[1.0, 2.0]).unwrap();
    assert_eq!(f.input().unwrap()[1], 1.0);
    f.push(1000 * MS, &[1.0, 3.0]).unwrap();
    assert_eq!(f.input(), None);
    f.push(1001 * MS, &[1.0, 4.0]).unwrap();
    assert_eq!(f.input().unwrap()[1], 3.0);
    f.push(1001 * MS, &[1.0, 5.0]).unwrap();
    assert_eq!(f.input().unwrap()[1], 3.0, "a repeated stamp replaces its frame");
    f.push(0, &[1.0, 6.0]).unwrap();
    assert_eq!(f.input(), None);
}

#[test]
fn a_frame_of_another_skin_is_refused() {
    let mut f = Features::new(config(Taps::default())).unwrap();
    assert_eq!(f.push(0, &[1.0]), Err(FeatureError::ChannelCount { got: 1, expected: 2 }));
}

proptest::proptest! {
    /// Whatever comes in, what goes out is finite and of the declared length.
    #[test]
    fn input_is_always_finite(
        frames in proptest::collection::vec(
            (proptest::num::i64::ANY, proptest::num::f32::ANY, proptest::num::f32::ANY), 0..40),
        small in proptest::bool::ANY,
    ) {
        let mut f = Features::new(FeatureConfig {
            low_pass: vec![0.01, 3.0], difference: vec![0.01], missing: Missing::Mask,
            ..config(Taps::Seconds(vec![0.0, 0.004]))
        }).unwrap();
        for (stamp, a, b) in frames {
            f.push(if small { stamp % (20 * MS) } else { stamp }, &[a, b]).unwrap();
            if let Some(input) = f.input() {
                proptest::prop_assert_eq!(input.len(), f.config().input_len());
                proptest::prop_assert!(input.iter().all(|v| v.is_finite()), "{:?}", input);
            }
        }
    }

    /// History and its spare memory stay bounded by what the delays need.
    #[test]
    fn history_is_bounded(step in 1..5_i64) {
        let mut f = Features::new(config(Taps::Seconds(vec![0.0, 0.02]))).unwrap();
        for i in 0..500 {
            f.push(i * step * MS, &[1.0, 1.0]).unwrap();
        }
        proptest::prop_assert!(f.history.len() as i64 <= 20 / step + 3);
        proptest::prop_assert!(f.spare.len() <= 1);
    }
}
