//! Calibration of "unknown".

/// Energy of what causes of trials change, as a share of that of signals: least and most. Chosen: one to ten margins.
pub const SIZES: [f64; 2] = [0.005, 0.08];
/// Root mean square by which another law of an effect differs from its own. Chosen: what selection takes laws to be known to.
pub const LAW: f64 = 0.2;
/// Standard deviation of numbers of the medium and the tip, in tolerances. Chosen: half of devices lie within a third of one.
pub const OFF: f64 = 0.5;
/// Share of all readings at power-on that a warm-up is drawn with (standard deviation), its least value, and its time constant \[s\].
/// Chosen.
pub const WARM_UP: [f64; 3] = [0.2, -0.5, 300.0];
/// Factors of the declared noise, of which one is drawn for each device. Chosen.
pub const NOISES: [f64; 5] = [1.0, 1.0, 2.0, 3.0, 5.0];
/// \[s\] in which the part of another law that goes with the course of a press fades after first contact. Chosen.
pub const EARLY: f64 = 0.5;
/// Standard deviation of a number of the description that is off, in large changes of it. Chosen.
pub const NUMBER: f64 = 0.5;
/// Rounds in which an effect is scaled to the energy that is wanted, and the logarithm of the ratio that is near enough. Chosen.
pub const SCALINGS: usize = 3;
/// See [`SCALINGS`].
pub const NEAR: f64 = 0.2;
/// Least and largest factor of that scaling. Chosen.
pub const SCALE: [f64; 2] = [1e-3, 4.0];
/// Share of the gap from which on factors count. Chosen.
pub const SMALL: f64 = 0.01;
/// Ridge of the regression, in trials. Chosen.
pub const RIDGE: f64 = 3.0;
/// Rounds of Newton's method. Chosen.
pub const ROUNDS: usize = 30;
/// Folds of its cross-validation. Chosen.
pub const FOLDS: usize = 5;
/// Share of known causes whose names may be firm. Chosen: a right name that is not firm costs a press, a wrong one that is costs trust.
pub const FIRM: f64 = 0.8;
/// Share of known causes that are not called unknown. Issue: at most 2 % are.
pub const KNOWN: f64 = 0.98;
