//! What comes from one skin, and whether it can be used.
//!
//! Problem: a skin dies, freezes, starts again, jumps in time, floods, or has a double. Every such fault has one outcome and one sentence,
//! and is over as soon as good reports come again:
//!
//! | fault | outcome | status |
//! |---|---|---|
//! | nothing has come yet, or nothing for longer than the skin's timeout | its contacts end | STALE |
//! | the same frame again and again, whatever its stamp | none of it counts, so that the skin is stale after its timeout | STALE |
//! | the skin itself says that it cannot tell | its contacts end | what it says |
//! | it started again: its sequence begins anew | its reports count on; what it called its contacts does not | as before |
//! | stamps ahead of the clock here, or too old | refused, report by report | FAULT |
//! | stamps further back than its neighbours have gone on | refused, report by report | STALE |
//! | another skin's name or coordinate frame | refused: its contacts would be in the wrong place | FAULT |
//! | two publishers of its name | refused until one of them is silent for 0.5 s | FAULT |
//! | more reports than twice its rate or [`most_reports`](crate::Settings::most_reports) | those beyond are dropped | DEGRADED |
//!
//! The rate of a skin is what the robot file or its skin file states ([`SkinOnBody::rate`]). A token bucket holds its reports to
//! the limit. As many as may wait for the node may come at once: a stall is no flood.

use dermis_body::SkinOnBody;
use dermis_msgs::msg::ContactArray;
use dermis_skin::Stamp;

use crate::settings::Settings;
use crate::track::seconds;

/// \[s\] for which what was last wrong is remembered where reports come again.
const REMEMBERED: f64 = 0.5;
/// Restarts within [`RESTART_TIME`] that make two publishers likely, where publishers cannot be distinguished.
const RESTARTS: u32 = 3;
/// \[s\]
const RESTART_TIME: f64 = 1.0;
/// Times the rate that is stated for a skin, above which its reports are a flood: no device's clock is so far off.
const EXCESS: f64 = 2.0;
/// \[s\] for which reports may come faster than they are allowed to, as after a stall,
const BURST: f64 = 0.1;
/// and how many may in any case: reports of one skin that may wait to be worked in.
pub(crate) const WAITING: usize = 64;
/// Contacts of one report.
const MOST_CONTACTS: usize = 1024;

/// What a skin can feel now.
#[derive(Debug, Clone, PartialEq)]
pub struct Health {
    /// `ContactArray::STATUS_*`
    pub status: u8,
    /// One sentence, empty where the status is OK.
    pub text: String,
    /// When its latest frame was acquired; 0 where none has come.
    pub stamp: Stamp,
    /// \[Hz\] of its frames; NaN before the second.
    pub rate: f64,
    /// Frames that it counted and that did not come.
    pub lost: u64,
    /// Reports that came and were not used.
    pub refused: u64,
    /// Times that it started again.
    pub restarts: u64,
}

impl Health {
    /// Whether its contacts count.
    #[must_use]
    pub fn feels(&self) -> bool {
        ContactArray::feels(self.status)
    }
}

/// What to do with a report.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Verdict {
    /// Its contacts count.
    Use,
    /// It says that the skin feels nothing.
    Blind,
    /// It does not count.
    Refused,
}

/// The last report that counted.
#[derive(Debug, Clone, Copy)]
struct Accepted {
    stamp: Stamp,
    sequence: u64,
    /// When it came.
    came: Stamp,
}

/// What is known of one skin by its reports.
#[derive(Debug, Clone)]
pub(crate) struct Intake {
    name: String,
    frame_id: String,
    topic: String,
    /// \[s\]
    timeout: f64,
    /// \[Hz\] of its frames, where a file states it.
    stated: Option<f64>,
    accepted: Option<Accepted>,
    /// What the skin says of itself, and when it came.
    said: Option<(u8, String, Stamp)>,
    /// Why the last refused report was, when it came, and what that makes of the skin.
    refusal: Option<(String, Stamp, u8)>,
    /// Publishers that have sent, the last one at the end.
    publishers: Vec<[u8; 16]>,
    /// When two publishers were last seen to take turns.
    doubled: Option<Stamp>,
    /// Restarts in a row, and when the first was.
    turns: (u32, Stamp),
    /// When a report was last dropped because too many came.
    flooded: Option<Stamp>,
    /// Reports that may come now, and when that was computed.
    allowance: (f64, Stamp),
    /// \[s\] between its frames, smoothed; NaN before the second.
    period: f64,
    lost: u64,
    refused: u64,
    restarts: u64,
    /// Whether the skin has started again since [`take_restart`](Self::take_restart).
    restarted: bool,
}

impl Intake {
    /// Of this skin, whose contacts come on `topic`.
    pub(crate) fn new(skin: &SkinOnBody, topic: String) -> Self {
        Self {
            name: skin.name.clone(),
            frame_id: skin.frame_id.clone(),
            topic,
            timeout: skin.timeout,
            stated: skin.rate,
            accepted: None,
            said: None,
            refusal: None,
            publishers: Vec::new(),
            doubled: None,
            turns: (0, 0),
            flooded: None,
            allowance: (f64::INFINITY, 0),
            period: f64::NAN,
            lost: 0,
            refused: 0,
            restarts: 0,
            restarted: false,
        }
    }

    /// Judges a report that came at `now`.
    pub(crate) fn take(
        &mut self,
        report: &ContactArray,
        publisher: Option<[u8; 16]>,
        now: Stamp,
        s: &Settings,
    ) -> Verdict {
        if !self.allows(now, s) {
            return self.count_refused();
        }
        if self.is_doubled(publisher, now) {
            return self.count_refused();
        }
        if let Some((why, status)) = self.wrong(report, now, s) {
            return self.refuse(why, now, status);
        }
        if !ContactArray::feels(report.status) {
            self.said = Some((report.status, report.status_text.clone(), now));
            return Verdict::Blind;
        }
        let stamp = report.header.stamp.as_nanos();
        if let Some(last) = self.accepted
            && !self.follows(last, stamp, report.sequence, now, s)
        {
            return self.count_refused();
        }
        self.accepted = Some(Accepted { stamp, sequence: report.sequence, came: now });
        self.said = Some((report.status, report.status_text.clone(), now));
        Verdict::Use
    }

    /// Takes back that the last report counted: its neighbours have gone on.
    pub(crate) fn was_late(&mut self, before: Option<Stamp>, now: Stamp, s: &Settings) {
        // What does not count keeps nobody from being stale.
        if let Some(accepted) = &mut self.accepted {
            accepted.came = before.unwrap_or(accepted.came.saturating_sub((self.timeout * 2e9) as i64));
        }
        let why = format!(
            "skin `{}`: its frames come more than {} ms after those of its neighbours; find what delays them, synchronise its clock, \
             or raise `reorder`",
            self.name,
            s.reorder * 1e3
        );
        self.refuse(why, now, ContactArray::STATUS_STALE);
    }

    /// When the last report that counted came.
    pub(crate) fn came(&self) -> Option<Stamp> {
        self.accepted.map(|a| a.came)
    }

    /// Whether the skin has started again since the last call.
    pub(crate) fn take_restart(&mut self) -> bool {
        std::mem::take(&mut self.restarted)
    }

    fn count_refused(&mut self) -> Verdict {
        self.refused += 1;
        Verdict::Refused
    }

    fn refuse(&mut self, why: String, now: Stamp, status: u8) -> Verdict {
        self.refusal = Some((why, now, status));
        self.count_refused()
    }

    /// \[Hz\] of its reports above which further ones are dropped, and whether it is its own rate that says so.
    fn most_reports(&self, s: &Settings) -> (f64, bool) {
        match self.stated.map(|rate| EXCESS * rate).filter(|most| *most <= s.most_reports) {
            Some(most) => (most, true),
            None => (s.most_reports, false),
        }
    }

    /// Whether one more report may come now (a token bucket).
    fn allows(&mut self, now: Stamp, s: &Settings) -> bool {
        let (left, since) = self.allowance;
        let (rate, _) = self.most_reports(s);
        let most = (rate * BURST).max(WAITING as f64);
        let left = (left + seconds(since, now).max(0.0) * rate).min(most);
        let allowed = left >= 1.0;
        self.allowance = (if allowed { left - 1.0 } else { left }, now);
        if !allowed {
            self.flooded = Some(now);
        }
        allowed
    }

    /// Whether two publishers take turns.
    fn is_doubled(&mut self, publisher: Option<[u8; 16]>, now: Stamp) -> bool {
        if let Some(publisher) = publisher
            && self.publishers.last() != Some(&publisher)
        {
            let known = self.publishers.iter().position(|p| *p == publisher);
            if let Some(known) = known {
                self.publishers.remove(known);
                self.doubled = Some(now);
            }
            self.publishers.push(publisher);
            if self.publishers.len() > 8 {
                self.publishers.remove(0);
            }
        }
        self.doubled.is_some_and(|at| (0.0..REMEMBERED).contains(&seconds(at, now)))
    }

    /// Why a report cannot be of this skin and of now, and what that makes of the skin.
    fn wrong(&self, report: &ContactArray, now: Stamp, s: &Settings) -> Option<(String, u8)> {
        let Self { name, topic, frame_id, .. } = self;
        let fault = |text: String| Some((text, ContactArray::STATUS_FAULT));
        if report.skin != *name {
            return fault(format!(
                "skin `{name}`: {topic} carries skin `{}`; start its node with `--instance {name}`, or correct the robot file",
                report.skin
            ));
        }
        if report.header.frame_id != *frame_id {
            return fault(format!(
                "skin `{name}`: its messages are in the coordinate frame `{}` and the robot file places `{frame_id}`; start its node \
                 with `--frame-id {frame_id}`, or correct the robot file",
                report.header.frame_id
            ));
        }
        if report.contacts.len() > MOST_CONTACTS {
            return fault(format!(
                "skin `{name}`: reports {} contacts at once, more than {MOST_CONTACTS}; check its model and threshold",
                report.contacts.len()
            ));
        }
        let age = seconds(report.header.stamp.as_nanos(), now);
        if age < -s.ahead {
            return fault(format!(
                "skin `{name}`: its stamps lie {:.2} s ahead of the clock of this machine; synchronise the clocks",
                -age
            ));
        }
        if age > s.oldest && ContactArray::feels(report.status) {
            return fault(format!(
                "skin `{name}`: its frames are {age:.2} s old when they come; synchronise the clocks, or find what delays them"
            ));
        }
        None
    }

    /// Whether a report is newer than the last one; what that says of the skin is noted.
    fn follows(&mut self, last: Accepted, stamp: Stamp, sequence: u64, now: Stamp, s: &Settings) -> bool {
        let step = seconds(last.stamp, stamp);
        if sequence > last.sequence {
            if step <= 0.0 && -step <= s.reorder {
                // A newer frame with an older stamp: its clock was corrected.
                return false;
            }
            self.lost += sequence - last.sequence - 1;
        } else if sequence == last.sequence {
            // With a new stamp, too: a node that has stopped reading may go on stamping.
            let why = format!(
                "skin `{}`: sends frame {sequence} again and again; restart its node, or check what it reads",
                self.name
            );
            self.refusal = Some((why, now, ContactArray::STATUS_STALE));
            return false;
        } else if step <= 0.0 && -step <= s.reorder {
            // Overtaken on the way.
            return false;
        } else {
            self.restart(now);
        }
        if step <= 0.0 {
            self.period = f64::NAN;
        } else if step < 1.0 {
            self.period = if self.period.is_nan() { step } else { self.period + 0.05 * (step - self.period) };
        }
        true
    }

    fn restart(&mut self, now: Stamp) {
        self.restarts += 1;
        self.restarted = true;
        let (turns, since) = self.turns;
        self.turns =
            if turns > 0 && seconds(since, now) < RESTART_TIME { (turns + 1, since) } else { (1, now) };
        if self.turns.0 >= RESTARTS {
            self.doubled = Some(now);
        }
    }

    /// What the skin can feel at `now`.
    pub(crate) fn health(&self, now: Stamp, s: &Settings) -> Health {
        let (status, text) = self.evaluate(now, s);
        Health {
            status,
            text,
            stamp: self.accepted.map_or(0, |a| a.stamp),
            rate: 1.0 / self.period,
            lost: self.lost,
            refused: self.refused,
            restarts: self.restarts,
        }
    }

    fn evaluate(&self, now: Stamp, s: &Settings) -> (u8, String) {
        let Self { name, topic, .. } = self;
        let recent = |at: Stamp, span: f64| seconds(at, now) <= span;
        if self.doubled.is_some_and(|at| recent(at, REMEMBERED)) {
            let text = format!(
                "skin `{name}`: two nodes publish on {topic}; stop one of them, or give each device its own name and namespace"
            );
            return (ContactArray::STATUS_FAULT, text);
        }
        let said = self.said.as_ref().filter(|(_, _, at)| recent(*at, self.timeout));
        if let Some((status, text, _)) = said.filter(|(status, ..)| !ContactArray::feels(*status)) {
            return (*status, self.sentence(text));
        }
        let silence = self.accepted.map(|a| seconds(a.came, now));
        if silence.is_none_or(|silence| silence > self.timeout) {
            if let Some((why, at, status)) = &self.refusal
                && recent(*at, self.timeout.max(REMEMBERED))
            {
                return (*status, why.clone());
            }
            let text = match silence {
                None => format!(
                    "skin `{name}`: nothing has come on {topic}; start its node, or correct its namespace in the robot file"
                ),
                Some(silence) => format!(
                    "skin `{name}`: nothing has come for {silence:.1} s; check that its node runs, and the network between"
                ),
            };
            return (ContactArray::STATUS_STALE, text);
        }
        if self.flooded.is_some_and(|at| recent(at, REMEMBERED)) {
            return (ContactArray::STATUS_DEGRADED, self.flood(s));
        }
        match said {
            Some((status, text, _)) if *status != ContactArray::STATUS_OK => (*status, self.sentence(text)),
            _ => (ContactArray::STATUS_OK, String::new()),
        }
    }

    /// That it sends too much.
    fn flood(&self, s: &Settings) -> String {
        let (most, own) = self.most_reports(s);
        let (what, remedy) = match own {
            true => (
                ", twice the rate that is stated for it",
                "correct `rate` in its skin file or in the robot file",
            ),
            false => ("", "raise `most_reports`"),
        };
        format!(
            "skin `{}`: sends more than {most} reports a second{what}; those beyond are dropped: lower its rate, or {remedy}",
            self.name
        )
    }

    /// What the skin says of itself, with its name.
    fn sentence(&self, text: &str) -> String {
        let name = &self.name;
        if text.is_empty() {
            format!("skin `{name}`: it does not say why; see its diagnostics")
        } else if text.contains(&format!("`{name}`")) {
            text.to_owned()
        } else {
            format!("skin `{name}`: {text}")
        }
    }
}

#[cfg(test)]
mod tests;
