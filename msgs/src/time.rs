//! ROS 2 writes a time as seconds in 32 bits and nanoseconds; programs count nanoseconds in 64 bits. This
//! converts one to the other and saturates.

use crate::builtin_interfaces::msg::{Duration, Time};
use crate::std_msgs::msg::Header;

const NANOS_PER_SECOND: i64 = 1_000_000_000;

/// Seconds, rounded down, and the nanoseconds that are left. Saturates where seconds leave 32 bits (1901 to 2038 for
/// times since 1970).
fn split(nanos: i64) -> (i32, u32) {
    match i32::try_from(nanos.div_euclid(NANOS_PER_SECOND)) {
        // The remainder is below 10^9.
        Ok(sec) => (sec, nanos.rem_euclid(NANOS_PER_SECOND) as u32),
        Err(_) if nanos < 0 => (i32::MIN, 0),
        Err(_) => (i32::MAX, 999_999_999),
    }
}

impl Time {
    /// Nanoseconds since the epoch of the clock it was taken from, 1970-01-01 for the system's. Saturates where
    /// the seconds leave 32 bits.
    pub fn from_nanos(nanos: i64) -> Self {
        let (sec, nanosec) = split(nanos);
        Self { sec, nanosec }
    }

    /// Nanoseconds since the epoch of the clock it was taken from.
    pub fn as_nanos(&self) -> i64 {
        i64::from(self.sec) * NANOS_PER_SECOND + i64::from(self.nanosec)
    }
}

impl Duration {
    /// From nanoseconds. Saturates where the seconds leave 32 bits.
    pub fn from_nanos(nanos: i64) -> Self {
        let (sec, nanosec) = split(nanos);
        Self { sec, nanosec }
    }

    /// The duration in nanoseconds.
    pub fn as_nanos(&self) -> i64 {
        i64::from(self.sec) * NANOS_PER_SECOND + i64::from(self.nanosec)
    }
}

impl Header {
    /// A header with the time of acquisition, in nanoseconds since 1970-01-01, and the coordinate frame of the data.
    pub fn new(stamp_nanos: i64, frame_id: impl Into<String>) -> Self {
        Self { stamp: Time::from_nanos(stamp_nanos), frame_id: frame_id.into() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn times_before_the_epoch_round_down() {
        assert_eq!(Time::from_nanos(-1), Time { sec: -1, nanosec: 999_999_999 });
        assert_eq!(Time::from_nanos(1_700_000_000_000_000_001), Time { sec: 1_700_000_000, nanosec: 1 });
    }

    #[test]
    fn times_out_of_range_saturate() {
        assert_eq!(Time::from_nanos(i64::MAX), Time { sec: i32::MAX, nanosec: 999_999_999 });
        assert_eq!(Time::from_nanos(i64::MIN), Time { sec: i32::MIN, nanosec: 0 });
    }

    proptest! {
        #[test]
        fn nanoseconds_round_trip(nanos in i64::from(i32::MIN) * NANOS_PER_SECOND..(i64::from(i32::MAX) + 1) * NANOS_PER_SECOND) {
            prop_assert_eq!(Time::from_nanos(nanos).as_nanos(), nanos);
            prop_assert_eq!(Duration::from_nanos(nanos).as_nanos(), nanos);
        }
    }
}
