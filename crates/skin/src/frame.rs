//! One reading of every channel.

use crate::{Image, Stamp};

/// What is wrong with one channel of a frame; the bits are those of `TaxelFrame.FLAG_*`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
pub struct ChannelFlags(u8);

impl ChannelFlags {
    /// Healthy.
    pub const OK: Self = Self(0);
    /// No signal: an open circuit, or frozen at its rail since the start.
    pub const DEAD: Self = Self(1);
    /// At the end of its range: the true value lies beyond.
    pub const SATURATED: Self = Self(2);
    /// Has not changed for longer than its noise allows.
    pub const STUCK: Self = Self(4);
    /// The device sent NaN or infinity.
    pub const NOT_FINITE: Self = Self(8);
    /// Switched off by configuration.
    pub const MASKED: Self = Self(16);

    /// Whether nothing is wrong.
    #[must_use]
    pub const fn is_ok(self) -> bool {
        self.0 == 0
    }

    /// Whether all bits of `other` are set.
    #[must_use]
    pub const fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }

    /// Whether the value says nothing: every fault but saturation, whose value is still a bound.
    #[must_use]
    pub const fn is_invalid(self) -> bool {
        self.0 & !Self::SATURATED.0 != 0
    }

    /// The bits as `TaxelFrame.flags` carries them.
    #[must_use]
    pub const fn bits(self) -> u8 {
        self.0
    }
}

impl From<u8> for ChannelFlags {
    fn from(bits: u8) -> Self {
        Self(bits)
    }
}

impl std::ops::BitOr for ChannelFlags {
    type Output = Self;
    fn bitor(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

impl std::ops::BitOrAssign for ChannelFlags {
    fn bitor_assign(&mut self, other: Self) {
        self.0 |= other.0;
    }
}

impl std::fmt::Display for ChannelFlags {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let names = [
            (Self::DEAD, "dead"),
            (Self::SATURATED, "saturated"),
            (Self::STUCK, "stuck"),
            (Self::NOT_FINITE, "not finite"),
            (Self::MASKED, "masked"),
        ];
        let mut first = true;
        for (flag, name) in names {
            if self.contains(flag) {
                if !first {
                    f.write_str(", ")?;
                }
                f.write_str(name)?;
                first = false;
            }
        }
        if first {
            f.write_str("ok")?;
        }
        Ok(())
    }
}

/// One reading of every channel of a skin at one instant.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Frame {
    /// When the readings were acquired \[ns since the Unix epoch\], not when they arrived or left.
    pub stamp: Stamp,
    /// Counts every frame that the device sent; a step larger than one is a loss.
    pub sequence: u64,
    /// Device clock \[µs\] as sent, 0 where the device has none.
    pub device_time_us: u64,
    /// One value a channel, in the unit of the skin description; NaN for an invalid channel, never 0.
    pub values: Vec<f32>,
    /// One entry a channel.
    pub flags: Vec<ChannelFlags>,
    /// Temperature of the skin \[K\], NaN where unknown.
    pub temperature: f32,
    /// The picture that `values` were computed from, where the skin is read by a camera.
    pub image: Option<Image>,
}

impl Frame {
    /// A frame whose channels are all healthy.
    #[must_use]
    pub fn new(stamp: Stamp, sequence: u64, values: Vec<f32>) -> Self {
        let flags = vec![ChannelFlags::OK; values.len()];
        Self { stamp, sequence, device_time_us: 0, values, flags, temperature: f32::NAN, image: None }
    }

    /// Number of channels that can be used: finite, and not dead, stuck, masked or saturated.
    #[must_use]
    pub fn healthy_channels(&self) -> usize {
        self.values.iter().zip(&self.flags).filter(|(v, f)| v.is_finite() && f.is_ok()).count()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flags_read_as_words() {
        assert_eq!(ChannelFlags::OK.to_string(), "ok");
        assert_eq!((ChannelFlags::DEAD | ChannelFlags::STUCK).to_string(), "dead, stuck");
    }

    #[test]
    fn invalid_channels_do_not_count_as_healthy() {
        let mut frame = Frame::new(0, 0, vec![1.0, f32::NAN, 3.0]);
        frame.flags[2] |= ChannelFlags::SATURATED;
        assert_eq!(frame.healthy_channels(), 1);
    }
}
