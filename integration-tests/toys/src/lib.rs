//! Two sensor families that exist for a test. Each is one folder, and one line here that registers it: nothing of the rest of the
//! repository knows them.
//!
//! | family | what it has that the shipped ones lack |
//! |---|---|
//! | [`foam`] | 784 channels that follow from 28 electrodes, a shape of its own, memory, no superposition |
//! | [`camera`] | frames that are pictures, a wire of its own that answers requests |

pub mod camera;
pub mod foam;

use dermis_sensor::Registry;

/// The families of the test.
pub static SENSORS: Registry = Registry::new(&[foam::FAMILY, camera::FAMILY]);
