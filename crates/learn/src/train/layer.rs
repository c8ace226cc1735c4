//! A network as a plain sequence of layers.
//!
//! Problem: encoder and decoders of [`ConvConfig`](super::ConvConfig) halve and double; networks of the literature have kernels, strides and
//! paddings of their own. Method: a list of layers, each with the shape of what it makes; a rectifier follows every layer with
//! parameters but the last. Transposed convolutions are as in Dumoulin & Visin (2016): \[h\] becomes (h − 1) s − 2 p + k. Cost: that of
//! the layers.

use serde::{Deserialize, Serialize};

/// One layer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Layer {
    /// All numbers to so many numbers, each a plane of one.
    Linear {
        /// Numbers that come out.
        outputs: usize,
    },
    /// Transposed convolution.
    Transposed {
        /// Planes that come out.
        channels: usize,
        /// Rows and columns of the kernel.
        kernel: usize,
        /// Step of the kernel.
        #[serde(default = "one")]
        stride: usize,
        /// Rows and columns that are cut off at each side.
        #[serde(default)]
        padding: usize,
    },
    /// Every number so many times along rows and columns.
    Upsample {
        /// So many times.
        factor: usize,
    },
}

fn one() -> usize {
    1
}

/// Most numbers of a layer's output.
const MOST: usize = 1 << 26;

impl Layer {
    /// Whether it has parameters.
    #[must_use]
    pub fn is_weighted(self) -> bool {
        !matches!(self, Self::Upsample { .. })
    }

    /// \[channels, height, width\] of what it makes of such an input; `None` where that cannot be.
    #[must_use]
    pub fn output(self, [channels, height, width]: [usize; 3]) -> Option<[usize; 3]> {
        let made = match self {
            Self::Linear { outputs } => [outputs, 1, 1],
            Self::Transposed { channels, kernel, stride, padding } => {
                if !(1..=64).contains(&kernel) || !(1..=64).contains(&stride) || padding > 64 {
                    return None;
                }
                let size = |n: usize| ((n - 1) * stride + kernel).checked_sub(2 * padding);
                [channels, size(height)?, size(width)?]
            }
            Self::Upsample { factor } if factor <= 64 => [channels, height * factor, width * factor],
            Self::Upsample { .. } => return None,
        };
        let numbers = made.iter().try_fold(1_usize, |product, n| product.checked_mul(*n))?;
        (1..=MOST).contains(&numbers).then_some(made)
    }
}

/// Shapes from the input to the output of a sequence, both included.
///
/// # Errors
///
/// The index of the layer that cannot be, and the shape that it gets.
pub fn shapes(input: [usize; 3], layers: &[Layer]) -> Result<Vec<[usize; 3]>, (usize, [usize; 3])> {
    let mut all = vec![input];
    for (i, layer) in layers.iter().enumerate() {
        let from = all[i];
        all.push(layer.output(from).ok_or((i, from))?);
    }
    Ok(all)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_cannot_be_is_found() {
        let cut = Layer::Transposed { channels: 2, kernel: 3, stride: 1, padding: 2 };
        assert_eq!(shapes([1, 1, 1], &[Layer::Linear { outputs: 4 }, cut]), Err((1, [4, 1, 1])));
        assert_eq!(Layer::Linear { outputs: 0 }.output([1, 1, 1]), None);
        assert_eq!(Layer::Upsample { factor: 1000 }.output([1, 4, 4]), None);
        let none = Layer::Transposed { channels: 1, kernel: 0, stride: 1, padding: 0 };
        assert_eq!(none.output([1, 4, 4]), None);
    }
}
