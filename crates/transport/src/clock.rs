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
    /// Receive time \[ns\] since which every frame came late by more than a jump.
    late_since: Option<i64>,
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
        self.judge_rate(device, received_ns);

        let offset = received_ns.saturating_sub(device);
        let late = offset.saturating_sub(self.offset_at(device));
        if late < -JUMP_NS {
            self.restart(device, received_ns);
        } else if late > JUMP_NS {
            let since = *self.late_since.get_or_insert(received_ns);
            if received_ns - since >= JUMP_CONFIRM_NS {
                self.restart(device, received_ns);
            }
        } else {
            self.late_since = None;
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
