//! Faults of skins: each has one outcome and one sentence, and is over within a second.

use super::*;
use crate::fuser::Fuser;
use crate::testing::{BEGIN, MS, contact, fuser, report, stated};

const OK: u8 = ContactArray::STATUS_OK;
const STALE: u8 = ContactArray::STATUS_STALE;
const FAULT: u8 = ContactArray::STATUS_FAULT;

/// Skin `a` with a contact, at 100 Hz; stamps are 5 ms old when reports come.
struct Stream {
    fuser: Fuser,
    now: Stamp,
    sequence: u64,
}

impl Stream {
    /// Half a second of good reports.
    fn begin() -> Self {
        Self::of(fuser(Settings::default()))
    }

    fn of(fuser: Fuser) -> Self {
        let mut stream = Self { fuser, now: BEGIN, sequence: 0 };
        stream.good(50);
        assert_eq!(stream.ask(), (OK, String::new(), 1));
        stream
    }

    fn send(&mut self, change: impl FnOnce(&mut ContactArray)) -> bool {
        self.send_from([1; 16], change)
    }

    /// So many reports, so many a second and 1 ms old; how many are used.
    fn run(&mut self, reports: u32, rate: i64) -> u32 {
        let mut used = 0;
        for _ in 0..reports {
            self.now += 1000 * MS / rate;
            self.sequence += 1;
            let message = report("a", self.sequence, self.now - MS, &[contact(1, 0.0, 0.0, 3.0)]);
            used += u32::from(self.fuser.take(0, &message, Some([1; 16]), self.now));
        }
        used
    }

    /// One report 10 ms later.
    fn send_from(&mut self, publisher: [u8; 16], change: impl FnOnce(&mut ContactArray)) -> bool {
        self.now += 10 * MS;
        self.sequence += 1;
        let mut message = report("a", self.sequence, self.now - 5 * MS, &[contact(1, 0.0, 0.0, 3.0)]);
        change(&mut message);
        self.fuser.take(0, &message, Some(publisher), self.now)
    }

    fn good(&mut self, reports: usize) {
        for _ in 0..reports {
            self.send(|_| ());
        }
    }

    /// Status and sentence of the skin, and the number of its contacts.
    fn ask(&mut self) -> (u8, String, usize) {
        let state = self.fuser.state(self.now);
        let health = state.skins[0].health.clone();
        (health.status, health.text, state.contacts.len())
    }

    /// Good reports make all good within a second, and the contact is there again.
    fn recovers(&mut self) {
        self.good(100);
        assert_eq!(self.ask(), (OK, String::new(), 1));
    }
}

#[test]
fn a_skin_that_dies_is_stale_and_comes_back() {
    let mut stream = Stream::begin();
    stream.now += 150 * MS;
    assert_eq!(stream.ask().0, OK, "its timeout is 0.2 s");
    stream.now += 250 * MS;
    let (status, text, contacts) = stream.ask();
    assert_eq!((status, contacts), (STALE, 0));
    insta::assert_snapshot!(text, @"skin `a`: nothing has come for 0.4 s; check that its node runs, and the network between");
    // Two reports are a contact again.
    stream.good(2);
    assert_eq!(stream.ask(), (OK, String::new(), 1));
}

#[test]
fn a_skin_that_freezes_is_stale() {
    let mut stream = Stream::begin();
    let (sequence, stamp) = (stream.sequence, stream.now - 5 * MS);
    for _ in 0..40 {
        let used = stream.send(|m| {
            m.sequence = sequence;
            m.header.stamp = dermis_msgs::builtin_interfaces::msg::Time::from_nanos(stamp);
        });
        assert!(!used);
    }
    let (status, text, contacts) = stream.ask();
    assert_eq!((status, contacts), (STALE, 0));
    insta::assert_snapshot!(text, @"skin `a`: sends frame 50 again and again; restart its node, or check what it reads");
    stream.recovers();
    // A node that stamps its last frame anew is neither two nodes nor one that starts again and again.
    let sequence = stream.sequence;
    for _ in 0..40 {
        assert!(!stream.send(|m| m.sequence = sequence));
    }
    let text =
        format!("skin `a`: sends frame {sequence} again and again; restart its node, or check what it reads");
    assert_eq!(stream.ask(), (STALE, text, 0));
    assert_eq!(stream.fuser.state(stream.now).skins[0].health.restarts, 0);
    stream.recovers();
}

#[test]
fn a_restart_keeps_the_contact_and_forgets_its_names() {
    let mut stream = Stream::begin();
    let id = stream.fuser.state(stream.now).contacts[0].contact.track_id;
    // The node starts again within the skin's timeout; it calls the contact 1 as before, by chance, and another one 2.
    stream.sequence = 0;
    stream.now += 100 * MS;
    stream.good(2);
    let state = stream.fuser.state(stream.now);
    assert_eq!((state.skins[0].health.restarts, state.skins[0].health.status), (1, OK));
    assert_eq!(state.contacts[0].contact.track_id, id);
    assert_eq!(state.skins[0].health.lost, 0, "a restart is no loss");
    stream.send(|m| m.sequence += 3);
    assert_eq!(stream.fuser.state(stream.now).skins[0].health.lost, 3);
}

#[test]
fn stamps_of_another_time_are_refused() {
    let mut stream = Stream::begin();
    let shift = |m: &mut ContactArray, ms: i64| {
        m.header.stamp =
            dermis_msgs::builtin_interfaces::msg::Time::from_nanos(m.header.stamp.as_nanos() + ms * MS);
    };
    assert!(!stream.send(|m| shift(m, 3_600_000)), "one frame");
    assert_eq!(stream.ask(), (OK, String::new(), 1), "changes nothing");
    for _ in 0..40 {
        assert!(!stream.send(|m| shift(m, 3_005)));
    }
    let (status, text, contacts) = stream.ask();
    assert_eq!((status, contacts), (FAULT, 0));
    insta::assert_snapshot!(text, @"skin `a`: its stamps lie 3.00 s ahead of the clock of this machine; synchronise the clocks");
    stream.recovers();
    for _ in 0..40 {
        assert!(!stream.send(|m| shift(m, -4_995)));
    }
    let (status, text, contacts) = stream.ask();
    assert_eq!((status, contacts), (FAULT, 0));
    insta::assert_snapshot!(text, @"skin `a`: its frames are 5.00 s old when they come; synchronise the clocks, or find what delays them");
    stream.recovers();
}

#[test]
fn a_flood_is_bounded() {
    let mut stream = Stream::begin();
    let before = stream.fuser.state(stream.now).skins[0].health.refused;
    let mut used = 0;
    for k in 0..20_000_i64 {
        // 100,000 a second.
        let now = stream.now + k * MS / 100;
        stream.sequence += 1;
        let message = report("a", stream.sequence, now - MS, &[contact(1, 0.0, 0.0, 3.0)]);
        used += u32::from(stream.fuser.take(0, &message, Some([1; 16]), now));
    }
    stream.now += 200 * MS;
    // 2,000 a second for 0.2 s, and the burst of 0.1 s.
    assert!((590..=610).contains(&used), "{used}");
    let (status, text, contacts) = stream.ask();
    assert_eq!((status, contacts), (ContactArray::STATUS_DEGRADED, 1));
    insta::assert_snapshot!(text, @"skin `a`: sends more than 2000 reports a second; those beyond are dropped: lower its rate, or raise `most_reports`");
    assert_eq!(stream.fuser.state(stream.now).skins[0].health.refused - before, 20_000 - u64::from(used));
    stream.recovers();
}

/// 1,000 a second of a skin of 100 Hz: less than `most_reports`.
#[test]
fn a_skin_that_sends_more_than_its_rate_is_bounded() {
    let mut stream = Stream::of(stated(100.0));
    assert_eq!(stream.run(1900, 190), 1900, "nearly twice its rate");
    assert_eq!(stream.ask(), (OK, String::new(), 1));
    let refused = stream.fuser.state(stream.now).skins[0].health.refused;
    let used = stream.run(2000, 1000);
    // 200 a second for 2 s, and the 64 that may wait.
    assert!((459..=469).contains(&used), "{used}");
    let (status, text, contacts) = stream.ask();
    assert_eq!((status, contacts), (ContactArray::STATUS_DEGRADED, 1));
    insta::assert_snapshot!(text, @"skin `a`: sends more than 200 reports a second, twice the rate that is stated for it; those beyond are dropped: lower its rate, or correct `rate` in its skin file or in the robot file");
    assert_eq!(stream.fuser.state(stream.now).skins[0].health.refused - refused, u64::from(2000 - used));
    stream.recovers();
    // Nobody states a rate: `most_reports` bounds it.
    let mut stream = Stream::begin();
    assert_eq!(stream.run(2000, 1000), 2000);
    assert_eq!(stream.ask(), (OK, String::new(), 1));
}

/// A rate in a file does not raise what the fusion takes.
#[test]
fn the_lower_limit_counts() {
    let mut stream = Stream::of(stated(5000.0));
    let used = stream.run(5000, 5000);
    // 2,000 a second for 1 s, and the burst of 0.1 s.
    assert!((2190..=2210).contains(&used), "{used}");
    assert!(stream.ask().1.ends_with("or raise `most_reports`"));
}

/// What a network holds back for half a second comes at once.
#[test]
fn a_stall_is_no_flood() {
    let mut stream = Stream::of(stated(100.0));
    let begun = stream.now;
    stream.now += 500 * MS;
    for k in 1..=50 {
        stream.sequence += 1;
        let stamp = begun + k * 10 * MS;
        let message = report("a", stream.sequence, stamp, &[contact(1, 0.0, 0.0, 3.0)]);
        assert!(stream.fuser.take(0, &message, Some([1; 16]), stream.now), "report {k}");
    }
    assert_eq!(stream.ask(), (OK, String::new(), 1));
    stream.good(100);
    assert_eq!(stream.ask(), (OK, String::new(), 1));
}

#[test]
fn two_skins_of_one_name_are_a_fault() {
    let mut stream = Stream::begin();
    let mut other = 500;
    for k in 0..40 {
        if k % 2 == 0 {
            stream.send(|_| ());
        } else {
            other += 1;
            stream.send_from([2; 16], |m| m.sequence = other);
        }
    }
    let (status, text, contacts) = stream.ask();
    assert_eq!((status, contacts), (FAULT, 0));
    insta::assert_snapshot!(text, @"skin `a`: two nodes publish on /a/contacts; stop one of them, or give each device its own name and namespace");
    stream.recovers();
    // A node that was started again is no second one.
    for _ in 0..5 {
        assert!(stream.send_from([3; 16], |_| ()));
    }
    assert_eq!(stream.ask().0, OK);
    // Where the wire tells no publishers, sequences tell.
    for k in 0..40_u64 {
        stream.now += 10 * MS;
        let sequence = if k % 2 == 0 { 10_000 + k } else { 20_000 + k };
        let message = report("a", sequence, stream.now - 5 * MS, &[]);
        stream.fuser.take(0, &message, None, stream.now);
    }
    assert_eq!(stream.ask().0, FAULT);
}

#[test]
fn messages_of_another_skin_or_frame_are_refused() {
    let mut stream = Stream::begin();
    for _ in 0..40 {
        assert!(!stream.send(|m| m.skin = "palm".into()));
    }
    insta::assert_snapshot!(stream.ask().1, @"skin `a`: /a/contacts carries skin `palm`; start its node with `--instance a`, or correct the robot file");
    assert_eq!(stream.ask().2, 0);
    stream.recovers();
    for _ in 0..40 {
        assert!(!stream.send(|m| m.header.frame_id = "pad_link".into()));
    }
    insta::assert_snapshot!(stream.ask().1, @"skin `a`: its messages are in the coordinate frame `pad_link` and the robot file places `a_skin`; start its node with `--frame-id a_skin`, or correct the robot file");
    stream.recovers();
    for _ in 0..40 {
        assert!(!stream.send(|m| m.contacts = vec![m.contacts[0].clone(); 2000]));
    }
    insta::assert_snapshot!(stream.ask().1, @"skin `a`: reports 2000 contacts at once, more than 1024; check its model and threshold");
    stream.recovers();
}

#[test]
fn what_a_skin_says_of_itself_counts() {
    let mut stream = Stream::begin();
    assert!(!stream.send(|m| {
        m.status = ContactArray::STATUS_UNCALIBRATED;
        m.status_text = "not tared yet".into();
        m.contacts.clear();
    }));
    assert_eq!(stream.ask(), (ContactArray::STATUS_UNCALIBRATED, "skin `a`: not tared yet".into(), 0));
    stream.recovers();
    assert!(stream.send(|m| {
        m.status = ContactArray::STATUS_DEGRADED;
        m.status_text = "2 channels are dead".into();
    }));
    assert_eq!(stream.ask(), (ContactArray::STATUS_DEGRADED, "skin `a`: 2 channels are dead".into(), 1));
    stream.recovers();
    let health = stream.fuser.state(stream.now).skins[0].health.clone();
    assert!((health.rate - 100.0).abs() < 1.0, "{health:?}");
}

#[test]
fn a_clock_that_jumps_back_begins_anew() {
    let mut stream = Stream::begin();
    stream.fuser.reset(dermis_body::HistoryLimits::default());
    stream.now = BEGIN - 3_600_000 * MS;
    assert_eq!(stream.ask().0, STALE);
    stream.recovers();
}
