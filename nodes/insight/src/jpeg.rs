//! Pictures as a camera sends them: JPEG.
//!
//! A picture that is twice, four or eight times as wide as the skin's is made smaller while it is decoded: of each square of 8 pixels
//! only the lowest frequencies are transformed back, which takes half of the time or less. Of other multiples means are taken.

use std::borrow::Cow;
use std::fmt::Display;
use std::ops::Range;
use std::sync::LazyLock;

use dermis_skin::{Image, PixelFormat};
use jpeg_encoder::{ColorType, Encoder as JpegEncoder, SamplingFactor};
use zune_jpeg::JpegDecoder;
use zune_jpeg::errors::DecodeErrors;
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

use crate::optics::light::COLOURS;

/// Of the pictures of a simulated device. One of 410 x 308 pixels takes 180 kB; the original's are larger ones of 258 to 281 kB. At 98 compression adds
/// a fifth to the variance of the numbers of a frame of the thumb that ships, at 92 it would add four fifths.
const QUALITY: u8 = 98;
/// Times that a device's picture is as wide and high as the skin's, at most.
pub(crate) const MULTIPLE: u32 = 8;

/// \[bytes\] of a JPEG of the largest picture that is taken, at most: as many as its pixels have, and a header.
pub(crate) fn most_bytes([width, height]: [u32; 2]) -> usize {
    let pixels = width as usize * height as usize * (MULTIPLE * MULTIPLE) as usize;
    (pixels * COLOURS).clamp(1 << 16, 1 << 26)
}

/// Markers (the byte after 255).
pub(crate) mod marker {
    /// Of a byte 255 in compressed data.
    pub const STUFFED: u8 = 0x00;
    pub const FILL: u8 = 0xff;
    pub const HUFFMAN_CODES: u8 = 0xc4;
    pub const ARITHMETIC_CODES: u8 = 0xcc;
    pub const RESTARTS: std::ops::RangeInclusive<u8> = 0xd0..=0xd7;
    pub const BEGIN: u8 = 0xd8;
    pub const END: u8 = 0xd9;
    pub const SCAN: u8 = 0xda;
}

/// The usual codes (ITU-T T.81, K.3), which cameras leave out of each picture of a stream: as our encoder writes them.
static USUAL_CODES: LazyLock<Vec<u8>> = LazyLock::new(|| {
    let mut jpeg = Vec::new();
    let square = Image::new(8, 8, PixelFormat::Rgb8, vec![0; 8 * 8 * COLOURS]);
    if square.is_none_or(|square| compress(&square, &mut jpeg).is_err()) {
        return Vec::new();
    }
    let codes = segments(&jpeg).filter(|(kind, _)| *kind == marker::HUFFMAN_CODES);
    codes.flat_map(|(_, range)| jpeg[range].to_vec()).collect()
});

/// Segments of a picture with their kinds, up to the head of its first scan; fewer where something else is in between.
fn segments(jpeg: &[u8]) -> impl Iterator<Item = (u8, Range<usize>)> {
    let mut at = Some(2);
    std::iter::from_fn(move || {
        let begin = at?;
        let [0xff, kind, high, low] = *jpeg.get(begin..)?.first_chunk()? else { return None };
        let end = begin + 2 + usize::from(u16::from_be_bytes([high, low]));
        at = (kind != marker::SCAN).then_some(end);
        (end <= jpeg.len()).then_some((kind, begin..end))
    })
}

/// A picture with codes: the usual ones where it has none.
fn with_codes(jpeg: &[u8]) -> Cow<'_, [u8]> {
    for (kind, range) in segments(jpeg) {
        match kind {
            marker::HUFFMAN_CODES | marker::ARITHMETIC_CODES => break,
            marker::SCAN => {
                return [&jpeg[..range.start], &USUAL_CODES, &jpeg[range.start..]].concat().into();
            }
            _ => {}
        }
    }
    jpeg.into()
}

/// A picture of `size` pixels, or of a whole multiple of them.
pub(crate) fn decode(jpeg: &[u8], [width, height]: [u32; 2]) -> Result<Image, String> {
    let jpeg = &*with_codes(jpeg);
    let wrong = |error: DecodeErrors| format!("a picture is no JPEG that can be read: {error}");
    let options = DecoderOptions::default().set_strict_mode(false);
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(jpeg), options);
    decoder.decode_headers().map_err(wrong)?;
    let (wide, high) = decoder.info().map_or((0, 0), |info| (u32::from(info.width), u32::from(info.height)));
    let (times, colours) = (wide / width.max(1), decoder.input_colorspace());
    if !matches!(colours, Some(ColorSpace::YCbCr | ColorSpace::RGB))
        || !(1..=MULTIPLE).contains(&times)
        || [wide, high] != [width * times, height * times]
    {
        let colours = colours.map_or_else(|| "of unknown colours".to_owned(), |c| format!("{c:?}"));
        return Err(format!(
            "a picture has {wide} x {high} pixels ({colours}), and this skin's has {width} x {height} in colour, or a whole multiple of that up \
             to {MULTIPLE}: set `medium.camera.size`, or the camera"
        ));
    }
    if matches!(times, 2 | 4 | 8) {
        let data = scaled(jpeg, [width, height])?;
        return Image::new(width, height, PixelFormat::Rgb8, data)
            .ok_or_else(|| "a picture has too few bytes".to_owned());
    }
    let mut data = decoder.decode().map_err(wrong)?;
    if times > 1 {
        data = reduced(&data, [width as usize, height as usize], times as usize);
    }
    Image::new(width, height, PixelFormat::Rgb8, data).ok_or_else(|| "a picture has too few bytes".to_owned())
}

/// RGB of a picture that is two, four or eight times as wide and high as `size`, made smaller in the cosine transform of its blocks.
fn scaled(jpeg: &[u8], [width, height]: [u32; 2]) -> Result<Vec<u8>, String> {
    let wrong = |error: jpeg_decoder::Error| format!("a picture is no JPEG that can be read: {error}");
    let mut decoder = jpeg_decoder::Decoder::new(jpeg);
    // Progressive pictures keep coefficients: two bytes for each number of the largest picture that is taken.
    decoder.set_max_decoding_buffer_size(2 * most_bytes([width, height]));
    let side = |length: u32| u16::try_from(length).map_err(|_| "a picture is too large".to_owned());
    let made = decoder.scale(side(width)?, side(height)?).map_err(wrong)?;
    if (u32::from(made.0), u32::from(made.1)) != (width, height) {
        return Err(format!("a picture is made smaller to {made:?} pixels where {width} x {height} are due"));
    }
    decoder.decode().map_err(wrong)
}

/// Means over squares of `times` pixels.
fn reduced(data: &[u8], [width, height]: [usize; 2], times: usize) -> Vec<u8> {
    let mut sums = vec![0_u32; width * COLOURS];
    let mut out = Vec::with_capacity(width * height * COLOURS);
    let half = (times * times / 2) as u32;
    for rows in data.chunks_exact(width * times * COLOURS * times) {
        sums.fill(0);
        for row in rows.chunks_exact(width * times * COLOURS) {
            for (sum, square) in
                sums.as_chunks_mut::<COLOURS>().0.iter_mut().zip(row.chunks_exact(times * COLOURS))
            {
                for pixel in square.as_chunks::<COLOURS>().0 {
                    sum.iter_mut().zip(pixel).for_each(|(s, v)| *s += u32::from(*v));
                }
            }
        }
        out.extend(sums.iter().map(|sum| ((sum + half) / (times * times) as u32) as u8));
    }
    out
}

/// Appends the JPEG that a simulated device sends of a picture.
pub(crate) fn compress(image: &Image, out: &mut Vec<u8>) -> Result<(), String> {
    let colour = match image.format() {
        PixelFormat::Rgb8 => ColorType::Rgb,
        PixelFormat::Mono8 => ColorType::Luma,
    };
    let wrong = |reason: &dyn Display| format!("cannot make a JPEG of {image:?}: {reason}");
    let side = |length: u32| u16::try_from(length).map_err(|error| wrong(&error));
    let [width, height] = [side(image.width())?, side(image.height())?];
    let mut encoder = JpegEncoder::new(out, QUALITY);
    // Every pixel keeps its colour: it is what the picture is measured by.
    encoder.set_sampling_factor(SamplingFactor::F_1_1);
    encoder.encode(image.data(), width, height, colour).map_err(|error| wrong(&error))
}

/// A picture as a host sees it that a simulated device sent it to: compressed and read again.
pub(crate) fn sent(image: &Image) -> Result<Image, String> {
    let mut jpeg = Vec::new();
    compress(image, &mut jpeg)?;
    Ok(decode(&jpeg, [image.width(), image.height()])?.with_jpeg(jpeg))
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: [u32; 2] = [48, 32];

    fn picture(times: u32) -> Vec<u8> {
        let [width, height] = SIZE.map(|side| side * times);
        let data: Vec<u8> =
            (0..width * height * 3).map(|i| (i / 3 % width * 4 / times + i % 3 * 20) as u8).collect();
        let mut jpeg = Vec::new();
        compress(&Image::new(width, height, PixelFormat::Rgb8, data).unwrap(), &mut jpeg).unwrap();
        jpeg
    }

    /// As webcams send them.
    #[test]
    fn a_picture_without_codes_has_the_usual_ones() {
        for times in [1, 2, 3] {
            let jpeg = picture(times);
            let ranges: Vec<_> = segments(&jpeg).filter(|(kind, _)| *kind == marker::HUFFMAN_CODES).collect();
            assert!(!ranges.is_empty());
            let mut without = jpeg.clone();
            ranges.into_iter().rev().for_each(|(_, range)| drop(without.drain(range)));
            assert!(without.len() + 400 < jpeg.len());
            let (there, usual) = (decode(&jpeg, SIZE).unwrap(), decode(&without, SIZE).unwrap());
            assert!(there.data() == usual.data(), "{times}");
        }
    }

    #[test]
    fn what_has_codes_or_is_no_picture_stays_as_it_is() {
        let jpeg = picture(1);
        for bytes in
            [&jpeg[..], &jpeg[..60], b"", b"\xff\xd8", b"\xff\xd8\xff\xda\xff\xff", b"no picture at all"]
        {
            assert!(matches!(with_codes(bytes), Cow::Borrowed(same) if same == bytes));
        }
    }
}
