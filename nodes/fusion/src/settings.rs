//! What the estimator assumes of skins and contacts, each with its unit and where the number comes from.

use serde::{Deserialize, Serialize};

/// Assumptions of the estimator.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// \[1\] squared Mahalanobis distance up to which a contact of a skin can belong to a track: 99.9 % of χ² with three degrees of
    /// freedom.
    pub gate: f64,
    /// \[m/s\] standard deviation of the velocity of a contact along each axis, over all contacts. A hand that wipes over an arm
    /// moves at some 0.1 m/s; most contacts rest.
    pub slide_speed: f64,
    /// \[s\] in which a contact forgets its velocity: slides begin and end within a tenth of a second.
    pub slide_time: f64,
    /// \[N/√s\] intensity of the random walk of each component of the force: 20 lets a push of 6 N grow within 0.1 s, as a hand does.
    pub force_change: f64,
    /// \[m\] standard deviation of the place of a skin on its link: what gluing and measuring leave.
    pub mount_deviation: f64,
    /// \[1\] share of a skin's covariance that stays while a contact lasts. A network's error at a place is the same in every frame, and
    /// skins report one covariance for what stays and for what averages out; a half is between the two extremes.
    pub systematic_share: f64,
    /// \[1\] relative standard deviation of the gain of a skin's force, which stays, too: load cells that skins are calibrated on are
    /// good to 1 %, and skins lose a few per cent with temperature.
    pub gain_deviation: f64,
    /// \[m\] standard deviation of positions of which a skin reports none: half the pitch of coarse skins.
    pub unknown_position_deviation: f64,
    /// \[N\] the same of forces.
    pub unknown_force_deviation: f64,
    /// Reports that have to feel a contact before it is one. A single frame may be noise.
    pub births: u32,
    /// \[s\] for which a contact that no report feels stays, at least; slower skins have 2.5 of their periods.
    pub hold: f64,
    /// \[s\] by which a report may be older than the newest one of its neighbours and still be used in order.
    pub reorder: f64,
    /// \[s\] of age at which a report is refused: what it says is no news, and its clock is likely wrong.
    pub oldest: f64,
    /// \[s\] by which the stamp of a report may lie ahead of this machine's clock: what synchronised clocks differ by at most.
    pub ahead: f64,
    /// \[Hz\] reports of one skin above which further ones are dropped: twice the rate of the fastest skins. A skin for which a
    /// rate is stated may send twice that, if it is less.
    pub most_reports: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            gate: 16.27,
            slide_speed: 0.05,
            slide_time: 0.1,
            force_change: 20.0,
            mount_deviation: 1e-3,
            systematic_share: 0.5,
            gain_deviation: 0.03,
            unknown_position_deviation: 5e-3,
            unknown_force_deviation: 0.5,
            births: 2,
            hold: 0.05,
            reorder: 0.05,
            oldest: 1.0,
            ahead: 0.1,
            most_reports: 2000.0,
        }
    }
}

/// A number that cannot be.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("`{name}` is {value} and must be from {least} to {most}")]
pub struct SettingError {
    /// Name of the field.
    pub name: &'static str,
    /// What it is.
    pub value: f64,
    /// Least value.
    pub least: f64,
    /// Largest value.
    pub most: f64,
}

/// One number of the settings.
pub(crate) struct Field {
    pub name: &'static str,
    /// One sentence with the unit, for people who list parameters.
    pub about: &'static str,
    pub least: f64,
    pub most: f64,
    pub get: fn(&Settings) -> f64,
    pub set: fn(&mut Settings, f64),
}

macro_rules! field {
    ($name:ident, $about:literal, $least:literal, $most:literal) => {
        Field {
            name: stringify!($name),
            about: $about,
            least: $least,
            most: $most,
            get: |s| s.$name,
            set: |s, v| s.$name = v,
        }
    };
}

/// Every number with a fraction.
pub(crate) const FIELDS: [Field; 14] = [
    field!(
        gate,
        "[1] squared distance up to which a skin's contact can belong to one of the body",
        1.0,
        1000.0
    ),
    field!(
        slide_speed,
        "[m/s] standard deviation of a contact's velocity over its link, each axis",
        1e-6,
        100.0
    ),
    field!(slide_time, "[s] in which a contact forgets its velocity", 1e-3, 1e3),
    field!(force_change, "[N/sqrt(s)] intensity of the random walk of each force component", 1e-6, 1e6),
    field!(mount_deviation, "[m] standard deviation of a skin's place on its link", 0.0, 1.0),
    field!(systematic_share, "[1] share of a skin's covariance that stays while a contact lasts", 0.0, 0.99),
    field!(gain_deviation, "[1] relative standard deviation of the gain of a skin's force", 0.0, 10.0),
    field!(unknown_position_deviation, "[m] of positions that a skin gives no covariance for", 1e-5, 1.0),
    field!(unknown_force_deviation, "[N] of forces that a skin gives no covariance for", 1e-5, 1e5),
    field!(hold, "[s] for which a contact that no report feels stays, at least", 0.0, 60.0),
    field!(reorder, "[s] by which a report may be older than its neighbours' newest", 0.0, 1.0),
    field!(oldest, "[s] of age at which a report is refused", 0.01, 3600.0),
    field!(ahead, "[s] by which a stamp may lie ahead of the clock here", 0.0, 3600.0),
    field!(most_reports, "[Hz] of one skin above which reports are dropped", 1.0, 1e6),
];
/// Least and largest number of [`births`](Settings::births).
pub(crate) const BIRTHS: (u32, u32) = (1, 1000);

impl Settings {
    /// Whether every number can be.
    ///
    /// # Errors
    ///
    /// The first that cannot.
    pub fn check(&self) -> Result<(), SettingError> {
        for Field { name, least, most, get, .. } in FIELDS {
            let value = get(self);
            if !(least..=most).contains(&value) {
                return Err(SettingError { name, value, least, most });
            }
        }
        let (least, most) = BIRTHS;
        if !(least..=most).contains(&self.births) {
            let [value, least, most] = [self.births, least, most].map(f64::from);
            return Err(SettingError { name: "births", value, least, most });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_that_cannot_be_are_named() {
        assert_eq!(Settings::default().check(), Ok(()));
        let wrong = Settings { hold: f64::NAN, ..Settings::default() };
        insta::assert_snapshot!(wrong.check().unwrap_err(), @"`hold` is NaN and must be from 0 to 60");
        let wrong = Settings { births: 0, ..Settings::default() };
        insta::assert_snapshot!(wrong.check().unwrap_err(), @"`births` is 0 and must be from 1 to 1000");
    }
}
