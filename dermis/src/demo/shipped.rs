//! The skins inside the program, so that a demo needs no file beside it.

use dermis_operate::demo::Contents;

/// The files of a bundle that ships: of one with a network, or these.
macro_rules! bundle {
    ($name:literal) => {
        bundle!($name: "bundle.toml", "model.onnx", "card.json")
    };
    ($name:literal: $($file:literal),+) => {
        &[$(($file, include_bytes!(concat!("../../../models/", $name, "/", $file)))),+]
    };
}

/// A skin that ships, with the text of its plan if it has one, and the files of its bundle.
macro_rules! skin {
    ($name:literal, $plan:expr, $bundle:expr) => {
        Contents {
            name: $name,
            skin: include_str!(concat!("../../../launch/skins/", $name, ".toml")),
            plan: $plan,
            bundle: $bundle,
            models: &[],
        }
    };
}

/// Every skin that can be shown by its name; the first is shown where none is named.
pub const SKINS: [Contents<'static>; 6] = [
    skin!("baro-grid", Some(include_str!("../../../launch/plans/demo.toml")), bundle!("baro-grid")),
    skin!("baro-line", None, bundle!("baro-line")),
    skin!("baro-dome", None, bundle!("baro-dome")),
    skin!("hapdef-shin", None, bundle!("hapdef-shin")),
    skin!("ert-panel", None, &[]),
    skin!("insight-thumb", None, bundle!("insight-thumb": "bundle.toml", "card.json")),
];

/// The skin that is shown where none is named.
pub const DEFAULT: &str = SKINS[0].name;

/// The names of all of them, with commas between.
pub fn names() -> String {
    SKINS.map(|contents| contents.name).join(", ")
}
