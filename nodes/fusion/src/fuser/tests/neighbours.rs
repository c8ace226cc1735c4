//! A skin that fails beside two that do not: one on the same rigid part, one on the arm.

use super::*;

/// \[ms\] from and to which the skin fails.
const FAILS: std::ops::Range<i64> = 300..1000;
/// \[ms\] of a run: what is remembered of a fault is forgotten after its end.
const RUN: i64 = 1600;

/// A frame of skin `a` that was acquired 2 ms ago, with a contact.
fn good(fuser: &mut Fuser, ms: i64) -> bool {
    let now = BEGIN + ms * MS;
    fuser.take(0, &report("a", ms as u64, now - 2 * MS, &[contact(1, 0.0, 0.0, 3.0)]), None, now)
}

/// What the body feels every 10 ms, with the millisecond, while `faulty` sends for skin `a` what it will in each millisecond of [`FAILS`].
/// The contacts of the others are new and where they were at each of these times, whatever it sends.
fn beside(mut faulty: impl FnMut(&mut Fuser, i64)) -> Vec<(i64, BodyState)> {
    let mut fuser = stated(100.0);
    let on_b = Vector3::new(0.0, 0.0, 0.3) + (chest_from_b() * Point3::new(0.05, 0.0, 0.0)).coords;
    let healthy = [(1, "b", 2.0, on_b), (2, "c", 5.0, Vector3::new(0.35, 0.0, 0.5))];
    let (mut states, mut ids) = (Vec::new(), None);
    // All are known before: a group of skins begins with the first report of any.
    for (skin, name) in ["a", "b", "c"].into_iter().enumerate() {
        assert!(fuser.take(skin, &report(name, 0, BEGIN - MS, &[]), None, BEGIN));
    }
    for ms in 1..=RUN {
        let now = BEGIN + ms * MS;
        if FAILS.contains(&ms) {
            faulty(&mut fuser, ms);
        } else if ms % 10 == 0 {
            // Where it flooded, the first may still be one too many.
            assert!(good(&mut fuser, ms) || ms == FAILS.end, "at {ms} ms");
        }
        if ms % 10 != 0 {
            continue;
        }
        fuser.take_joints(now, &["shoulder".to_owned()], &[0.0]).unwrap();
        for (skin, name, force, _) in healthy {
            let message = report(name, ms as u64, now - 3 * MS, &[contact(1, 0.05, 0.0, force)]);
            assert!(fuser.take(skin, &message, None, now), "{name} at {ms} ms");
        }
        let state = fuser.state(now);
        if ms >= 50 {
            let of = |skin: usize| state.contacts.iter().find(|c| c.skins == [(skin, 1)]).unwrap();
            for (skin, name, force, place) in healthy {
                let (touch, health) = (of(skin), &state.skins[skin].health);
                assert_eq!(
                    (health.status, touch.seen),
                    (ContactArray::STATUS_OK, now - 3 * MS),
                    "{name} at {ms} ms"
                );
                let found = touch.body_from_contact.translation.vector;
                assert!((found - place).norm() < 1e-6, "{name} at {ms} ms: {found}");
                assert!((touch.contact.force.z + force).abs() < 1e-6, "{name} at {ms} ms: {touch:?}");
            }
            let now_ids = [of(1).contact.track_id, of(2).contact.track_id];
            assert_eq!(*ids.get_or_insert(now_ids), now_ids, "at {ms} ms");
        }
        states.push((ms, state));
    }
    states
}

/// Status of skin `a` at a time, its sentence, and the number of contacts on the body.
fn at(states: &[(i64, BodyState)], ms: i64) -> (u8, &str, usize) {
    let (_, state) = states.iter().find(|(at, _)| *at == ms).unwrap();
    let health = &state.skins[0].health;
    (health.status, health.text.as_str(), state.contacts.len())
}

/// The skin feels just before the fault and long after it.
fn feels_before_and_after(states: &[(i64, BodyState)]) {
    for ms in [290, RUN] {
        assert_eq!(at(states, ms), (ContactArray::STATUS_OK, "", 3), "at {ms} ms");
    }
}

#[test]
fn a_skin_that_stops_leaves_the_others_alone() {
    let states = beside(|_, _| ());
    feels_before_and_after(&states);
    // Its last frame came at 290 ms, and its timeout is 0.2 s.
    assert_eq!(at(&states, 480).0, ContactArray::STATUS_OK);
    for ms in [500, 990] {
        let (status, text, contacts) = at(&states, ms);
        assert_eq!((status, contacts), (ContactArray::STATUS_STALE, 2), "at {ms} ms");
        assert!(text.starts_with("skin `a`: nothing has come for "), "{text}");
    }
}

/// A node that has stopped reading sends its last frame again, with the stamp that this had, or with new ones.
#[test]
fn a_skin_that_freezes_leaves_the_others_alone() {
    for renews in [false, true] {
        let states = beside(|fuser, ms| {
            if ms % 10 != 0 {
                return;
            }
            let now = BEGIN + ms * MS;
            let stamp = if renews { now - 2 * MS } else { BEGIN + 288 * MS };
            let message = report("a", 290, stamp, &[contact(1, 0.0, 0.0, 3.0)]);
            assert!(!fuser.take(0, &message, None, now), "at {ms} ms");
        });
        feels_before_and_after(&states);
        let text = "skin `a`: sends frame 290 again and again; restart its node, or check what it reads";
        for ms in [500, 990] {
            assert_eq!(at(&states, ms), (ContactArray::STATUS_STALE, text, 2), "new stamps: {renews}");
        }
    }
}

/// Ten times the rate that its file states, and half of what skins may send of which none is known.
#[test]
fn a_skin_that_floods_leaves_the_others_alone() {
    let mut used = 0;
    let states = beside(|fuser, ms| used += u32::from(good(fuser, ms)));
    feels_before_and_after(&states);
    // 200 a second for 0.7 s, and the 64 that may wait, of 700.
    assert!((199..=209).contains(&used), "{used}");
    let text = "skin `a`: sends more than 200 reports a second, twice the rate that is stated for it; those beyond are dropped: lower \
                its rate, or correct `rate` in its skin file or in the robot file";
    for ms in [400, 990] {
        assert_eq!(at(&states, ms), (ContactArray::STATUS_DEGRADED, text, 3));
    }
}
