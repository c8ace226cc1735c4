//! Which channel of a frame is which.
//!
//! Problem: a frame of hundreds of channels must not carry their names, and still nobody may take one channel for another.
//! Method: names and unit are in the latched [`SkinGeometry`], under a checksum that every frame carries. The checksum is
//! CRC-32 (IEEE 802.3, as `zlib.crc32` of Python computes it): it tells every change of one name and every exchange of two
//! from the original with a chance of 1 in 4 billion to miss it, and 32 bits are a number that JSON keeps.
//! It guards against mistakes, not against people who make one layout look like another.
//! Cost: one pass over the names, 1 ns a byte; done once a skin, not once a frame.

use crate::msg::SkinGeometry;

/// Names of a skin's channels in the order of [`TaxelFrame::values`](crate::msg::TaxelFrame), and their unit.
#[derive(Debug, Clone, Default, PartialEq, Eq, serde::Serialize)]
pub struct ChannelLayout {
    /// Unit of every value.
    pub unit: String,
    /// Name of each channel.
    pub channels: Vec<String>,
}

impl ChannelLayout {
    /// What a geometry says of the channels.
    pub fn of(geometry: &SkinGeometry) -> Self {
        Self { unit: geometry.unit.clone(), channels: geometry.channels.clone() }
    }

    /// The number that frames of this layout carry; never 0.
    pub fn id(&self) -> u32 {
        Self::id_of(&self.unit, self.channels.iter().map(String::as_str))
    }

    /// [`id`](Self::id) of names that are elsewhere.
    ///
    /// ```
    /// // zlib.crc32(b"Pa\np0\np1\n") of Python.
    /// assert_eq!(dermis_msgs::ChannelLayout::id_of("Pa", ["p0", "p1"]), 0x9bad_796c);
    /// ```
    pub fn id_of<'a>(unit: &'a str, channels: impl IntoIterator<Item = &'a str>) -> u32 {
        let lines = std::iter::once(unit).chain(channels);
        let bytes = lines.flat_map(|line| line.bytes().chain(std::iter::once(b'\n')));
        let crc = bytes.fold(u32::MAX, |crc, byte| CRC[usize::from(crc as u8 ^ byte)] ^ (crc >> 8));
        (!crc).max(1)
    }
}

/// The remainder of each byte, by the reflected polynomial 0xedb88320.
const CRC: [u32; 256] = {
    let mut table = [0; 256];
    let mut byte = 0;
    while byte < 256 {
        let mut rest = byte as u32;
        let mut bit = 0;
        while bit < 8 {
            rest = if rest & 1 == 1 { 0xedb8_8320 ^ (rest >> 1) } else { rest >> 1 };
            bit += 1;
        }
        table[byte] = rest;
        byte += 1;
    }
    table
};

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_checksum_is_that_of_zlib() {
        // zlib.crc32(b"123456789\n")
        assert_eq!(ChannelLayout::id_of("123456789", []), 0xe011_7757);
    }

    #[test]
    fn every_change_counts() {
        let id = |unit: &str, channels: &[&str]| ChannelLayout::id_of(unit, channels.iter().copied());
        let original = id("Pa", &["p0", "p1", "p2"]);
        for (unit, channels) in [
            ("hPa", vec!["p0", "p1", "p2"]),
            ("Pa", vec!["p1", "p0", "p2"]),
            ("Pa", vec!["p0", "p1"]),
            ("Pa", vec!["p0", "p1p2"]),
            ("Pa", vec!["p0", "p1", "p2", ""]),
            ("", vec!["Pa", "p0", "p1", "p2"]),
        ] {
            assert_ne!(id(unit, &channels), original, "{unit} {channels:?}");
        }
    }
}
