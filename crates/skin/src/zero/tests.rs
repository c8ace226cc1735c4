use super::*;
use crate::ChannelFlags;
use crate::testing::PAD;

fn skin() -> SkinDescription {
    SkinDescription::from_toml(&PAD.replace("noise = 20.0", "noise = 2.0"), "pad.toml").unwrap()
}

fn at(k: u64, values: [f32; 2]) -> Frame {
    Frame::new(k as i64 * 10_000_000, k, values.to_vec())
}

/// ±1 around `base`: a spread of half the noise.
fn wiggle(k: u64, base: f32) -> f32 {
    base + if k.is_multiple_of(2) { 1.0 } else { -1.0 }
}

fn tared() -> (ZeroTracker, u64) {
    let mut zero = ZeroTracker::new(&skin());
    let mut k = 0;
    while zero.zero().is_none() {
        assert!(k < 1000, "no tare after {k} frames");
        zero.push(&at(k, [wiggle(k, 100.0), wiggle(k, -50.0)]), false);
        k += 1;
    }
    (zero, k)
}

#[test]
fn tare_is_the_mean_of_quiet_frames() {
    let (zero, frames) = tared();
    assert!((50..=52).contains(&frames), "{frames} frames at 100 Hz are not 0.5 s");
    let z = zero.zero().unwrap();
    assert!((z[0] - 100.0).abs() < 0.1 && (z[1] + 50.0).abs() < 0.1, "{z:?}");
    assert_eq!(zero.state(), TareState::Done);
}

#[test]
fn moving_readings_are_no_zero() {
    let mut zero = ZeroTracker::new(&skin());
    for k in 0..200 {
        zero.push(&at(k, [k as f32 * 5.0, 0.0]), false);
    }
    assert!(zero.zero().is_none());
    assert!(
        matches!(zero.state(), TareState::Averaging { disturbed: Some(s), .. } if s > QUIET_SPREAD),
        "{:?}",
        zero.state()
    );
}

#[test]
fn labels_are_believed_even_where_readings_move() {
    let mut zero = ZeroTracker::labelled(&skin());
    for k in 0..60 {
        zero.push(&at(k, [k as f32 * 5.0, 0.0]), false);
    }
    assert!(zero.zero().is_some());
}

#[test]
fn the_zero_follows_drift_only_while_untouched() {
    let (mut zero, start) = tared();
    for k in start..start + 6000 {
        zero.push(&at(k, [500.0, 500.0]), true);
    }
    let held = zero.zero().unwrap()[0];
    assert!((held - 100.0).abs() < 0.1, "one minute of contact moved the zero to {held}");
    let end = start + 6000;
    for k in end..end + 9000 {
        zero.push(&at(k, [wiggle(k, 103.0), wiggle(k, -50.0)]), false);
    }
    // Three time constants less the second of settling: 1 − e^(−89/30).
    let followed = zero.zero().unwrap()[0];
    assert!((followed - (103.0 - 3.0 * (-89.0_f64 / 30.0).exp())).abs() < 0.05, "{followed}");
}

#[test]
fn relaxation_after_release_is_not_followed() {
    let (mut zero, start) = tared();
    zero.push(&at(start, [500.0, 500.0]), true);
    for k in start + 1..start + 99 {
        zero.push(&at(k, [107.0, -50.0]), false);
    }
    assert!((zero.zero().unwrap()[0] - 100.0).abs() < 0.1);
}

#[test]
fn a_gap_does_not_move_the_zero_at_once() {
    let (mut zero, start) = tared();
    zero.push(&at(start + 1_000_000, [107.0, -50.0]), false);
    let z = zero.zero().unwrap()[0];
    assert!((z - 100.0).abs() < 0.4, "{z}");
}

#[test]
fn invalid_channels_become_nan_and_saturated_ones_stay() {
    let (zero, k) = tared();
    let mut frame = at(k, [110.0, -20.0]);
    frame.flags = vec![ChannelFlags::SATURATED, ChannelFlags::STUCK];
    zero.subtract(&mut frame);
    assert!((frame.values[0] - 10.0).abs() < 0.1);
    assert!(frame.values[1].is_nan());
    let mut early = at(0, [1.0, 2.0]);
    ZeroTracker::new(&skin()).subtract(&mut early);
    assert!(early.values.iter().all(|v| v.is_nan()), "a value without a zero must not look like a reading");
}

#[test]
fn a_channel_that_comes_back_gets_a_zero() {
    let mut zero = ZeroTracker::new(&skin());
    for k in 0..60 {
        zero.push(&at(k, [wiggle(k, 100.0), f32::NAN]), false);
    }
    assert!(zero.zero().unwrap()[1].is_nan());
    for k in 60..64 {
        zero.push(&at(k, [wiggle(k, 100.0), 7.0]), false);
    }
    assert!((zero.zero().unwrap()[1] - 7.0).abs() < 1e-9);
}

#[test]
fn a_touch_starts_the_average_over() {
    let (mut zero, k) = tared();
    zero.begin_tare();
    for i in 0..40 {
        zero.push(&at(k + i, [200.0, 200.0]), false);
    }
    zero.push(&at(k + 40, [900.0, 200.0]), true);
    for i in 41..60 {
        zero.push(&at(k + i, [200.0, 200.0]), false);
    }
    assert!(matches!(zero.state(), TareState::Averaging { elapsed, .. } if elapsed < 0.2));
    zero.cancel_tare();
    assert_eq!(zero.state(), TareState::Done);
    assert!((zero.zero().unwrap()[0] - 100.0).abs() < 0.1, "the old zero stays until the new one is done");
}

#[test]
fn an_image_gets_its_zero_from_the_frames_that_give_the_channels_theirs() {
    let mut zero = ZeroTracker::new(&skin());
    zero.set_image(2);
    let mut k = 0_u64;
    while zero.zero().is_none() {
        assert!(zero.image_zero().is_none() && k < 1000);
        // Every other frame lacks its image, and one number is never known.
        let image = if k.is_multiple_of(2) { vec![0.25, f32::NAN] } else { Vec::new() };
        zero.push_with(&at(k, [wiggle(k, 100.0), wiggle(k, -50.0)]), &image, false);
        k += 1;
    }
    assert_eq!(zero.zero().unwrap().len(), 2);
    let image = zero.image_zero().unwrap();
    assert!((image[0] - 0.25).abs() < 1e-9 && image[1].is_nan(), "{image:?}");
    // A touch moves neither; an untouched frame gives the missing one a first zero.
    zero.push_with(&at(k, [900.0, 900.0]), &[0.9, 0.9], true);
    assert!((zero.image_zero().unwrap()[0] - 0.25).abs() < 1e-9);
    zero.push_with(&at(k + 200, [100.0, -50.0]), &[0.25, 0.5], false);
    assert!((zero.image_zero().unwrap()[1] - 0.5).abs() < 1e-9);
    // A zero of the channels from elsewhere leaves that of the image.
    zero.set_zero(&[0.0, 0.0]);
    assert!((zero.image_zero().unwrap()[0] - 0.25).abs() < 1e-9);
    zero.reset();
    assert!(zero.image_zero().is_none());
}
