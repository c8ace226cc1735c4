//! Whose bytes are read where more than one device sends to one port.
//!
//! Frames of two devices, mixed, are contacts that nobody made. So a port belongs to one device: the first that sends
//! keeps it while it sends, and what others send is left out, counted and named. Once it has been silent for a while
//! (`hold`), the next one that sends gets the port.

use std::net::{IpAddr, SocketAddr};
use std::time::{Duration, Instant};

use crate::Sender;

/// Shortest time between two sentences on what is left out.
const NOTICE_PERIOD: Duration = Duration::from_secs(10);

/// When to say that something was left out, and how often it was since that was last said.
#[derive(Debug, Default)]
pub(super) struct Notices {
    at: Option<Instant>,
    unreported: u64,
}

impl Notices {
    /// Counts one; the end of its sentence where it is time for one.
    pub(super) fn count(&mut self, now: Instant) -> Option<String> {
        if self.at.is_some_and(|at| now.saturating_duration_since(at) < NOTICE_PERIOD) {
            self.unreported += 1;
            return None;
        }
        self.at = Some(now);
        Some(match std::mem::take(&mut self.unreported) {
            0 => String::new(),
            more => format!(" ({more} more were left out since this was last said)"),
        })
    }
}

/// What becomes of a datagram.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Verdict {
    /// It is read. The first of a device comes with its address.
    Read(Option<SocketAddr>),
    /// It is read, from now on this device is; why.
    ReadInstead(SocketAddr, String),
    /// It is left out; with a sentence where it is time for one.
    LeaveOut(Option<String>),
    /// It comes from an address that was not configured.
    Unrequested,
}

/// Decides on datagrams by their sender.
#[derive(Debug)]
pub(super) struct Senders {
    rule: Sender,
    hold: Duration,
    from: Option<IpAddr>,
    current: Option<(SocketAddr, Instant)>,
    notices: Notices,
}

impl Senders {
    pub(super) fn new(rule: Sender, hold: Duration, from: Option<IpAddr>) -> Self {
        Self { rule, hold, from, current: None, notices: Notices::default() }
    }

    /// The device that is read.
    pub(super) fn read(&self) -> Option<SocketAddr> {
        self.current.map(|(address, _)| address)
    }

    /// Decides on a datagram that came `now`.
    pub(super) fn classify(&mut self, sender: SocketAddr, now: Instant) -> Verdict {
        let host = sender.ip().to_canonical();
        if self.from.is_some_and(|from| from != host) {
            return Verdict::Unrequested;
        }
        let Some((current, last)) = self.current.as_mut() else {
            self.current = Some((sender, now));
            return Verdict::Read(Some(sender));
        };
        let same = match self.rule {
            Sender::One => *current == sender,
            Sender::Host => current.ip() == sender.ip(),
            Sender::Any => true,
        };
        if same {
            *last = now;
            return Verdict::Read(None);
        }
        let silent = now.saturating_duration_since(*last);
        if silent >= self.hold {
            let why = format!(
                "{sender} is read from now on: {current}, which was read, is silent for {:.1} s",
                silent.as_secs_f64()
            );
            self.current = Some((sender, now));
            return Verdict::ReadInstead(sender, why);
        }
        let current = *current;
        let more = self.notices.count(now);
        Verdict::LeaveOut(more.map(|more| {
            let way_out = if current.ip() == sender.ip() {
                "give each device a port of its own, or write sender=host where one device sends from several ports"
                    .to_owned()
            } else {
                format!("give each device a port of its own, or name the one that is meant with from={}", current.ip())
            };
            format!("datagrams of {sender} are left out, because {current} sends to the same port: {way_out}{more}")
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn address(text: &str) -> SocketAddr {
        text.parse().unwrap()
    }

    #[test]
    fn the_first_is_read_while_it_sends_and_the_other_is_named_seldom() {
        let (a, b) = (address("10.0.0.2:5000"), address("10.0.0.3:6000"));
        let mut senders = Senders::new(Sender::One, Duration::from_secs(1), None);
        let start = Instant::now();
        let at = |ms: u64| start + Duration::from_millis(ms);
        assert_eq!(senders.classify(a, at(0)), Verdict::Read(Some(a)));
        let mut texts = Vec::new();
        for i in 1..1500 {
            assert_eq!(senders.classify(a, at(10 * i)), Verdict::Read(None));
            match senders.classify(b, at(10 * i + 5)) {
                Verdict::LeaveOut(notice) => texts.extend(notice),
                other => panic!("{other:?}"),
            }
        }
        insta::assert_snapshot!(texts.join("\n"), @r"
        datagrams of 10.0.0.3:6000 are left out, because 10.0.0.2:5000 sends to the same port: give each device a port of its own, or name the one that is meant with from=10.0.0.2
        datagrams of 10.0.0.3:6000 are left out, because 10.0.0.2:5000 sends to the same port: give each device a port of its own, or name the one that is meant with from=10.0.0.2 (999 more were left out since this was last said)
        ");
        // The first one falls silent.
        assert!(matches!(senders.classify(b, at(15_500)), Verdict::LeaveOut(None)));
        let Verdict::ReadInstead(who, why) = senders.classify(b, at(16_000)) else {
            panic!("it has to give way")
        };
        insta::assert_snapshot!(why, @"10.0.0.3:6000 is read from now on: 10.0.0.2:5000, which was read, is silent for 1.0 s");
        assert_eq!(who, b);
        assert!(
            matches!(senders.classify(a, at(16_001)), Verdict::LeaveOut(None)),
            "no interleaving either way"
        );
    }

    #[test]
    fn what_is_one_sender_can_be_said() {
        let (a, b, c) = (address("10.0.0.2:1"), address("10.0.0.2:2"), address("10.0.0.3:1"));
        let now = Instant::now();
        for (rule, reads) in
            [(Sender::One, [false, false]), (Sender::Host, [true, false]), (Sender::Any, [true, true])]
        {
            let mut senders = Senders::new(rule, Duration::from_secs(1), None);
            senders.classify(a, now);
            let read = [b, c].map(|other| senders.classify(other, now) == Verdict::Read(None));
            assert_eq!(read, reads, "{rule:?}");
        }
        let mut senders =
            Senders::new(Sender::One, Duration::from_secs(1), Some("10.0.0.3".parse().unwrap()));
        assert_eq!(senders.classify(a, now), Verdict::Unrequested);
        assert_eq!(
            senders.classify(address("[::ffff:10.0.0.3]:9"), now),
            Verdict::Read(Some(address("[::ffff:10.0.0.3]:9")))
        );
    }
}
