//! A picture that a skin's camera took.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

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

/// A picture, rows from the top, pixels from the left, nothing between rows. Copies share the pixels, and the JPEG that it came as.
#[derive(Clone, PartialEq, Eq)]
pub struct Image {
    width: u32,
    height: u32,
    format: PixelFormat,
    data: Arc<[u8]>,
    jpeg: Option<Arc<[u8]>>,
}

impl Image {
    /// A picture of these pixels; `None` where their number does not fit its size.
    #[must_use]
    pub fn new(width: u32, height: u32, format: PixelFormat, data: impl Into<Arc<[u8]>>) -> Option<Self> {
        let data = data.into();
        let expected = (width as usize).checked_mul(height as usize)?.checked_mul(format.bytes())?;
        (data.len() == expected).then_some(Self { width, height, format, data, jpeg: None })
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

    /// The same with the JPEG that its device sent, which may have a multiple of its pixels.
    #[must_use]
    pub fn with_jpeg(mut self, jpeg: impl Into<Arc<[u8]>>) -> Self {
        self.jpeg = Some(jpeg.into());
        self
    }

    /// The JPEG that its device sent; `None` where it sent something else.
    #[must_use]
    pub fn jpeg(&self) -> Option<&[u8]> {
        self.jpeg.as_deref()
    }

    /// All pixels.
    #[must_use]
    pub fn data(&self) -> &[u8] {
        &self.data
    }
}

/// A coarser image, as models take it: means over blocks of pixels, colour by colour.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ImageGrid {
    /// 1 for brightness, 3 for red, green and blue.
    pub planes: usize,
    /// Rows of blocks, from the top.
    pub rows: usize,
    /// Blocks of a row, from the left.
    pub columns: usize,
}

/// An image that a grid does not fit.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "an image of {width} x {height} pixels and {planes} colours does not divide into {} x {} blocks of {} colours (columns x rows)",
    .grid.columns, .grid.rows, .grid.planes
)]
pub struct ImageGridError {
    width: u32,
    height: u32,
    planes: usize,
    grid: ImageGrid,
}

impl ImageGrid {
    /// Most numbers of a grid.
    pub const MOST: usize = 1 << 22;

    /// Numbers of the grid, plane by plane and row by row.
    #[must_use]
    pub fn numbers(&self) -> usize {
        self.planes.saturating_mul(self.rows).saturating_mul(self.columns)
    }

    /// Writes the means over the blocks of an image, 0 (dark) to 1 (full scale): planes × rows × columns.
    ///
    /// # Errors
    ///
    /// [`ImageGridError`] where the image has other colours, or its size is no multiple of the grid's.
    pub fn reduce(&self, image: &Image, out: &mut Vec<f32>) -> Result<(), ImageGridError> {
        let planes = image.format.bytes();
        let (width, height) = (image.width as usize, image.height as usize);
        let fits =
            |pixels: usize, blocks: usize| blocks > 0 && pixels >= blocks && pixels.is_multiple_of(blocks);
        if planes != self.planes || !fits(width, self.columns) || !fits(height, self.rows) {
            return Err(ImageGridError { width: image.width, height: image.height, planes, grid: *self });
        }
        let [wide, high] = [width / self.columns, height / self.rows];
        let mut sums = vec![0_u32; self.numbers()];
        for (y, row) in image.data.chunks_exact(width * planes).enumerate() {
            let first = y / high * self.columns;
            for (x, pixel) in row.chunks_exact(planes).enumerate() {
                let at = first + x / wide;
                for (plane, value) in pixel.iter().enumerate() {
                    sums[plane * self.rows * self.columns + at] += u32::from(*value);
                }
            }
        }
        let share = 1.0 / (255.0 * (wide * high) as f64);
        out.clear();
        out.extend(sums.into_iter().map(|sum| (f64::from(sum) * share) as f32));
        Ok(())
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

    #[test]
    fn a_grid_is_means_of_blocks_plane_by_plane() {
        // Two blocks of 2 x 2 pixels side by side; red 0.2 and 0.4, green 1 and 0, blue 0 throughout but for one pixel.
        let pixel = |x: usize, y: usize| {
            let blue = if (x, y) == (3, 1) { 204 } else { 0 };
            if x < 2 { [51, 255, blue] } else { [102, 0, blue] }
        };
        let data: Vec<u8> = (0..2).flat_map(|y| (0..4).flat_map(move |x| pixel(x, y))).collect();
        let image = Image::new(4, 2, PixelFormat::Rgb8, data).unwrap();
        let mut out = Vec::new();
        let grid = ImageGrid { planes: 3, rows: 1, columns: 2 };
        grid.reduce(&image, &mut out).unwrap();
        for (found, wanted) in out.iter().zip([0.2, 0.4, 1.0, 0.0, 0.0, 0.2]) {
            assert!((found - wanted).abs() < 1e-6, "{out:?}");
        }
        for wrong in [(1, 1, 2), (3, 1, 3), (3, 0, 2), (3, 4, 2)] {
            let (planes, rows, columns) = wrong;
            assert!(ImageGrid { planes, rows, columns }.reduce(&image, &mut out).is_err(), "{wrong:?}");
        }
        let said = ImageGrid { planes: 3, rows: 1, columns: 3 }.reduce(&image, &mut out).unwrap_err();
        assert_eq!(
            said.to_string(),
            "an image of 4 x 2 pixels and 3 colours does not divide into 3 x 1 blocks of 3 colours (columns x rows)"
        );
    }
}
