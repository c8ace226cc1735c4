//! The networks of chapter 4 of the thesis: those of Tables 4.4 and 4.5.

use std::path::Path;

use anyhow::{Context, Result, bail};
use serde_json::{Value, json};
use toml::{Table, Value as Toml};

use crate::measure::read_toml;

/// The network for map 1, which the others are made from.
pub(super) const THESIS: &str = "launch/train/ert-panel-thesis.toml";

/// Pixel and diameter \[mm\] of maps 1 to 12.
pub(super) const MAPS: [[u32; 2]; 12] = [
    [4, 20],
    [4, 28],
    [4, 32],
    [4, 44],
    [4, 52],
    [4, 60],
    [10, 10],
    [10, 30],
    [10, 50],
    [10, 70],
    [20, 20],
    [20, 60],
];
/// \[mm\] side of the square that every map covers.
const SQUARE: u32 = 640;

/// The thesis' configuration for another map.
pub(super) fn configuration(thesis: &Table, [pixel, diameter]: [u32; 2]) -> Result<Table> {
    let mut config = thesis.clone();
    let image = config.get_mut("network").and_then(|n| n.get_mut("image")).and_then(Toml::as_table_mut);
    let image = image.with_context(|| format!("{THESIS}: field `network.image` is missing"))?;
    let side = i64::from(SQUARE / pixel);
    image.insert("pixels".into(), Toml::Array(vec![Toml::Integer(side); 2]));
    image.insert("pixel".into(), Toml::Float(f64::from(pixel) * 1e-3));
    image.insert("diameter".into(), Toml::Float(f64::from(diameter) * 1e-3));
    if side != 160 {
        let layers = image.get_mut("layers").and_then(Toml::as_array_mut);
        let layers = layers.with_context(|| format!("{THESIS}: field `network.image.layers` is missing"))?;
        // 15 × 15 to 32 × 32, and to 64 × 64: the thesis says only that the size can be adapted.
        let [stride, double] = [2, side / 32];
        let transposed = |channels: i64, kernel: i64, stride: i64, padding: i64| {
            let keys = [("channels", channels), ("kernel", kernel), ("stride", stride), ("padding", padding)];
            let mut layer: Table = keys.into_iter().map(|(k, v)| (k.to_owned(), Toml::Integer(v))).collect();
            layer.insert("kind".into(), Toml::String("transposed".into()));
            Toml::Table(layer)
        };
        layers.truncate(3);
        layers.push(transposed(32, 6, stride, 1));
        layers.push(transposed(8, double, double, 0));
        layers.push(transposed(2, 3, 1, 1));
        layers.push(transposed(1, 3, 1, 1));
    }
    Ok(config)
}

/// Table 4.4: layers, shapes and parameters of the configuration that ships.
pub(super) fn structure(root: &Path) -> Result<Value> {
    let config = read_toml(&root.join(THESIS))?;
    let layers = config["network"]["image"]["layers"].as_array().cloned().unwrap_or_default();
    let (mut shape, mut total, mut rows) = ([784_i64, 1, 1], 0, Vec::new());
    for layer in &layers {
        let number = |key: &str, otherwise| layer.get(key).and_then(Toml::as_integer).unwrap_or(otherwise);
        let from = shape;
        let [channels, height, width] = from;
        let parameters = match layer["kind"].as_str().unwrap_or_default() {
            "linear" => {
                shape = [number("outputs", 1), 1, 1];
                (channels * height * width + 1) * shape[0]
            }
            "upsample" => {
                shape = [channels, height * number("factor", 1), width * number("factor", 1)];
                0
            }
            "transposed" => {
                let (kernel, stride, padding) =
                    (number("kernel", 1), number("stride", 1), number("padding", 0));
                let size = |n: i64| (n - 1) * stride - 2 * padding + kernel;
                shape = [number("channels", 1), size(height), size(width)];
                (channels * kernel * kernel + 1) * shape[0]
            }
            other => bail!("{THESIS}: `{other}` is no kind of layer that this table knows"),
        };
        total += parameters;
        rows.push(json!({ "kind": layer["kind"].as_str(), "input": from, "output": shape, "parameters": parameters }));
    }
    Ok(json!({ "layers": rows, "parameters": total }))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn root() -> std::path::PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
    }

    #[test]
    fn the_structure_has_the_parameters_of_the_thesis() {
        let table = structure(&root()).unwrap();
        assert_eq!(table["parameters"], 2_189_133);
        let parts: Vec<i64> =
            table["layers"].as_array().unwrap().iter().filter_map(|row| row["parameters"].as_i64()).collect();
        assert_eq!(parts, [401_920, 1_638_528, 0, 147_488, 0, 1_032, 146, 19]);
        assert_eq!(table["layers"][7]["output"], json!([1, 160, 160]));
    }

    #[test]
    fn every_map_has_layers_that_make_its_picture() {
        let thesis = read_toml(&root().join(THESIS)).unwrap();
        for map in MAPS {
            let config = configuration(&thesis, map).unwrap();
            let image = &config["network"]["image"];
            let side = i64::from(SQUARE / map[0]);
            assert_eq!(image["pixels"].as_array().unwrap()[0].as_integer(), Some(side));
            let mut size = 1;
            for layer in image["layers"].as_array().unwrap() {
                let number =
                    |key: &str, otherwise| layer.get(key).and_then(Toml::as_integer).unwrap_or(otherwise);
                size = match layer["kind"].as_str().unwrap() {
                    "linear" => 1,
                    "upsample" => size * number("factor", 1),
                    _ => (size - 1) * number("stride", 1) - 2 * number("padding", 0) + number("kernel", 1),
                };
            }
            assert_eq!(size, side, "{map:?}");
        }
    }
}
