//! Studies on the sensor families of this program: what they find, and what is said of it; and whether the files that ship fit
//! each other.
#![expect(clippy::unwrap_used, reason = "a panic is the report of a failed test")]

mod bounds;
mod protocols;
mod real2sim;
mod schemas;
mod shipped;
mod sweep;
mod trends;

use dermis_sensor::Registry;
use dermis_skin::SkinDescription;
use dermis_studies::Families;

const SENSORS: Registry = Registry::new(&[
    dermis_barodome::FAMILY,
    dermis_hapdef::FAMILY,
    dermis_ert::FAMILY,
    dermis_insight::FAMILY,
]);
const FAMILIES: Families = Families::new(&SENSORS);

fn path(skin: &str) -> std::path::PathBuf {
    SENSORS.install();
    std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../launch/skins").join(skin)
}

fn load(skin: &str) -> SkinDescription {
    SkinDescription::load(path(skin)).expect("a skin that ships")
}

/// What this program does with these arguments.
fn program(arguments: &[&str]) -> std::process::Output {
    std::process::Command::new(env!("CARGO_BIN_EXE_dermis"))
        .args(arguments)
        .output()
        .expect("the program starts")
}
