//! What computes while a convolutional network is fitted.

use std::fmt;
use std::str::FromStr;

use super::config::TrainConfig;
use crate::LearnError;

/// What computes while a convolutional network is fitted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Processor {
    /// The processor, with burn's backend `flex`.
    #[default]
    Cpu,
    /// A GPU, through Vulkan: the fastest, or one by its number; in programs with the feature `gpu`.
    Gpu(Option<usize>),
}

impl fmt::Display for Processor {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Cpu => f.write_str("cpu"),
            Self::Gpu(None) => f.write_str("gpu"),
            Self::Gpu(Some(number)) => write!(f, "gpu:{number}"),
        }
    }
}

impl FromStr for Processor {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let number = || text.strip_prefix("gpu:").and_then(|number| number.parse().ok());
        match text {
            "cpu" => Ok(Self::Cpu),
            "gpu" => Ok(Self::Gpu(None)),
            _ => number().map(|number| Self::Gpu(Some(number))).ok_or_else(|| {
                format!("`{text}` is no processor; say `cpu`, `gpu`, or the GPU's number as in `gpu:1`")
            }),
        }
    }
}

impl Processor {
    /// Refuses what this program cannot use, and what a network would not be fitted on, before anything is read.
    pub(super) fn check(self, config: &TrainConfig) -> Result<(), LearnError> {
        if self != Self::Cpu && config.network.conv.is_none() && config.network.image.is_none() {
            return Err(LearnError::Training {
                reason: format!(
                    "`--processor {self}` is for convolutional networks (`network.conv`, `network.image`), and the configuration asks \
                     for none; leave it out"
                ),
            });
        }
        self.check_built()
    }

    /// Refuses a GPU where the program has nothing to use it with.
    fn check_built(self) -> Result<(), LearnError> {
        if self == Self::Cpu || cfg!(feature = "gpu") {
            return Ok(());
        }
        Err(LearnError::Training {
            reason: format!(
                "`--processor {self}` asks for a GPU, and this program was built without what GPUs need; build it with \
                 `cargo build --release -p dermis --features gpu`, or leave it out"
            ),
        })
    }

    /// The device as burn names it.
    #[cfg(feature = "train")]
    pub(super) fn device(self) -> Result<burn::tensor::Device, LearnError> {
        match self {
            Self::Cpu => Ok(burn::tensor::Device::flex()),
            Self::Gpu(number) => self.gpu(number),
        }
    }

    #[cfg(all(feature = "train", feature = "gpu"))]
    fn gpu(self, number: Option<usize>) -> Result<burn::tensor::Device, LearnError> {
        use burn::tensor::{Device, DeviceKind, DeviceType, Tensor};
        let refused =
            |reason: String| LearnError::Training { reason: format!("`--processor {self}`: {reason}") };
        let mut devices: Vec<Device> = Device::enumerate(DeviceType::Wgpu).into_iter().collect();
        let device = match number {
            Some(number) if number < devices.len() => devices.swap_remove(number),
            None if !devices.is_empty() => Device::wgpu(DeviceKind::DefaultDevice),
            _ => {
                return Err(refused(format!(
                    "{} GPUs are reached through Vulkan here (`vulkaninfo --summary` lists them); install the driver's Vulkan part, or \
                     leave it out to train on the processor",
                    devices.len()
                )));
            }
        };
        // What a driver cannot do shows at the first sum, by a panic.
        let sum = std::panic::catch_unwind(|| {
            Tensor::<1>::ones([8], &device).sum().into_data().try_to_vec::<f32>()
        });
        match sum {
            Ok(Ok(sum)) if sum == [8.0] => Ok(device),
            _ => Err(refused(
                "its driver does not compute; update it, or leave it out to train on the processor"
                    .to_owned(),
            )),
        }
    }

    #[cfg(all(feature = "train", not(feature = "gpu")))]
    fn gpu(self, _: Option<usize>) -> Result<burn::tensor::Device, LearnError> {
        self.check_built().map(|()| burn::tensor::Device::flex())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn processors_are_written_as_they_are_read() {
        for (text, processor) in
            [("cpu", Processor::Cpu), ("gpu", Processor::Gpu(None)), ("gpu:3", Processor::Gpu(Some(3)))]
        {
            let read: Processor = text.parse().unwrap();
            assert_eq!(read, processor);
            assert_eq!(read.to_string().parse(), Ok(processor));
        }
        for wrong in ["cuda", "gpu:", "gpu:-1", "cpu:0", ""] {
            assert!(wrong.parse::<Processor>().unwrap_err().contains("gpu:1"), "{wrong}");
        }
    }

    #[test]
    fn a_gpu_that_is_not_there_is_refused_with_a_sentence() {
        let processor = Processor::Gpu(Some(4096));
        let refused = processor.check_built().and_then(|()| {
            #[cfg(feature = "train")]
            return processor.device().map(drop);
            #[cfg(not(feature = "train"))]
            Ok(())
        });
        assert!(refused.unwrap_err().to_string().contains("--processor gpu:4096"));
    }

    #[test]
    fn a_dense_network_is_not_said_to_be_fitted_on_a_gpu() {
        let config = TrainConfig::from_toml("targets = [\"contact\"]", "c.toml").unwrap();
        Processor::Cpu.check(&config).unwrap();
        let refused = Processor::Gpu(None).check(&config).unwrap_err().to_string();
        assert!(refused.contains("convolutional"), "{refused}");
    }
}
