//! How values lie on the native wire.

/// How values lie on the wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u8)]
#[non_exhaustive]
pub enum NativeFormat {
    /// IEEE 754 single precision, in the unit of the skin description; NaN is an invalid channel.
    F32 = 0,
    /// Signed 16-bit raw counts.
    I16 = 1,
    /// Unsigned 16-bit raw counts.
    U16 = 2,
    /// Signed 32-bit raw counts.
    I32 = 3,
    /// Unsigned 12-bit raw counts, two in three bytes.
    U12 = 4,
}

impl NativeFormat {
    /// Every format.
    pub const ALL: [Self; 5] = [Self::F32, Self::I16, Self::U16, Self::I32, Self::U12];

    /// As skin files call it.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::F32 => "f32",
            Self::I16 => "i16",
            Self::U16 => "u16",
            Self::I32 => "i32",
            Self::U12 => "u12",
        }
    }

    /// Bits of one value.
    #[must_use]
    pub fn bits(self) -> usize {
        match self {
            Self::F32 | Self::I32 => 32,
            Self::I16 | Self::U16 => 16,
            Self::U12 => 12,
        }
    }

    /// \[bytes\] of so many values.
    #[must_use]
    pub fn payload_len(self, values: usize) -> usize {
        (values * self.bits()).div_ceil(8)
    }

    /// How many values lie in so many bytes; `None` where no number of them does.
    pub(super) fn values_in(self, bytes: usize) -> Option<usize> {
        let values = bytes * 8 / self.bits();
        (values > 0 && self.payload_len(values) == bytes).then_some(values)
    }

    /// The format of this number.
    pub(super) fn from_wire(byte: u8) -> Option<Self> {
        Self::ALL.into_iter().find(|f| *f as u8 == byte)
    }

    /// Appends values as they lie on the wire.
    pub(super) fn write(self, values: &[f32], raw: &mut Vec<u8>) {
        // `as` from float to integer saturates, which is the clamp that the encoder's doc promises.
        match self {
            Self::F32 => values.iter().for_each(|v| raw.extend_from_slice(&v.to_le_bytes())),
            Self::I16 => values.iter().for_each(|v| {
                let count = if v.is_nan() { i16::MIN } else { v.round() as i16 };
                raw.extend_from_slice(&count.to_le_bytes());
            }),
            Self::U16 => values.iter().for_each(|v| raw.extend_from_slice(&(v.round() as u16).to_le_bytes())),
            Self::I32 => values.iter().for_each(|v| {
                let count = if v.is_nan() { i32::MIN } else { v.round() as i32 };
                raw.extend_from_slice(&count.to_le_bytes());
            }),
            Self::U12 => values.chunks(2).for_each(|pair| {
                let count = |i: usize| pair.get(i).map_or(0, |v| (v.round() as u16).min(0xfff));
                let both = u32::from(count(0)) | u32::from(count(1)) << 12;
                raw.extend_from_slice(&both.to_le_bytes()[..self.payload_len(pair.len())]);
            }),
        }
    }

    /// Values as they lie on the wire; the payload has the length of so many.
    pub(super) fn read(self, payload: &[u8]) -> Vec<f32> {
        match self {
            Self::F32 => chunks(payload, f32::from_le_bytes),
            Self::I16 => chunks(payload, |b| f32::from(i16::from_le_bytes(b))),
            Self::U16 => chunks(payload, |b| f32::from(u16::from_le_bytes(b))),
            Self::I32 => chunks(payload, |b| i32::from_le_bytes(b) as f32),
            Self::U12 => payload
                .chunks(3)
                .flat_map(|bytes| {
                    let mut both = [0; 4];
                    both[..bytes.len()].copy_from_slice(bytes);
                    let both = u32::from_le_bytes(both);
                    let counts = [both & 0xfff, both >> 12 & 0xfff];
                    // Two bytes at the end hold one value.
                    counts.into_iter().take(if bytes.len() == 3 { 2 } else { 1 })
                })
                .map(|count| count as f32)
                .collect(),
        }
    }
}

fn chunks<const N: usize>(payload: &[u8], value: impl Fn([u8; N]) -> f32) -> Vec<f32> {
    payload.as_chunks::<N>().0.iter().map(|b| value(*b)).collect()
}
