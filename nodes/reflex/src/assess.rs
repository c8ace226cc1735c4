//! What one message means for one rule.
//!
//! Each contact in the rule's region is compared with the rule's thresholds; of each skin of the region it is checked whether it feels.
//! A number that the message does not give is [`Loss::Unmeasured`] where the rule asks for it, and never 0. The cost is
//! linear in contacts and skins; nothing is remembered here.

use std::slice;

use dermis_msgs::geometry_msgs::msg::Vector3;
use dermis_msgs::msg::{BodyContact, BodyContacts, Contact, ContactArray};

use crate::rules::{
    Cause, ContactLimits, InputKind, LimitPair, Loss, PASCALS_PER_N_PER_CM2, Rule, Rules, Slip, Threshold,
};
use crate::slide::along_surface;

/// What one message of one input means for one rule.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Assessment {
    /// Whether there is a contact in the region.
    pub touched: bool,
    /// Why the rule acts because of a contact; `None` where it does not.
    pub touch: Option<String>,
    /// Why the rule acts because of a lost sense; `None` where it does not.
    pub loss: Option<String>,
    /// Why the rule acts once the contacts have lasted: a force or pressure above the quasi-static limit.
    pub lasting: Option<String>,
    /// Whether a value is above its release threshold: what acts is not released.
    pub holds: bool,
}

/// A contact with what its message says of it beside.
struct Reported<'a> {
    contact: &'a Contact,
    link: Option<&'a str>,
    other_links: &'a [String],
    skins: &'a [String],
    /// \[m/s\] along the surface, NaN where unknown.
    speed: f64,
    slip: u8,
    cause: u8,
    /// \[N\] end of the range in which its force is known, NaN where unknown.
    force_max: f64,
}

impl Reported<'_> {
    fn is_in(&self, rule: &Rule) -> bool {
        rule.region.is_everything()
            || self.link.is_some_and(|link| rule.region.has_link(link))
            || self.other_links.iter().any(|link| rule.region.has_link(link))
            || self.skins.iter().any(|skin| rule.region.has_skin(skin))
    }

    fn is_left_out(&self, rule: &Rule) -> bool {
        let cause = match self.cause {
            BodyContact::CAUSE_SELF => Some(Cause::SelfContact),
            BodyContact::CAUSE_EXPECTED => Some(Cause::Expected),
            _ => None,
        };
        // A confidence that is not a number is not below anything.
        cause.is_some_and(|cause| rule.ignore.contains(&cause))
            || f64::from(self.contact.confidence) < rule.least_confidence
    }

    fn place(&self) -> String {
        match (self.link, self.skins.first()) {
            (Some(link), _) if !link.is_empty() => format!("link `{link}`"),
            (_, Some(skin)) => format!("skin `{skin}`"),
            _ => "the robot".to_owned(),
        }
    }
}

/// What a message of one skin means. `speeds` \[m/s\]: of its contacts along the surface.
pub(crate) fn skin(
    rules: &Rules,
    rule: &Rule,
    input: usize,
    message: &ContactArray,
    speeds: &[f64],
) -> Assessment {
    let mut found = Assessment::default();
    let (expected, link) = match &rules.inputs[input].kind {
        InputKind::Skin { skin, link } => (skin.as_deref(), link.as_deref()),
        InputKind::Body => (None, None),
    };
    if let Some(expected) = expected.filter(|expected| *expected != message.skin) {
        let text = || {
            format!(
                "input `{}` brings skin `{}` where the rules say `{expected}`",
                rules.inputs[input].name, message.skin
            )
        };
        found.lose(rule, Loss::Fault, text);
    }
    if let Some(loss) = loss_of(message.status) {
        found.lose(rule, loss, || skin_text(&message.skin, loss, &message.status_text));
    }
    insensitive(&mut found, rule, message);
    for (i, contact) in message.contacts.iter().enumerate() {
        let reported = Reported {
            contact,
            link,
            other_links: &[],
            skins: slice::from_ref(&message.skin),
            speed: speeds.get(i).copied().unwrap_or(f64::NAN),
            slip: BodyContact::SLIP_UNKNOWN,
            cause: BodyContact::CAUSE_UNKNOWN,
            force_max: f64::from(message.force_max),
        };
        // The input was chosen for the region, as a whole.
        if !reported.is_left_out(rule) {
            found.contact(rule, &reported);
        }
    }
    found
}

/// What a message of the fusion means.
pub(crate) fn body(rules: &Rules, rule: &Rule, message: &BodyContacts) -> Assessment {
    let mut found = Assessment::default();
    health(&mut found, rules, rule, message);
    for contact in &message.contacts {
        let Vector3 { x, y, z } = contact.velocity;
        let reported = Reported {
            contact: &contact.contact,
            link: Some(&contact.link),
            other_links: &contact.other_links,
            skins: &contact.skins,
            speed: along_surface([x, y, z], &contact.contact),
            slip: contact.slip,
            cause: contact.cause,
            force_max: f64::NAN,
        };
        if reported.is_in(rule) && !reported.is_left_out(rule) {
            found.contact(rule, &reported);
        }
    }
    found
}

/// Whether the skins of the region feel, as the fusion says.
fn health(found: &mut Assessment, rules: &Rules, rule: &Rule, message: &BodyContacts) {
    let region = &rule.region;
    let mut worst = BodyContacts::default().status;
    let mut any = false;
    for skin in &message.skins {
        worst = worst.max(skin.status);
        if !region.has_link(&skin.link) && !region.has_skin(&skin.skin) {
            continue;
        }
        any = true;
        let stamp = &skin.stamp;
        let loss = match loss_of(skin.status) {
            Some(Loss::Stale) if stamp.sec == 0 && stamp.nanosec == 0 => Some(Loss::Missing),
            other => other,
        };
        if let Some(loss) = loss {
            found.lose(rule, loss, || skin_text(&skin.skin, loss, &skin.status_text));
        }
    }
    // The fusion itself may be at fault while every skin is well.
    if message.status > worst
        && let Some(loss) = loss_of(message.status)
    {
        found.lose(rule, loss, || sentence("the fused contacts are", loss, &message.status_text));
    }
    let elsewhere = |part: &str, of_link: bool| {
        rule.inputs.iter().any(|i| match &rules.inputs[*i].kind {
            InputKind::Body => false,
            InputKind::Skin { skin, link } => (if of_link { link } else { skin }).as_deref() == Some(part),
        })
    };
    let silent_link =
        region.links.iter().find(|l| !message.skins.iter().any(|s| s.link == **l) && !elsewhere(l, true));
    let silent_skin =
        region.skins.iter().find(|n| !message.skins.iter().any(|s| s.skin == **n) && !elsewhere(n, false));
    if let Some(part) = silent_link.or(silent_skin) {
        found.lose(rule, Loss::Missing, || format!("the fused contacts name no skin for `{part}`"));
    } else if !any && region.is_everything() {
        found.lose(rule, Loss::Missing, || "the fused contacts name no skin at all".to_owned());
    }
}

/// A skin that reports no contact as light as the rule asks for cannot tell.
fn insensitive(found: &mut Assessment, rule: &Rule, message: &ContactArray) {
    let limits = rule.limits.as_ref().and_then(|limits| limits.quasi_static.force);
    let force = rule.force.map(|threshold| threshold.above);
    let least = force.into_iter().chain(limits).fold(f64::INFINITY, f64::min);
    let threshold = f64::from(message.force_threshold);
    if threshold > least {
        let text = || {
            format!(
                "skin `{}` reports no contact below {threshold:.3} N, and the rule asks for {least} N",
                message.skin
            )
        };
        found.lose(rule, Loss::Unmeasured, text);
    }
}

/// What a status means; `None`: the skin feels.
fn loss_of(status: u8) -> Option<Loss> {
    match status {
        ContactArray::STATUS_OK => None,
        ContactArray::STATUS_DEGRADED => Some(Loss::Degraded),
        ContactArray::STATUS_STALE => Some(Loss::Stale),
        ContactArray::STATUS_UNCALIBRATED => Some(Loss::Uncalibrated),
        // One that this program does not know is no good one.
        _ => Some(Loss::Fault),
    }
}

fn skin_text(skin: &str, loss: Loss, text: &str) -> String {
    sentence(&format!("skin `{skin}` is"), loss, text)
}

fn sentence(subject: &str, loss: Loss, text: &str) -> String {
    let of = if loss == Loss::Fault { "at fault" } else { loss.name() };
    if text.is_empty() { format!("{subject} {of}") } else { format!("{subject} {of}: {text}") }
}

/// A value beside a threshold.
enum Compared {
    Below,
    Holds,
    Acts,
    Unknown,
}

fn compare(value: f64, threshold: Threshold) -> Compared {
    if value.is_nan() {
        Compared::Unknown
    } else if value > threshold.above {
        Compared::Acts
    } else if value > threshold.release {
        Compared::Holds
    } else {
        Compared::Below
    }
}

impl Assessment {
    /// A sense is lost in a way that the rule may count.
    fn lose(&mut self, rule: &Rule, loss: Loss, text: impl FnOnce() -> String) {
        if rule.counts(loss) {
            self.holds = true;
            self.loss.get_or_insert_with(text);
        }
    }

    /// A contact does not have a number that the rule asks for.
    fn unmeasured(&mut self, rule: &Rule, reported: &Reported<'_>, what: &str) {
        if rule.counts(Loss::Unmeasured) {
            self.act(|| format!("a contact on {} has no {what}", reported.place()));
        }
    }

    fn act(&mut self, text: impl FnOnce() -> String) {
        self.holds = true;
        self.touch.get_or_insert_with(text);
    }

    fn contact(&mut self, rule: &Rule, reported: &Reported<'_>) {
        self.touched = true;
        let force = force_of(reported.contact, rule.sigmas);
        let pressure = rule.peak_over_mean * mean_pressure(force, reported.contact);
        if let Some(threshold) = rule.force {
            self.value(rule, reported, "force", known(force, reported, threshold.above), threshold, 1.0, "N");
        }
        if let Some(threshold) = rule.pressure {
            self.value(rule, reported, "pressure", pressure, threshold, PASCALS_PER_N_PER_CM2, "N/cm²");
        }
        if let Some(threshold) = rule.speed {
            self.value(rule, reported, "sliding speed", reported.speed, threshold, 1.0, "m/s");
        }
        if let Some(least) = rule.slip {
            self.slip(rule, reported, least);
        }
        if let Some(limits) = &rule.limits {
            self.limited(rule, reported, limits, (force, pressure));
        }
    }

    #[expect(clippy::too_many_arguments, reason = "a value, what it is called, and what it is compared with")]
    fn value(
        &mut self,
        rule: &Rule,
        reported: &Reported<'_>,
        what: &str,
        value: f64,
        threshold: Threshold,
        unit: f64,
        symbol: &str,
    ) {
        match compare(value, threshold) {
            Compared::Below => {}
            Compared::Holds => self.holds = true,
            Compared::Acts => self.act(|| {
                let (value, above) = (short(value / unit), short(threshold.above / unit));
                format!("a {what} of {value} {symbol} on {} is above {above} {symbol}", reported.place())
            }),
            Compared::Unknown => self.unmeasured(rule, reported, what),
        }
    }

    fn slip(&mut self, rule: &Rule, reported: &Reported<'_>, least: Slip) {
        let slip = match reported.slip {
            BodyContact::SLIP_NONE => return,
            BodyContact::SLIP_INCIPIENT => Slip::Incipient,
            BodyContact::SLIP_GROSS => Slip::Gross,
            _ => return self.unmeasured(rule, reported, "slip"),
        };
        if slip >= least {
            self.act(|| format!("a contact on {} slips", reported.place()));
        }
    }

    fn limited(
        &mut self,
        rule: &Rule,
        reported: &Reported<'_>,
        limits: &ContactLimits,
        (force, pressure): (f64, f64),
    ) {
        let of = |pair: &LimitPair| {
            [
                ("force", force, pair.force, 1.0, "N"),
                ("pressure", pressure, pair.pressure, PASCALS_PER_N_PER_CM2, "N/cm²"),
            ]
        };
        let name = &limits.name;
        for (what, value, limit, unit, symbol) in of(&limits.transient) {
            if let Some(limit) = limit
                && value > limit
            {
                self.act(|| {
                    let (value, limit) = (short(value / unit), short(limit / unit));
                    format!("a {what} of {value} {symbol} on {} is above {limit} {symbol}, the transient limit of `{name}`", reported.place())
                });
            }
        }
        for (what, value, limit, unit, symbol) in of(&limits.quasi_static) {
            let Some(limit) = limit else { continue };
            let value = if what == "force" { known(value, reported, limit) } else { value };
            match compare(value, Threshold { above: limit, release: limit * limits.release_ratio }) {
                Compared::Below => {}
                Compared::Holds => self.holds = true,
                Compared::Acts => {
                    self.holds = true;
                    self.lasting.get_or_insert_with(|| {
                        let (value, limit) = (short(value / unit), short(limit / unit));
                        format!("a lasting {what} of {value} {symbol} on {} is above {limit} {symbol}, the quasi-static limit of `{name}`", reported.place())
                    });
                }
                Compared::Unknown => self.unmeasured(rule, reported, what),
            }
        }
    }
}

/// Three decimals are enough for a sentence.
fn short(value: f64) -> f64 {
    (value * 1e3).round() / 1e3
}

/// A force, or NaN where the skin's range ends below both the force and the threshold: it may be any larger one.
fn known(force: f64, reported: &Reported<'_>, threshold: f64) -> f64 {
    let end = reported.force_max;
    // A range that ends at 0 was not filled in.
    if end > 0.0 && force >= end && threshold >= end { f64::NAN } else { force }
}

/// \[N\] of a contact, with so many of its standard deviations; NaN where unknown.
fn force_of(contact: &Contact, sigmas: f64) -> f64 {
    if contact.force_components == Contact::FORCE_NONE {
        return f64::NAN;
    }
    let Vector3 { x, y, z } = contact.force;
    let force = (x * x + y * y + z * z).sqrt();
    if sigmas == 0.0 || force.is_nan() {
        return force;
    }
    let c = &contact.force_covariance;
    let f = [x, y, z];
    let sigma = if force > 0.0 {
        let along = |i: usize| (0..3).map(|j| f[i] * c[3 * i + j] * f[j]).sum::<f64>();
        let variance: f64 = (0..3).map(along).sum();
        // Not `max`, which makes 0 of what is not known.
        if variance < 0.0 { 0.0 } else { variance.sqrt() / force }
    } else {
        // Without a direction, the variance of all three is the bound.
        (c[0] + c[4] + c[8]).sqrt()
    };
    force + sigmas * sigma
}

/// \[Pa\] of a force over the disc of the contact's diameter; NaN where one is unknown.
fn mean_pressure(force: f64, contact: &Contact) -> f64 {
    let diameter = f64::from(contact.diameter);
    if diameter > 0.0 { force / (std::f64::consts::FRAC_PI_4 * diameter * diameter) } else { f64::NAN }
}

#[cfg(test)]
mod tests;
