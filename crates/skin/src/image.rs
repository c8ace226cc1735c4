//! A picture that a skin's camera took.

use std::sync::Arc;

/// What the bytes of an [`Image`] are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum PixelFormat {
    /// One byte a pixel: brightness.
    Mono8,
    /// Three bytes a pixel: red, green, blue.
    Rgb8,
}

impl PixelFormat {
    /// Bytes of a pixel.
    #[must_use]
    pub const fn bytes(self) -> usize {
        match self {
            Self::Mono8 => 1,
            Self::Rgb8 => 3,
        }
    }

    /// As `sensor_msgs/Image` calls it.
    #[must_use]
    pub const fn encoding(self) -> &'static str {
        match self {
            Self::Mono8 => "mono8",
            Self::Rgb8 => "rgb8",
        }
    }

    /// What `sensor_msgs/Image` calls so.
    #[must_use]
    pub fn from_encoding(encoding: &str) -> Option<Self> {
        [Self::Mono8, Self::Rgb8].into_iter().find(|format| format.encoding() == encoding)
    }
}

/// A picture, rows from the top, pixels from the left, nothing between rows. Copies share the pixels.
#[derive(Clone, PartialEq, Eq)]
pub struct Image {
    width: u32,
    height: u32,
    format: PixelFormat,
    data: Arc<[u8]>,
}

impl Image {
    /// A picture of these pixels; `None` where their number does not fit its size.
    #[must_use]
    pub fn new(width: u32, height: u32, format: PixelFormat, data: impl Into<Arc<[u8]>>) -> Option<Self> {
        let data = data.into();
        let expected = (width as usize).checked_mul(height as usize)?.checked_mul(format.bytes())?;
        (data.len() == expected).then_some(Self { width, height, format, data })
    }

    /// Pixels of a row.
    #[must_use]
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Rows.
    #[must_use]
    pub fn height(&self) -> u32 {
        self.height
    }

    /// What the bytes are.
    #[must_use]
    pub fn format(&self) -> PixelFormat {
        self.format
    }

    /// All pixels.
    #[must_use]
    pub fn data(&self) -> &[u8] {
        &self.data
    }
}

impl std::fmt::Debug for Image {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Image({} x {}, {})", self.width, self.height, self.format.encoding())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_fit_the_size() {
        assert!(Image::new(4, 3, PixelFormat::Rgb8, vec![0; 36]).is_some());
        assert!(Image::new(4, 3, PixelFormat::Mono8, vec![0; 36]).is_none());
        assert!(Image::new(u32::MAX, u32::MAX, PixelFormat::Rgb8, vec![]).is_none());
        assert_eq!(PixelFormat::from_encoding("mono8"), Some(PixelFormat::Mono8));
        assert_eq!(PixelFormat::from_encoding("bayer_rggb8"), None);
    }
}
