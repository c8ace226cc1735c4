use dermis_msgs::geometry_msgs::msg::Vector3;
use dermis_msgs::msg::{BodyContact, Contact, SkinHealth};
use dermis_msgs::std_msgs::msg::Header;

use super::*;
use crate::outputs::Order;

const MS: Duration = Duration::from_millis(1);

/// Rules over two inputs, `palm` (late after 20 ms) and `sole` (after 50 ms); the first rule has these lines.
fn rules(start: &str, rule: &str) -> Rules {
    let text = format!(
        "schema = 'dermis-reflex/1'\nname = 'test'\nstart = '{start}'\n\
         [inputs.palm]\nkind = 'skin'\ntopic = 'palm'\nskin = 'palm'\ntimeout = 0.02\nmax_age = 0.01\n\
         [inputs.sole]\nkind = 'skin'\ntopic = 'sole'\nskin = 'sole'\ntimeout = 0.05\n\
         [limits.person]\nquasi_static = {{ force = 10.0 }}\ntransient = {{ force = 20.0 }}\ntime_to_quasi_static = 0.1\n\
         [actions.stop]\nkind = 'bool'\ntopic = 'stop'\nrepeat = 0.01\n\
         [actions.slow]\nkind = 'speed_scale'\ntopic = 'scale'\nscale = 0.2\nrepeat = 0.01\n\
         [[rules]]\nname = 'r'\ninputs = ['palm']\nactions = ['stop']\n{rule}\n\
         [[rules]]\nname = 'slow'\ninputs = ['sole']\nforce = {{ above = 1.0 }}\nlatch = false\nactions = ['slow']\n"
    );
    Rules::from_toml(&text, "test.toml").unwrap_or_else(|e| panic!("{e}"))
}

const PALM: usize = 0;
const SOLE: usize = 1;

/// A machine with the time and numbers of its messages.
struct Rig {
    reflex: Reflex,
    now: Duration,
    sequence: u64,
    sent: Vec<(Duration, Order)>,
    events: Vec<String>,
}

impl Rig {
    fn new(start: &str, rule: &str) -> Self {
        let reflex = Reflex::new(rules(start, rule), Duration::ZERO);
        let mut rig = Self { reflex, now: Duration::ZERO, sequence: 0, sent: vec![], events: vec![] };
        rig.wait(Duration::ZERO);
        rig
    }

    fn note(&mut self, done: &Done) {
        self.sent.extend(done.commands.iter().map(|command| (self.now, command.order)));
        self.events.extend(done.events.iter().map(ToString::to_string));
    }

    fn message(&mut self, skin: &str, status: u8, forces: &[f64]) -> ContactArray {
        self.sequence += 1;
        let stamp = i64::try_from(self.now.as_nanos()).unwrap();
        let contact = |force: &f64| Contact {
            track_id: 1,
            force: Vector3 { x: 0.0, y: 0.0, z: -force },
            force_components: Contact::FORCE_NORMAL,
            ..Contact::default()
        };
        ContactArray {
            header: Header::new(stamp, skin),
            skin: skin.into(),
            sequence: self.sequence,
            status,
            force_max: f32::NAN,
            contacts: forces.iter().map(contact).collect(),
            ..ContactArray::default()
        }
    }

    fn palm(&mut self, forces: &[f64]) {
        let message = self.message("palm", 0, forces);
        let done = self.reflex.skin(PALM, &message, self.now, 0);
        self.note(&done);
    }

    fn blind(&mut self) {
        let message = self.message("palm", ContactArray::STATUS_STALE, &[]);
        let done = self.reflex.skin(PALM, &message, self.now, 0);
        self.note(&done);
    }

    fn sole(&mut self, forces: &[f64]) {
        let message = self.message("sole", 0, forces);
        let done = self.reflex.skin(SOLE, &message, self.now, 0);
        self.note(&done);
    }

    /// Lets time pass; the machine is called when it requested to be, and at the end.
    fn wait(&mut self, time: Duration) {
        let end = self.now + time;
        let mut calls = 0;
        while let Some(wake) = self.reflex.next_wake().filter(|wake| *wake <= end) {
            assert!(wake > self.now || calls == 0, "it asks to be called at {wake:?} again and again");
            self.now = self.now.max(wake);
            let done = self.reflex.tick(self.now);
            self.note(&done);
            calls += 1;
            assert!(calls < 10_000, "it never rests");
        }
        self.now = end;
        let done = self.reflex.tick(end);
        self.note(&done);
    }

    /// Light contacts on both skins every millisecond.
    fn quietly(&mut self, time: Duration) {
        let end = self.now + time;
        while self.now < end {
            self.palm(&[]);
            self.sole(&[]);
            self.wait(MS);
        }
    }

    fn release(&mut self) -> Result<(), String> {
        let done = self.reflex.release(self.now).map_err(|refused| refused.to_string())?;
        self.note(&done);
        Ok(())
    }

    fn acts(&self) -> bool {
        self.reflex.states().any(|state| state.rule == "r" && state.acts.is_some())
    }

    fn stops(&self) -> usize {
        self.sent.iter().filter(|(_, order)| *order == Order::Bool(true)).count()
    }
}

const FORCE: &str = "force = { above = 5.0, release = 4.0 }";

#[test]
fn a_touch_stops_in_the_same_call_and_is_repeated() {
    let mut rig = Rig::new("clear", FORCE);
    rig.quietly(300 * MS);
    assert!(!rig.acts());
    rig.sent.clear();
    rig.palm(&[6.0]);
    assert_eq!(rig.sent, [(rig.now, Order::Bool(true))]);
    rig.quietly(100 * MS);
    assert_eq!(rig.stops(), 11, "every 10 ms while it acts");
    assert_eq!(rig.events.last().unwrap(), "rule `r` acts: a force of 6 N on skin `palm` is above 5 N");
}

#[test]
fn a_latched_stop_stays_until_it_is_released() {
    let mut rig = Rig::new("clear", FORCE);
    rig.quietly(300 * MS);
    rig.palm(&[6.0]);
    assert_eq!(
        rig.release().unwrap_err(),
        "rule `r` is not released: a force of 6 N on skin `palm` is above 5 N"
    );
    rig.palm(&[4.5]);
    assert_eq!(
        rig.release().unwrap_err(),
        "rule `r` is not released: a force of 6 N on skin `palm` is above 5 N",
        "between the thresholds, it holds for the reason before"
    );
    rig.palm(&[]);
    let refused = rig.release().unwrap_err();
    assert_eq!(
        refused,
        "rule `r` is not released: its conditions have been quiet for 0.000 s only, of 0.2 s"
    );
    rig.quietly(10_000 * MS);
    assert!(rig.acts());
    rig.release().unwrap();
    assert!(!rig.acts());
    assert_eq!(rig.sent.last().unwrap().1, Order::Bool(false));
    assert_eq!(rig.events.last().unwrap(), "rule `r` is released");
    rig.release().unwrap();
}

#[test]
fn a_rule_that_does_not_latch_ends_after_its_quiet_time() {
    let mut rig = Rig::new("clear", &format!("{FORCE}\nlatch = false\nquiet = 0.03"));
    rig.quietly(300 * MS);
    rig.palm(&[6.0]);
    rig.wait(MS);
    let begun = rig.now;
    rig.quietly(100 * MS);
    assert!(!rig.acts());
    let (end, _) = rig.sent.iter().rev().find(|(_, order)| *order == Order::Bool(false)).unwrap();
    assert_eq!(*end - begun, 30 * MS);
    // Within the hysteresis nothing ends.
    rig.palm(&[6.0]);
    for _ in 0..100 {
        rig.palm(&[4.5]);
        rig.wait(MS);
    }
    assert!(rig.acts());
}

#[test]
fn an_input_that_falls_silent_acts_at_its_timeout() {
    let mut rig = Rig::new("clear", FORCE);
    rig.quietly(300 * MS);
    rig.sent.clear();
    let last = rig.now - MS;
    rig.wait(100 * MS);
    let (at, _) = rig.sent.iter().find(|(_, order)| *order == Order::Bool(true)).unwrap();
    assert_eq!(*at, last + 20 * MS);
    assert!(rig.events.contains(&"rule `r` acts: input `palm` brought nothing new for 0.02 s".to_owned()));
    // It comes back, and the stop stays.
    rig.quietly(1000 * MS);
    assert!(rig.acts());
    rig.release().unwrap();
}

#[test]
fn messages_that_repeat_themselves_or_are_old_are_no_news() {
    let mut rig = Rig::new("clear", FORCE);
    rig.quietly(300 * MS);
    let frozen = rig.message("palm", 0, &[]);
    for _ in 0..30 {
        let done = rig.reflex.skin(PALM, &frozen, rig.now, 0);
        rig.note(&done);
        rig.wait(MS);
    }
    let text = "rule `r` acts: input `palm` brought nothing new for 0.02 s: its messages repeat themselves";
    assert!(rig.events.iter().any(|event| event == text), "{:?}", rig.events);

    // With new stamps: its node reads nothing, and goes on stamping.
    let mut rig = Rig::new("clear", FORCE);
    rig.quietly(300 * MS);
    let number = rig.sequence;
    for _ in 0..30 {
        let message = ContactArray { sequence: number, ..rig.message("palm", 0, &[]) };
        let done = rig.reflex.skin(PALM, &message, rig.now, 0);
        rig.note(&done);
        rig.wait(MS);
    }
    assert!(rig.events.iter().any(|event| event == text), "{:?}", rig.events);
    // One that is blind has no other number to give, and says why it is blind.
    let mut rig = Rig::new("clear", FORCE);
    rig.quietly(300 * MS);
    let number = rig.sequence;
    for _ in 0..30 {
        let stale = rig.message("palm", ContactArray::STATUS_STALE, &[]);
        let done = rig.reflex.skin(PALM, &ContactArray { sequence: number, ..stale }, rig.now, 0);
        rig.note(&done);
        rig.wait(MS);
    }
    assert!(rig.acts() && !rig.events.iter().any(|event| event == text), "{:?}", rig.events);

    for age in [11_000_000, -11_000_000] {
        let mut rig = Rig::new("clear", FORCE);
        rig.quietly(300 * MS);
        for _ in 0..30 {
            let message = rig.message("palm", 0, &[]);
            let done = rig.reflex.skin(PALM, &message, rig.now, age);
            rig.note(&done);
            rig.wait(MS);
        }
        let text = format!("its messages arrive {}.0 ms after their stamps", age / 1_000_000);
        assert!(rig.events.last().unwrap().ends_with(&text), "{:?}", rig.events);
    }
    // What an old message says counts all the same.
    let mut rig = Rig::new("clear", &format!("{FORCE}\ncounts_as_touched = []"));
    let message = rig.message("palm", 0, &[6.0]);
    let done = rig.reflex.skin(PALM, &message, rig.now, 1_000_000_000);
    rig.note(&done);
    assert!(rig.acts());
}

#[test]
fn a_rule_that_counts_no_loss_ignores_silence() {
    let mut rig = Rig::new("clear", &format!("{FORCE}\ncounts_as_touched = []"));
    rig.quietly(10 * MS);
    rig.wait(1000 * MS);
    assert!(!rig.acts());
    // What was detected last counts on.
    rig.palm(&[6.0]);
    rig.wait(1000 * MS);
    assert!(rig.release().is_err());
}

#[test]
fn a_fresh_start_is_stopped_until_it_is_released() {
    let mut rig = Rig::new("stopped", FORCE);
    assert!(rig.acts());
    assert!(rig.sent.contains(&(Duration::ZERO, Order::Bool(true))));
    assert_eq!(rig.release().unwrap_err(), "rule `r` is not released: nothing has come from input `palm`");
    rig.quietly(1000 * MS);
    assert!(rig.acts());
    rig.release().unwrap();
    assert!(!rig.acts());
}

#[test]
fn a_clear_start_waits_for_its_senses_and_then_latches() {
    let mut rig = Rig::new("clear", FORCE);
    assert!(rig.acts(), "nothing has come yet");
    rig.blind();
    rig.wait(MS);
    assert!(rig.acts(), "it does not feel yet");
    rig.quietly(500 * MS);
    assert!(!rig.acts(), "a start does not latch");
    rig.blind();
    rig.quietly(500 * MS);
    assert!(rig.acts(), "from now on it does");
    rig.release().unwrap();
    // A touch during the start latches.
    let mut rig = Rig::new("clear", FORCE);
    rig.palm(&[6.0]);
    rig.quietly(500 * MS);
    assert!(rig.acts());
}

#[test]
fn a_condition_has_to_hold_as_long_as_the_rule_says() {
    let mut rig = Rig::new("clear", &format!("{FORCE}\nhold = 0.01"));
    rig.quietly(300 * MS);
    rig.palm(&[6.0]);
    assert!(!rig.acts());
    rig.wait(9 * MS);
    rig.palm(&[]);
    rig.wait(MS);
    assert!(!rig.acts(), "it was shorter");
    rig.palm(&[6.0]);
    rig.wait(5 * MS);
    rig.palm(&[4.5]);
    let begun = rig.now - 5 * MS;
    rig.wait(10 * MS);
    assert!(rig.acts());
    let (at, _) = rig.sent.iter().rev().find(|(_, order)| *order == Order::Bool(true)).unwrap();
    assert_eq!(*at, begun + 10 * MS, "without a further message");
}

#[test]
fn a_lasting_contact_has_the_lower_limit() {
    let limits = "limits = 'person'";
    let press = |rig: &mut Rig, force: f64, ms: u32| {
        for _ in 0..ms {
            rig.palm(&[force]);
            rig.sole(&[]);
            rig.wait(MS);
        }
    };
    let mut rig = Rig::new("clear", limits);
    rig.quietly(300 * MS);
    press(&mut rig, 15.0, 99);
    assert!(!rig.acts(), "it is short");
    rig.wait(MS);
    assert!(rig.acts(), "no message is needed");
    assert!(rig.events.last().unwrap().contains("the quasi-static limit of `person`"));

    let mut rig = Rig::new("clear", limits);
    rig.quietly(300 * MS);
    rig.palm(&[21.0]);
    assert!(rig.acts() && rig.events.last().unwrap().contains("the transient limit"));

    // A break shorter than `quiet` does not start the time anew, a longer one does.
    let mut rig = Rig::new("clear", limits);
    rig.quietly(300 * MS);
    press(&mut rig, 15.0, 60);
    rig.quietly(100 * MS);
    rig.palm(&[15.0]);
    assert!(rig.acts());
    let mut rig = Rig::new("clear", limits);
    rig.quietly(300 * MS);
    press(&mut rig, 15.0, 60);
    rig.quietly(210 * MS);
    press(&mut rig, 15.0, 60);
    assert!(!rig.acts());
    // A light contact that becomes heavy has lasted already.
    let mut rig = Rig::new("clear", limits);
    rig.quietly(300 * MS);
    press(&mut rig, 1.0, 150);
    assert!(!rig.acts());
    rig.palm(&[15.0]);
    assert!(rig.acts());
}

#[test]
fn rules_are_apart_from_each_other() {
    let mut rig = Rig::new("clear", FORCE);
    rig.quietly(300 * MS);
    rig.sent.clear();
    rig.sole(&[2.0]);
    assert_eq!(rig.sent, [(rig.now, Order::Scale(0.2))]);
    assert!(!rig.acts());
    rig.palm(&[6.0]);
    rig.quietly(1000 * MS);
    assert_eq!(
        rig.sent.iter().filter(|(_, order)| *order == Order::Scale(1.0)).count(),
        1,
        "it does not latch"
    );
    assert!(rig.acts());
}

#[test]
fn the_fusion_is_heard_like_a_skin() {
    let text = "schema = 'dermis-reflex/1'\nname = 'test'\nstart = 'clear'\n\
        [inputs.body]\nkind = 'body'\ntopic = 'body_contacts'\ntimeout = 0.02\n\
        [actions.stop]\nkind = 'bool'\ntopic = 'stop'\n\
        [[rules]]\nname = 'r'\nforce = { above = 5.0 }\nactions = ['stop']\n";
    let mut reflex = Reflex::new(Rules::from_toml(text, "t").unwrap(), Duration::ZERO);
    let well = SkinHealth { skin: "palm".into(), link: "hand".into(), ..SkinHealth::default() };
    let mut message = BodyContacts { skins: vec![well], ..BodyContacts::default() };
    for ms in 1..400 {
        message.sequence += 1;
        reflex.body(0, &message, ms * MS, 0);
    }
    assert!(reflex.states().all(|state| state.acts.is_none()));
    message.sequence += 1;
    let contact =
        Contact { force: Vector3 { x: 6.0, y: 0.0, z: 0.0 }, force_components: 2, ..Contact::default() };
    message.contacts.push(BodyContact { contact, link: "hand".into(), ..BodyContact::default() });
    let done = reflex.body(0, &message, 400 * MS, 0);
    assert_eq!(done.events[0].to_string(), "rule `r` acts: a force of 6 N on link `hand` is above 5 N");
    let silent: Vec<_> = reflex.silences(405 * MS).collect();
    assert_eq!(silent, [("body", Some(5 * MS))]);
}

#[test]
fn the_last_words_are_to_stop() {
    let rig = Rig::new("clear", FORCE);
    let orders: Vec<Order> = rig.reflex.last_words().iter().map(|command| command.order).collect();
    assert_eq!(orders, [Order::Scale(0.2), Order::Bool(true)], "in the order of the actions' names");
    // Who goes on says where it stands.
    let mut rig = Rig::new("clear", FORCE);
    rig.quietly(300 * MS);
    let now = rig.now;
    let orders: Vec<Order> = rig.reflex.resume(now).commands.iter().map(|command| command.order).collect();
    assert_eq!(orders, [Order::Scale(1.0), Order::Bool(false)]);
    let mut silent = rules("clear", FORCE);
    silent.at_end = AtEnd::Silent;
    assert!(Reflex::new(silent, Duration::ZERO).last_words().is_empty());
}

mod properties;
