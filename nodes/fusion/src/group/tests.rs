use super::*;
use crate::testing::{BEGIN, MS, contact};
use nalgebra::Isometry3;

fn frame(skin: usize, ms: i64, locations: &[(u32, f64)]) -> Report {
    let s = Settings::default();
    let detections = locations
        .iter()
        .map(|(track, x)| Detection::of(&contact(*track, *x, 0.0, 2.0), skin, &Isometry3::identity(), &s));
    Report { skin, stamp: BEGIN + ms * MS, detections: detections.collect() }
}

fn shown(group: &mut Group, identities: &mut Identities, ms: i64) -> Vec<(u32, usize)> {
    let tracks = group.tracks(BEGIN + ms * MS, identities, &Settings::default());
    tracks.iter().map(|t| (t.id, t.sources.len())).collect()
}

#[test]
fn only_those_that_compete_are_solved_together() {
    let pairs = [(0, 0, 1.0), (1, 0, 1.0), (1, 2, 1.0), (3, 1, 1.0)];
    let sets = competitors(&pairs, 4, 4);
    assert_eq!(sets, [(vec![0, 1], vec![0, 2]), (vec![3], vec![1])]);
    assert!(competitors(&[], 2, 2).is_empty());
}

#[test]
fn a_skin_that_exchanges_its_names_exchanges_no_contacts() {
    let s = Settings::default();
    let (mut group, mut identities) = (Group::default(), Identities::default());
    for k in 0..10 {
        group.take(frame(0, 10 * k, &[(1, 0.0), (2, 0.05)]), &s);
    }
    assert_eq!(shown(&mut group, &mut identities, 90), [(1, 1), (2, 1)]);
    for k in 10..20 {
        group.take(frame(0, 10 * k, &[(2, 0.0), (1, 0.05)]), &s);
    }
    let tracks = group.tracks(BEGIN + 190 * MS, &mut identities, &s);
    for (track, (id, x)) in tracks.iter().zip([(1, 0.0), (2, 0.05)]) {
        let place = track.place.as_ref().unwrap().mean[0];
        assert!(track.id == id && (place - x).abs() < 1e-3, "{id}: {place}");
    }
}

#[test]
fn two_tracks_of_one_touch_become_one_and_those_of_one_skin_never() {
    let s = Settings::default();
    let (mut group, mut identities) = (Group::default(), Identities::default());
    // The second skin feels it 40 mm away at first, as where it is about to touch elsewhere.
    for k in 0..10 {
        group.take(frame(0, 10 * k, &[(1, 0.0)]), &s);
        group.take(frame(1, 10 * k + 3, &[(7, 0.04)]), &s);
    }
    assert_eq!(shown(&mut group, &mut identities, 95), [(1, 1), (2, 1)]);
    for k in 10..60 {
        let x = (0.04 - 0.001 * (k - 10) as f64).max(0.001);
        group.take(frame(0, 10 * k, &[(1, 0.0)]), &s);
        group.take(frame(1, 10 * k + 3, &[(7, x)]), &s);
    }
    assert_eq!(shown(&mut group, &mut identities, 595), [(1, 2)], "the older identity stays");
    // The same two locations from one skin.
    let (mut group, mut identities) = (Group::default(), Identities::default());
    for k in 0..50 {
        group.take(frame(0, 10 * k, &[(1, 0.0), (2, 0.001)]), &s);
    }
    assert_eq!(shown(&mut group, &mut identities, 495).len(), 2);
}

#[test]
fn a_contact_that_jumps_is_followed_from_the_second_frame_on() {
    let s = Settings::default();
    let (mut group, mut identities) = (Group::default(), Identities::default());
    let place = |group: &mut Group, identities: &mut Identities, ms: i64| {
        let tracks = group.tracks(BEGIN + ms * MS, identities, &Settings::default());
        let [track] = tracks.as_slice() else { panic!("{} tracks", tracks.len()) };
        (track.id, track.place.as_ref().unwrap().mean[0])
    };
    for k in 0..10 {
        group.take(frame(0, 10 * k, &[(1, 0.0)]), &s);
    }
    group.take(frame(0, 100, &[(1, 0.1)]), &s);
    let (id, x) = place(&mut group, &mut identities, 100);
    assert!(id == 1 && x.abs() < 1e-3, "an outlier is dropped: {x}");
    group.take(frame(0, 110, &[(1, 0.1)]), &s);
    let (id, x) = place(&mut group, &mut identities, 110);
    assert!(id == 1 && (x - 0.1).abs() < 1e-3, "{x}");
}

#[test]
fn a_skin_that_is_lost_takes_its_contacts_along() {
    let s = Settings::default();
    let (mut group, mut identities) = (Group::default(), Identities::default());
    for k in 0..10 {
        group.take(frame(0, 10 * k, &[(1, 0.0), (2, 0.1)]), &s);
        group.take(frame(1, 10 * k + 3, &[(7, 0.0)]), &s);
    }
    assert_eq!(shown(&mut group, &mut identities, 95), [(1, 2), (2, 1)]);
    group.lose(0);
    assert_eq!(shown(&mut group, &mut identities, 95), [(1, 1)]);
}
