use super::super::refine::FittedCandidate;
use super::super::report::known_effect;
use super::super::testing::{Case, candidate, chosen, with_simulator};
use super::*;
use crate::testing::gains;

/// The gains of a device, written as `effects`.
fn predicted(effects: Option<Effect>, test: impl FnOnce(&Data<'_>, Explained)) {
    with_simulator(|simulator| {
        let case = Case::of(simulator, &[gains()]);
        let data = case.data(simulator);
        let selected = chosen(&data, &["channel-gain"], &case.measured.whitened);
        let of = candidate(&data, "channel-gain");
        let mut named = known_effect(&gains(), "", "");
        (named.tier, named.shapley) = (Tier::Strict, 1.0);
        let fits = effects.map(|effect| FittedCandidate::written(of, vec![effect]));
        let refined = Refined {
            named: vec![named],
            fits: vec![fits.into_iter().collect()],
            set: vec![of],
            warnings: Vec::new(),
        };
        let found = predict(&data, &selected, refined, &[], &case.measured.whitened).unwrap();
        test(&data, found);
    });
}

#[test]
fn the_right_effect_removes_the_gap_of_other_contacts() {
    predicted(Some(gains()), |data, found| {
        let reduction = found.reduction.unwrap();
        // The gap is some 25 times the noise: all of it goes, within the error of the floor, a few per cent of the noise.
        assert!((reduction.achieved.unwrap() - 1.0).abs() < 0.02, "{reduction:?}");
        assert!((reduction.predicted - 1.0).abs() < 0.02, "{reduction:?}");
        assert!(reduction.interval[0] < 1.0 && reduction.interval[1] <= 1.0);
        let [before, after, floor] = found.held_out.unwrap();
        assert!(after < 2.0 * floor && after < 0.1 * before, "{before} {after} {floor}");
        assert_eq!(floor, data.gap.floor);
        assert_eq!(found.effects, [gains()]);
        assert_eq!((found.named[0].tier, found.warnings.len()), (Tier::Strict, 0));
        assert!(found.library >= reduction.achieved.unwrap() * data.gap.systematic);
        assert!(found.members.is_empty(), "one member is no open class");
    });
}

#[test]
fn what_cannot_be_written_is_predicted_by_its_signature() {
    predicted(None, |_, found| {
        let reduction = found.reduction.unwrap();
        assert_eq!(reduction.achieved, None);
        assert!(reduction.predicted > 0.95, "{reduction:?}");
        assert!(found.effects.is_empty());
        assert!(found.warnings[0].starts_with("none of the named effects can be switched on"));
        let left = found.left.unwrap();
        let square = left.iter().map(|v| v * v).sum::<f32>() / left.len() as f32;
        assert!((square - 1.0).abs() < 0.2, "{square}");
    });
}

#[test]
fn values_that_do_not_hold_elsewhere_explain_nothing() {
    // The other way round: every channel gets worse.
    let wrong = Effect::new("channel-gain").with("a", 0.8).with("b", 1.15).with("c", 0.9);
    predicted(Some(wrong), |_, found| {
        let reduction = found.reduction.unwrap();
        assert!(reduction.achieved.unwrap() < -1.0, "{reduction:?}");
        assert_eq!(found.library, 0.0);
        assert_eq!(found.named[0].tier, Tier::Loose);
        assert!(found.warnings[0].starts_with("to first order the named effects explain"));
        let [before, after, _] = found.held_out.unwrap();
        assert!(after > before);
    });
}

#[test]
fn a_prediction_that_is_stopped_is_none() {
    with_simulator(|simulator| {
        let case = Case::of(simulator, &[gains()]);
        let data = case.data(simulator);
        let selected = chosen(&data, &["channel-gain"], &case.measured.whitened);
        let refined = Refined { set: selected.set(), fits: vec![Vec::new()], ..Refined::default() };
        data.options.stop.store(true, Ordering::Relaxed);
        let found = predict(&data, &selected, refined, &[], &case.measured.whitened);
        assert!(matches!(found, Err(GapError::Interrupted)));
    });
}
