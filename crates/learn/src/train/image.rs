//! Configuration of a network that makes a picture of forces.

use serde::{Deserialize, Serialize};

use super::layer::{Layer, shapes};
use crate::picture::Picture;

/// A network that makes a picture of pressing forces, layer after layer, and of that the map `map.normal` over the points of the skin
/// (thesis, Table 4.4).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ImageConfig {
    /// Rows and columns of the picture.
    pub pixels: [usize; 2],
    /// \[m\] side of a pixel.
    pub pixel: f64,
    /// \[m\] diameter of the disc that a contact's force is spread over where the network is trained.
    pub diameter: f64,
    /// Layers, of which the last one makes one plane of the pixels; a rectifier follows all others with parameters.
    pub layers: Vec<Layer>,
    /// Epochs without a lower error at other locations of the training part after which training ends; 0: never.
    #[serde(default)]
    pub patience: u32,
}

impl ImageConfig {
    /// Size of the picture, and how wide a contact is in it.
    #[must_use]
    pub fn picture(&self) -> Picture {
        Picture { pixels: self.pixels, pixel: self.pixel, diameter: self.diameter }
    }

    /// Says what is impossible: field and reason.
    pub(super) fn check(&self) -> Result<(), (String, String)> {
        self.picture().check().map_err(|(field, reason)| (format!("network.image.{field}"), reason))?;
        // Whatever the number of inputs is: a sequence without a linear layer in front is found when it is fitted.
        if !matches!(self.layers.first(), Some(Layer::Linear { .. })) {
            return Err(("network.image.layers".into(), "must begin with a layer of kind `linear`".into()));
        }
        let [rows, columns] = self.pixels;
        match shapes([1, 1, 1], &self.layers) {
            Ok(made) if made.last() == Some(&[1, rows, columns]) => Ok(()),
            Ok(made) => {
                let [c, h, w] = made.last().copied().unwrap_or_default();
                let reason =
                    format!("make {c} × {h} × {w} numbers, and the picture has 1 × {rows} × {columns}");
                Err(("network.image.layers".into(), reason))
            }
            Err((index, shape)) => {
                let reason = format!("can make nothing of the shape {shape:?}");
                Err((format!("network.image.layers[{index}]"), reason))
            }
        }
    }

    /// The network for so many inputs.
    #[cfg(feature = "train")]
    pub(super) fn spec(&self, name: &str, inputs: usize) -> super::conv::ConvSpec {
        use super::conv::{ConvSpec, Form, Head};
        let [rows, columns] = self.pixels;
        ConvSpec {
            input: "input".into(),
            shape: [inputs, 1, 1],
            encoder: Vec::new(),
            hidden: 0,
            heads: vec![Head { name: name.into(), form: Form::Map([1, rows, columns]), logit: false }],
            layers: self.layers.clone(),
        }
    }
}

#[cfg(test)]
pub(super) mod tests {
    use crate::train::TrainConfig;
    use crate::train::layer::shapes;

    /// What the thesis calls its networks, in the descriptions of the configurations that ship.
    pub(in crate::train) const RECON_NET: &str = "Recon-Net of the thesis";
    const TRANSFER_NET: &str = "Transfer-Net of the thesis";

    /// Texts of all configurations that ship, and what they say.
    fn all_shipped() -> Vec<(String, TrainConfig)> {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../launch/train");
        let files = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
        files
            .filter(|path| path.extension().is_some_and(|e| e == "toml"))
            .map(|path| {
                let text = std::fs::read_to_string(&path).unwrap();
                let config = TrainConfig::from_toml(&text, &path.display().to_string()).unwrap();
                (text, config)
            })
            .collect()
    }

    /// The one configuration of those that ship whose description begins so.
    pub(in crate::train) fn shipped(described: &str) -> (String, TrainConfig) {
        let mut found = all_shipped();
        found.retain(|(_, config)| config.description.starts_with(described));
        assert_eq!(found.len(), 1, "configurations described as `{described}`");
        found.remove(0)
    }

    #[test]
    fn the_thesis_network_has_the_shapes_of_its_table() {
        let config = shipped(RECON_NET).1.network.image.unwrap();
        // Table 4.4; its last input has two planes, whatever it says.
        let table = [
            [784, 1, 1],
            [512, 1, 1],
            [128, 5, 5],
            [128, 15, 15],
            [32, 40, 40],
            [32, 80, 80],
            [8, 160, 160],
            [2, 160, 160],
            [1, 160, 160],
        ];
        assert_eq!(shapes([784, 1, 1], &config.layers).unwrap(), table);
        assert_eq!((config.pixels, config.pixel), ([160, 160], 0.004));
    }

    #[cfg(feature = "train")]
    #[test]
    fn the_thesis_network_has_the_parameters_of_its_table() {
        use crate::train::conv::ConvNetwork;
        let spec = shipped(RECON_NET).1.network.image.unwrap().spec("map.normal", 784);
        assert_eq!(ConvNetwork::new(&spec, 1).unwrap().len(), 2_189_133);
    }

    #[test]
    fn the_transfer_network_has_the_parameters_of_the_thesis() {
        use crate::train::Mlp;
        let config = shipped(TRANSFER_NET).1;
        // 784 - 5 × 784 - 784: six layers of 784 × 784 weights and 784 biases.
        assert_eq!(Mlp::new(784, 784, &config.network, 1).len(), 6 * (784 * 784 + 784));
        assert_eq!(config.training.momentum, 0.7);
    }

    #[test]
    fn all_pictures_cover_the_square_of_the_thesis() {
        let pictures: Vec<_> = all_shipped().into_iter().filter_map(|(_, c)| c.network.image).collect();
        assert!(pictures.len() > 1, "that of the thesis, and a smaller one");
        for config in pictures {
            assert!((config.pixel * config.pixels[0] as f64 - 0.640).abs() < 1e-12);
            assert_eq!(config.pixels[0], config.pixels[1]);
        }
    }

    #[test]
    fn impossible_pictures_are_refused() {
        let text = shipped(RECON_NET).0;
        let refused = |from: &str, to: &str| {
            assert!(text.contains(from), "{from} is not in the configuration");
            TrainConfig::from_toml(&text.replacen(from, to, 1), "c.toml").unwrap_err().to_string()
        };
        insta::assert_snapshot!(refused("pixels = [160, 160]", "pixels = [160, 64]"), @"c.toml: field `network.image.layers`: make 1 × 160 × 160 numbers, and the picture has 1 × 160 × 64");
        insta::assert_snapshot!(refused("pixel = 0.004", "pixel = 0.0"), @"c.toml: field `network.image.pixel`: is 0 m and must be a positive length");
        insta::assert_snapshot!(refused("padding = 4", "padding = 60"), @"c.toml: field `network.image.layers[3]`: can make nothing of the shape [128, 15, 15]");
        insta::assert_snapshot!(refused("targets = [\"map.normal\"]", "targets = [\"map.normal\", \"contact\"]"), @"c.toml: field `targets`: must be [\"map.normal\"] alone where `network.image` draws it");
    }
}
