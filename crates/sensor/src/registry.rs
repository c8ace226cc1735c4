//! The sensor families that a program knows.

use dermis_skin::SkinDescription;

use crate::Sensor;

/// The skin is one of a family that the program does not know.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("skin `{skin}`: field `sensor` is \"{found}\", which this program does not know; it knows {known}")]
pub struct UnknownSensor {
    /// Name of the skin.
    pub skin: String,
    /// Family that it names.
    pub found: String,
    /// Families that there are.
    pub known: String,
}

/// The families of a program, one line each.
#[derive(Debug, Clone, Copy)]
pub struct Registry(&'static [&'static dyn Sensor]);

impl Registry {
    /// These families.
    #[must_use]
    pub const fn new(sensors: &'static [&'static dyn Sensor]) -> Self {
        Self(sensors)
    }

    /// Lets every family complete the skin descriptions that are read from now on; a program does that first.
    pub fn install(&self) {
        for sensor in self.0 {
            dermis_skin::register(*sensor);
        }
    }

    /// All of them.
    pub fn iter(&self) -> impl Iterator<Item = &'static dyn Sensor> {
        self.0.iter().copied()
    }

    /// The one of that name.
    #[must_use]
    pub fn get(&self, name: &str) -> Option<&'static dyn Sensor> {
        self.iter().find(|sensor| sensor.name() == name)
    }

    /// The one that reads this skin.
    ///
    /// # Errors
    ///
    /// [`UnknownSensor`] names those that there are.
    pub fn of(&self, skin: &SkinDescription) -> Result<&'static dyn Sensor, UnknownSensor> {
        self.get(&skin.sensor).ok_or_else(|| UnknownSensor {
            skin: skin.name.clone(),
            found: skin.sensor.clone(),
            known: self.names().join(", "),
        })
    }

    /// Their names, as skin descriptions call them.
    #[must_use]
    pub fn names(&self) -> Vec<&'static str> {
        self.iter().map(dermis_skin::Family::name).collect()
    }
}
