//! What the contact arrays of one skin say while they come: the last one, how many, how fast and how late.

use std::collections::VecDeque;

use dermis_msgs::geometry_msgs::msg::Vector3;
use dermis_msgs::msg::{Contact, ContactArray};

use crate::stats::Samples;

/// \[ns\] over which the recent rate is counted.
const RATE_OVER: i64 = 3_000_000_000;
/// Latencies that are kept: those of the last ten seconds of a fast skin, or of a hundred of a usual one.
const LATENCIES: usize = 10_000;

/// What came from one skin.
#[derive(Debug)]
pub struct Touch {
    name: String,
    /// Contact arrays that came.
    pub arrays: u64,
    /// Those with a contact.
    pub touched: u64,
    /// Arrays by status.
    pub statuses: [u64; 5],
    /// From acquisition to arrival here; the last ten thousand.
    pub latency_ms: Samples,
    /// The last one.
    pub latest: Option<ContactArray>,
    first_ns: i64,
    last_ns: i64,
    recent: VecDeque<i64>,
}

impl Touch {
    /// Nothing yet of the skin of this name.
    #[must_use]
    pub fn new(name: impl Into<String>) -> Self {
        Self {
            name: name.into(),
            arrays: 0,
            touched: 0,
            statuses: [0; 5],
            latency_ms: Samples::last(LATENCIES),
            latest: None,
            first_ns: 0,
            last_ns: 0,
            recent: VecDeque::new(),
        }
    }

    /// What it is called.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Calls it by another name.
    pub fn rename(&mut self, name: String) {
        self.name = name;
    }

    /// Takes what came at a time [ns since the Unix epoch].
    pub fn take(&mut self, array: ContactArray, received_ns: i64) {
        if self.arrays == 0 {
            self.first_ns = received_ns;
        }
        self.arrays += 1;
        self.last_ns = received_ns;
        self.recent.push_back(received_ns);
        while self.recent.front().is_some_and(|at| received_ns.saturating_sub(*at) > RATE_OVER) {
            self.recent.pop_front();
        }
        self.latency_ms.push(received_ns.saturating_sub(array.header.stamp.as_nanos()) as f64 * 1e-6);
        self.touched += u64::from(!array.contacts.is_empty());
        if let Some(count) = self.statuses.get_mut(usize::from(array.status)) {
            *count += 1;
        }
        self.latest = Some(array);
    }

    /// \[1/s\] from the first array to the last.
    #[must_use]
    pub fn rate(&self) -> f64 {
        rate(self.arrays, self.first_ns, self.last_ns)
    }

    /// \[1/s\] over the last seconds.
    #[must_use]
    pub fn recent_rate(&self) -> f64 {
        let (Some(first), Some(last)) = (self.recent.front(), self.recent.back()) else { return 0.0 };
        rate(self.recent.len() as u64, *first, *last)
    }

    /// \[s\] since the last array.
    #[must_use]
    pub fn silent(&self, now_ns: i64) -> f64 {
        now_ns.saturating_sub(self.last_ns) as f64 * 1e-9
    }
}

/// \[N\] with which a contact presses onto the skin.
#[must_use]
pub fn pressing_force(c: &Contact) -> f64 {
    pressing(&c.force, &c.normal)
}

/// \[N\] of a force onto a skin whose normal points out of it.
pub(crate) fn pressing(force: &Vector3, normal: &Vector3) -> f64 {
    -(force.x * normal.x + force.y * normal.y + force.z * normal.z)
}

fn rate(count: u64, first_ns: i64, last_ns: i64) -> f64 {
    let span = last_ns.saturating_sub(first_ns) as f64 * 1e-9;
    if span > 0.0 { count.saturating_sub(1) as f64 / span } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dermis_msgs::builtin_interfaces::msg::Time;
    use dermis_msgs::std_msgs::msg::Header;

    const SECOND: i64 = 1_000_000_000;

    fn array(at_ns: i64) -> ContactArray {
        let header = Header { stamp: Time::from_nanos(at_ns - 500_000), frame_id: "palm".to_owned() };
        ContactArray { header, skin: "palm".to_owned(), ..ContactArray::default() }
    }

    #[test]
    fn the_recent_rate_is_that_of_the_last_seconds() {
        let mut skin = Touch::new("palm");
        for k in 0..=200 {
            skin.take(array(k * SECOND / 100), k * SECOND / 100);
        }
        for k in 1..=40 {
            skin.take(array(2 * SECOND + k * SECOND / 10), 2 * SECOND + k * SECOND / 10);
        }
        assert!((skin.recent_rate() - 10.0).abs() < 0.1, "{}", skin.recent_rate());
        assert!((skin.rate() - 40.0).abs() < 0.1, "{}", skin.rate());
    }
}
