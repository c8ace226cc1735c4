//! Presses to come.

/// Points of a surface that locations are chosen from, about. Chosen: bounds the responses of the model.
pub const CANDIDATES: usize = 400;
/// Share of the largest signal that a place must give to be pressed. Chosen.
pub const SEEN: f64 = 0.02;
/// \[s\] from one place to the next, on a rig with motors. Chosen.
pub const MOVE: f64 = 2.0;
/// \[s\] to change the tip once. Chosen.
pub const TIP_CHANGE: f64 = 20.0;
/// Locations whose presses are compared by a design. Chosen: bounds the simulations.
pub const LOCATIONS: usize = 24;
/// Directions that a rival is fitted in, at most. Chosen.
pub const COLUMNS: usize = 24;
/// Effects that stand as rivals beside what a report names. Chosen.
pub const SUSPECTS: usize = 4;
/// Probability of confusion that is assumed of such a rival where nothing is named for sure, for which no report says one. Chosen.
pub const SUSPECTED: f64 = 0.25;
/// The same where a name is firm: firm names were right in 0.73 of the cases that others made. Chosen.
pub const FIRM: f64 = 0.05;
/// Share of the minutes that serves what no hypothesis explains: at least and at most. Chosen.
pub const UNKNOWN: [f64; 2] = [0.15, 0.7];
/// Share of what a hypothesis changes that its rival may leave over all presses of the menu for both to be one thing: one minus the share
/// that makes two signatures one. Chosen.
pub const ALIKE: f64 = 0.03;
/// Probability of confusion that remains after all presses of the menu at all locations where a rig cannot tell two names. Chosen.
pub const UNTELLABLE: f64 = 0.2;
/// \[s\] of an ordinary press: loading, holding, unloading, rest. Chosen.
pub const PRESS: [f64; 4] = [0.2, 0.4, 0.2, 0.6];
/// Share of the range of forces that an ordinary press has. Chosen.
pub const USUAL: f64 = 0.6;
/// Presses of a block of the same press. Chosen.
pub const AGAIN: usize = 3;
/// Shares of the range of forces of a ladder. Chosen.
pub const LADDER: [f64; 4] = [0.0, 0.25, 0.5, 1.0];
/// \[s\] of loading, and of unloading, of the presses of two speeds. Chosen.
pub const SPEEDS: [f64; 2] = [0.05, 1.0];
/// \[s\] of rest after each of these. Chosen.
pub const REST_AFTER_SPEEDS: f64 = 1.5;
/// \[s\] of holding and of rest of a short press and of a long one. Chosen.
pub const HELD_AND_RESTED: [[f64; 2]; 2] = [[0.2, 3.0], [10.0, 10.0]];
/// \[s\] untouched before the first press of a simulated protocol. Chosen.
pub const BEFORE: f64 = 1.0;
/// \[s\] between simulated frames, at least. Chosen: bounds the simulations.
pub const STEP: f64 = 0.02;
/// Multiples of that step before the first press, and where a press is held or rests for long. Chosen.
pub const COARSE: [f64; 2] = [5.0, 10.0];
/// \[s\] after loading, before unloading and after it that are not simulated in such multiples. Chosen.
pub const SLOW_AFTER: f64 = 1.0;
