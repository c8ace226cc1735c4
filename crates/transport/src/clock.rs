//! From device time to host time.
//!
//! A frame is measured, sent, and read some time later; messages shall carry the time of the first. The device says
//! when that was on its own clock, and the host knows when it read the frame: `received = measured + delay`, where the
//! delay has a floor and is often far above it. The lower envelope of `received − device` over a window is the offset
//! between the clocks plus that floor. It is fitted by the straight line that lies below every point and closest to
//! them in the mean (S. B. Moon, P. Skelly, D. Towsley, "Estimation and removal of clock skew from network delay
//! measurements", INFOCOM 1999), which also gives the drift between the clocks.

use std::collections::VecDeque;

use serde::Serialize;

/// \[ns\] device time that one point of the envelope stands for.
const BUCKET_NS: i64 = 500_000_000;
/// Points of the envelope: half a minute.
const BUCKETS: usize = 60;
/// Points before the drift is fitted; with fewer the offset alone is.
const BUCKETS_FOR_DRIFT: usize = 6;
/// Largest drift that is believed: 2 %, an RC oscillator. Beyond, the device does not count microseconds.
const MAX_DRIFT: f64 = 0.02;
/// \[ns\] step of one clock against the other that cannot be drift.
const JUMP_NS: i64 = 500_000_000;
/// \[ns\] host time for which frames must come late before that is a jump and not a stall.
const JUMP_CONFIRM_NS: i64 = 1_000_000_000;
/// \[ns\] host time over which the rate of the device clock is judged.
const RATE_SPAN_NS: i64 = 2_000_000_000;
/// Frames with the same device time before the clock is taken to stand still.
const FROZEN_FRAMES: u32 = 4;

/// Where the stamps of a [`DeviceClock`] come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum ClockState {
    /// No frame yet.
    #[default]
    Empty,
    /// Device time, mapped to host time.
    Device,
    /// Receive time: the frames carry no device time.
    NoDeviceTime,
    /// Receive time: the device time does not advance.
    Frozen,
    /// Receive time: the device time runs at another rate than microseconds do.
    WrongRate,
}

/// Maps device time to host time, frame by frame.
///
/// A stamp is never later than the frame was received, never earlier than the stamp before (unless the host clock was
/// set back), and later than the true time of measurement by no more than about the shortest delay of the link in the
/// last half minute, plus what a drift of the clocks makes of a few seconds at the start. Frames must be given in the
/// order in which they were received.
#[derive(Debug, Clone, Default)]
pub struct DeviceClock {
    /// Lowest point of each stretch of time: (device time \[ns\], received − device \[ns\]).
    envelope: VecDeque<(i64, i64)>,
    /// Start of the stretch that the last point stands for \[ns\].
    bucket_start: i64,
    /// Offset \[ns\] at the device time `.0` \[ns\], and its slope.
    line: (i64, f64, f64),
    last: Option<Last>,
    /// Where the rate is measured from: (device time, receive time) \[ns\].
    rate_from: (i64, i64),
    wrong_rate: bool,
    /// (Device time, receive time) \[ns\] since which every frame came late by more than a jump.
    late_since: Option<(i64, i64)>,
    /// Receive time \[ns\] of the latest jump of the device clock ahead.
    ahead_at: Option<i64>,
    same: u32,
    resets: u64,
    state: ClockState,
}

#[derive(Debug, Clone, Copy)]
struct Last {
    device: i64,
    received: i64,
    stamp: i64,
}

impl DeviceClock {
    /// A clock that has seen nothing.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// When a frame was measured \[ns since the Unix epoch, host clock\].
    ///
    /// `device_time_us` is the frame's own time \[µs\], `received_ns` when it was read \[ns since the Unix epoch\].
    /// Without a usable device time the answer is `received_ns`.
    pub fn stamp(&mut self, device_time_us: Option<u64>, received_ns: i64) -> i64 {
        let device = device_time_us.and_then(|us| i64::try_from(us).ok()?.checked_mul(1000));
        let Some(device) = device else {
            self.state = ClockState::NoDeviceTime;
            return self.received(received_ns);
        };
        let Some(last) = self.last else {
            self.reset(device, received_ns);
            return self.finish(device, received_ns, received_ns);
        };
        if device == last.device {
            self.same = self.same.saturating_add(1);
        } else {
            self.same = 0;
        }
        if device < last.device || received_ns.saturating_add(JUMP_NS) < last.received {
            self.restart(device, received_ns);
            return self.finish(device, received_ns, received_ns);
        }
        let offset = received_ns.saturating_sub(device);
        let late = offset.saturating_sub(self.offset_at(device));
        if late < -JUMP_NS {
            // Once is a jump; again and again is a clock that runs too fast.
            let before = self.ahead_at.replace(received_ns);
            self.wrong_rate |= before.is_some_and(|at| received_ns.saturating_sub(at) < RATE_SPAN_NS);
            self.restart(device, received_ns);
        } else if late > JUMP_NS {
            let (device_then, received_then) = *self.late_since.get_or_insert((device, received_ns));
            let host = received_ns.saturating_sub(received_then);
            if host >= JUMP_CONFIRM_NS {
                // After a jump both clocks run alike again; a clock that runs too slow falls further behind.
                let passed = device.saturating_sub(device_then);
                self.wrong_rate = (passed as f64 / host as f64) < 0.9;
                self.restart(device, received_ns);
            }
        } else {
            self.late_since = None;
            self.judge_rate(device, received_ns);
            self.observe(device, offset);
        }
        let mapped = device.saturating_add(self.offset_at(device));
        self.finish(device, received_ns, mapped)
    }

    /// Where the latest stamp came from.
    #[must_use]
    pub fn state(&self) -> ClockState {
        self.state
    }

    /// Times that the clocks jumped against each other: the device started again, or the host clock was set.
    #[must_use]
    pub fn resets(&self) -> u64 {
        self.resets
    }

    /// \[1\] by how much the device clock runs slow against the host clock (5e-5 is 50 ppm), 0 until it is known.
    #[must_use]
    pub fn drift(&self) -> f64 {
        self.line.2
    }

    fn finish(&mut self, device: i64, received: i64, mapped: i64) -> i64 {
        self.state = if self.same >= FROZEN_FRAMES {
            ClockState::Frozen
        } else if self.wrong_rate {
            ClockState::WrongRate
        } else {
            ClockState::Device
        };
        let stamp = if self.state == ClockState::Device { mapped } else { received };
        // Never before the previous stamp, unless the host clock itself was set back.
        let floor = self.last.map_or(i64::MIN, |last| last.stamp).min(received);
        let stamp = stamp.clamp(floor, received);
        self.last = Some(Last { device, received, stamp });
        stamp
    }

    fn received(&mut self, received_ns: i64) -> i64 {
        if let Some(last) = &mut self.last {
            last.stamp = last.stamp.max(received_ns);
        }
        received_ns
    }

    fn restart(&mut self, device: i64, received_ns: i64) {
        self.resets += 1;
        self.reset(device, received_ns);
    }

    fn reset(&mut self, device: i64, received_ns: i64) {
        let offset = received_ns.saturating_sub(device);
        self.envelope.clear();
        self.envelope.push_back((device, offset));
        self.bucket_start = device;
        self.line = (device, offset as f64, 0.0);
        self.rate_from = (device, received_ns);
        self.late_since = None;
        self.same = 0;
    }

    /// The device counts microseconds if its time and the host's pass at about the same rate.
    fn judge_rate(&mut self, device: i64, received_ns: i64) {
        let host = received_ns.saturating_sub(self.rate_from.1);
        if host < RATE_SPAN_NS {
            return;
        }
        let passed = device.saturating_sub(self.rate_from.0);
        let off = (passed as f64 / host as f64 - 1.0).abs();
        // A stall or a burst at one end of the span shifts it by at most what a jump is.
        self.wrong_rate = off > MAX_DRIFT + JUMP_NS as f64 / host as f64;
        self.rate_from = (device, received_ns);
    }

    fn offset_at(&self, device: i64) -> i64 {
        let (at, offset, slope) = self.line;
        (offset + slope * (device.saturating_sub(at)) as f64).round() as i64
    }

    fn observe(&mut self, device: i64, offset: i64) {
        let fresh = device.saturating_sub(self.bucket_start) >= BUCKET_NS;
        if fresh {
            self.bucket_start = device;
            self.envelope.push_back((device, offset));
            if self.envelope.len() > BUCKETS {
                self.envelope.pop_front();
            }
            self.fit();
        } else if let Some(point) = self.envelope.back_mut()
            && offset < point.1
        {
            *point = (device, offset);
            if offset < self.offset_at(device) {
                self.fit();
            }
        }
    }

    /// The line below all points that is closest to them: the edge of their lower hull over their mean time.
    fn fit(&mut self) {
        let Some(&(origin, base)) = self.envelope.front() else { return };
        // Relative to the first point, so that nanoseconds since 1970 keep their digits in an f64.
        let points = self.envelope.iter().map(|(t, o)| ((t - origin) as f64, o.saturating_sub(base) as f64));
        if self.envelope.len() < BUCKETS_FOR_DRIFT {
            let lowest = points.map(|(_, o)| o).fold(f64::INFINITY, f64::min);
            self.line = (origin, base as f64 + lowest, 0.0);
            return;
        }
        let mut hull: Vec<(f64, f64)> = Vec::with_capacity(self.envelope.len());
        let mut sum = 0.0;
        for (t, o) in points {
            sum += t;
            while let [.., a, b] = hull[..]
                && (b.1 - a.1) * (t - a.0) >= (o - a.1) * (b.0 - a.0)
            {
                hull.pop();
            }
            hull.push((t, o));
        }
        let mean = sum / self.envelope.len() as f64;
        let after = hull.iter().position(|p| p.0 >= mean).unwrap_or(hull.len() - 1).max(1);
        let (a, b) = (hull[after - 1], hull[after]);
        let slope = ((b.1 - a.1) / (b.0 - a.0)).clamp(-MAX_DRIFT, MAX_DRIFT);
        // Through whichever point of the hull keeps the line below all of them, also where the slope was clamped.
        let offset = hull.iter().map(|(t, o)| o - slope * t).fold(f64::INFINITY, f64::min);
        self.line = (origin, base as f64 + offset, slope);
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const START: i64 = 1_700_000_000_000_000_000;
    const MS: i64 = 1_000_000;

    /// A device whose clock drifts, behind a link with a floor and a tail of delay.
    struct Link {
        period_ns: i64,
        drift: f64,
        floor_ns: i64,
        tail_ns: i64,
        random: u64,
    }

    impl Link {
        fn random(&mut self) -> f64 {
            self.random =
                self.random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (self.random >> 40) as f64 / f64::from(1u32 << 24)
        }

        /// (device time µs, received ns, true time ns) of each frame; frames arrive in order.
        fn frames(&mut self, n: i64) -> Vec<(u64, i64, i64)> {
            let mut last = 0;
            (0..n)
                .map(|i| {
                    let truth = START + i * self.period_ns;
                    let device = 5e9 + (truth - START) as f64 * (1.0 - self.drift);
                    // Mostly near the floor, sometimes far above it.
                    let tail = (self.random().powi(4) * self.tail_ns as f64) as i64;
                    let received = (truth + self.floor_ns + tail).max(last + 1000);
                    last = received;
                    ((device / 1000.0) as u64, received, truth)
                })
                .collect()
        }
    }

    #[test]
    fn stamps_hold_still_where_arrival_jitters() {
        let mut link = Link { period_ns: 10 * MS, drift: 40e-6, floor_ns: MS, tail_ns: 20 * MS, random: 7 };
        let mut clock = DeviceClock::new();
        let mut worst = 0;
        for (i, (device, received, truth)) in link.frames(6000).into_iter().enumerate() {
            let error = clock.stamp(Some(device), received) - truth - MS;
            if i > 500 {
                worst = worst.max(error.abs());
            }
        }
        assert!(worst < MS / 2, "{worst} ns of jitter are left of 20 ms");
        assert!((clock.drift() - 40e-6).abs() < 15e-6, "drift {}", clock.drift());
        assert_eq!((clock.state(), clock.resets()), (ClockState::Device, 0));
    }

    #[test]
    fn a_restarted_device_is_followed_at_once() {
        let mut link = Link { period_ns: 10 * MS, drift: 0.0, floor_ns: MS, tail_ns: 0, random: 1 };
        let frames = link.frames(1000);
        let mut clock = DeviceClock::new();
        for (device, received, _) in &frames {
            clock.stamp(Some(*device), *received);
        }
        let pause = 30_000 * MS;
        for (i, (_, received, truth)) in frames.iter().enumerate() {
            let stamp = clock.stamp(Some(1 + i as u64 * 10_000), received + pause);
            assert!((stamp - truth - pause).abs() <= MS, "frame {i}");
        }
        assert_eq!(clock.resets(), 1);
    }

    #[test]
    fn a_stall_of_the_link_does_not_move_the_stamps() {
        let mut clock = DeviceClock::new();
        for i in 0..400i64 {
            // From frame 200 on 40 frames are held up and arrive together.
            let truth = START + i * 10 * MS;
            let received = if (200..240).contains(&i) { START + 2400 * MS } else { truth } + MS;
            let stamp = clock.stamp(Some((i as u64 + 1) * 10_000), received);
            assert!((stamp - truth - MS).abs() < MS / 10, "frame {i}: {} ns off", stamp - truth - MS);
        }
        assert_eq!(clock.resets(), 0);
    }

    #[test]
    fn whatever_the_fit_does_stamps_do_not_run_back() {
        let mut clock = DeviceClock::new();
        let mut last = i64::MIN;
        for i in 0..100i64 {
            // The line is bent by more than a period, down and up.
            clock.line.1 += if i % 10 == 5 { -30e6 } else { 3e6 };
            let stamp = clock.stamp(Some((i as u64 + 1) * 10_000), START + i * 10 * MS);
            assert!(stamp >= last && stamp <= START + i * 10 * MS);
            last = stamp;
        }
    }

    #[test]
    fn a_set_host_clock_is_followed() {
        for step in [-7_200_000 * MS, -700 * MS, 700 * MS, 7_200_000 * MS] {
            let mut clock = DeviceClock::new();
            let mut stamp = 0;
            let mut received = 0;
            for i in 0..600i64 {
                received = START + i * 10 * MS + if i >= 200 { step } else { 0 };
                stamp = clock.stamp(Some((i as u64 + 1) * 10_000), received);
                assert!(stamp <= received);
            }
            assert!((stamp - received).abs() <= MS, "step {step}: {} off", stamp - received);
            assert!(clock.resets() >= 1, "step {step}");
        }
    }

    #[test]
    fn a_device_clock_that_wraps_or_is_set_is_followed() {
        // Microseconds in 32 bits, microseconds up to the end of 64 bits, and a device whose clock is set ahead and back.
        fn set(i: u64) -> u64 {
            5_000_000_000 + i * 10_000 + if (200..300).contains(&i) { 3_600_000_000 } else { 0 }
        }
        type DeviceTime = fn(u64) -> u64;
        let clocks: [(&str, DeviceTime); 3] = [
            ("32 bits", |i| ((1 << 32) - 2_000_000 + i * 10_000) & u64::from(u32::MAX)),
            ("64 bits", |i| (u64::MAX - 2_000_000).wrapping_add(i * 10_000)),
            ("set", set),
        ];
        for (name, device) in clocks {
            let mut clock = DeviceClock::new();
            let mut last = i64::MIN;
            for i in 0..500 {
                let received = START + i * 10 * MS + MS;
                let stamp = clock.stamp(Some(device(i as u64)), received);
                assert!(
                    stamp <= received && received - stamp <= 2 * MS,
                    "{name}: frame {i} is {} ns off",
                    received - stamp
                );
                assert!(stamp >= last, "{name}: frame {i}");
                last = stamp;
            }
            assert_eq!(clock.state(), ClockState::Device, "{name}");
        }
    }

    #[test]
    fn without_a_usable_clock_stamps_are_receive_times() {
        let mut clock = DeviceClock::new();
        assert_eq!(clock.stamp(None, START), START);
        assert_eq!(clock.state(), ClockState::NoDeviceTime);

        let mut frozen = DeviceClock::new();
        let mut milliseconds = DeviceClock::new();
        for i in 0..1000i64 {
            let received = START + i * 10 * MS;
            let from_frozen = frozen.stamp(Some(123), received);
            let from_ms = milliseconds.stamp(Some(1 + i as u64 * 10), received);
            if i > 400 {
                assert_eq!(from_frozen, received);
                assert_eq!(from_ms, received);
            }
        }
        assert_eq!(frozen.state(), ClockState::Frozen);
        assert_eq!(milliseconds.state(), ClockState::WrongRate);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn error_is_the_shortest_delay_and_time_never_runs_back(
            period_us in 1_000i64..50_000,
            drift_ppm in -200i64..=200,
            floor_us in 0i64..5_000,
            tail_us in 0i64..30_000,
            random: u64,
        ) {
            let mut link = Link {
                period_ns: period_us * 1000,
                drift: drift_ppm as f64 * 1e-6,
                floor_ns: floor_us * 1000,
                tail_ns: tail_us * 1000,
                random,
            };
            let mut clock = DeviceClock::new();
            let mut last = i64::MIN;
            let mut lowest = i64::MAX;
            for (device, received, truth) in link.frames(3000) {
                let stamp = clock.stamp(Some(device), received);
                prop_assert!(stamp >= last && stamp <= received);
                last = stamp;
                lowest = lowest.min(received - truth);
                // Drift of the first seconds, before it is known, and what the tail bends the line by.
                let slack = 200_000 * 6 + tail_us * 1000 / 4 + 2000;
                prop_assert!(stamp - truth <= lowest + slack, "{} ns late", stamp - truth - lowest);
                prop_assert!(stamp - truth >= -slack, "{} ns early", truth - stamp);
            }
            prop_assert_eq!(clock.resets(), 0);
        }

        #[test]
        fn no_times_panic(frames in proptest::collection::vec((proptest::option::of(any::<u64>()), any::<i64>()), 0..50)) {
            let mut clock = DeviceClock::new();
            for (device, received) in frames {
                prop_assert!(clock.stamp(device, received) <= received);
            }
        }
    }
}
