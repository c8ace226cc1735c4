//! Mean and scale of many channels in a file of their own: `normalisation.npy`, 32-bit floats of shape \[2, channels\], which
//! NumPy reads.

use crate::features::FeatureConfig;

/// Channels from which on a bundle has the file: fewer are read more easily in the manifest.
pub(crate) const FROM: usize = 64;

/// The header that NumPy's format has for this shape (version 1.0, padded to 64 bytes).
fn header(channels: usize) -> Vec<u8> {
    let mut text = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': (2, {channels}), }}");
    while (10 + text.len() + 1) % 64 != 0 {
        text.push(' ');
    }
    text.push('\n');
    let length = u16::try_from(text.len()).unwrap_or(u16::MAX);
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend(length.to_le_bytes());
    bytes.extend(text.bytes());
    bytes
}

/// Mean and scale as the content of the file.
pub(crate) fn encode(input: &FeatureConfig) -> Vec<u8> {
    let mut bytes = header(input.channels());
    bytes.extend(input.mean.iter().chain(&input.scale).flat_map(|v| v.to_le_bytes()));
    bytes
}

/// Mean and scale of this many channels.
///
/// # Errors
///
/// What is wrong with the content.
pub(crate) fn decode(bytes: &[u8], channels: usize) -> Result<(Vec<f32>, Vec<f32>), String> {
    let wanted = || format!("must hold 32-bit floats of shape [2, {channels}] in NumPy's format 1.0");
    let body = bytes.strip_prefix(header(channels).as_slice()).ok_or_else(wanted)?;
    if body.len() != 8 * channels {
        return Err(format!("{}, and has {} bytes of them", wanted(), body.len()));
    }
    let number = |b: &[u8]| f32::from_le_bytes([b[0], b[1], b[2], b[3]]);
    let (mean, scale) = body.split_at(4 * channels);
    Ok((mean.chunks_exact(4).map(number).collect(), scale.chunks_exact(4).map(number).collect()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_is_read() {
        let mean: Vec<f32> = (0..784).map(|i| i as f32 * 0.1).collect();
        let scale: Vec<f32> = (0..784).map(|i| 1.0 + i as f32).collect();
        let bytes = encode(&FeatureConfig::newest(mean.clone(), scale.clone()));
        assert_eq!(bytes.len() % 64, 784 * 8 % 64);
        assert_eq!(decode(&bytes, 784), Ok((mean, scale)));
        assert!(decode(&bytes, 783).is_err());
        assert!(decode(&bytes[..bytes.len() - 1], 784).is_err());
    }
}
