//! The skins inside the program, so that a demo needs no file beside it.

use dermis_operate::demo::Contents;

/// The files of a bundle that ships.
macro_rules! bundle {
    ($name:literal) => {
        &[
            ("bundle.toml", include_bytes!(concat!("../../../models/", $name, "/bundle.toml"))),
            ("model.onnx", include_bytes!(concat!("../../../models/", $name, "/model.onnx"))),
            ("card.json", include_bytes!(concat!("../../../models/", $name, "/card.json"))),
        ]
    };
}

/// The text of a skin that ships.
macro_rules! skin {
    ($name:literal) => {
        include_str!(concat!("../../../launch/skins/", $name, ".toml"))
    };
}

/// The skin that is shown where none is named.
pub const DEFAULT: &str = "baro-grid";

/// Every skin that can be shown by its name.
pub const SKINS: [Contents<'static>; 5] = [
    Contents {
        name: DEFAULT,
        skin: skin!("baro-grid"),
        plan: Some(include_str!("../../../launch/plans/demo.toml")),
        bundle: bundle!("baro-grid"),
        models: &[],
    },
    Contents {
        name: "baro-line",
        skin: skin!("baro-line"),
        plan: None,
        bundle: bundle!("baro-line"),
        models: &[],
    },
    Contents {
        name: "baro-dome",
        skin: skin!("baro-dome"),
        plan: None,
        bundle: bundle!("baro-dome"),
        models: &[],
    },
    Contents {
        name: "hapdef-shin",
        skin: skin!("hapdef-shin"),
        plan: None,
        bundle: bundle!("hapdef-shin"),
        models: &[],
    },
    Contents { name: "ert-panel", skin: skin!("ert-panel"), plan: None, bundle: &[], models: &[] },
];

/// The names of all of them, with commas between.
pub fn names() -> String {
    SKINS.map(|contents| contents.name).join(", ")
}
