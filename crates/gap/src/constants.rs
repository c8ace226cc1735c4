//! Every number that decides something in a diagnosis: meaning, unit, and where it comes from.
//!
//! | source | what it means |
//! |---|---|
//! | *paper* | the reference stands beside the number |
//! | *calibrated* | the set, its seeds and the command stand beside the number |
//! | *design note* | the note that this crate was planned by; its numbers come from a pilot, or from the papers that it cites |
//! | *chosen* | an engineering judgement that was not varied: sizes of tables, limits of work, tolerances of instruments |
//! | *chosen and checked* | an engineering judgement that was revised after results on benchmark sets whose seeds and runs were not kept. What these numbers come to together, on sets that they were not set on, is measured by `cargo xtask measure gap` and kept in `benches/results/gap-check-*.json` |
//!
//! Shares are fractions of 1. "Systematic gap" is the part of readings minus model that comes again, as a share of the readings'
//! variance (FVU). Properties of an effect (values that a device can have, amounts at which its signature is linearised) stand in the
//! effect's own file, see [`dermis_model::diagnosis`]; the experiments that may come next, with their times and forces, are a
//! table in `experiments.rs`. What a user may set stands in [`SelectOptions`](crate::SelectOptions) and
//! [`SampleOptions`](crate::SampleOptions); its defaults are here.

pub(crate) mod calibrate;
pub(crate) mod protocol;

/// Reading bags.
pub(crate) mod reading {
    /// \[m\] off the surface that a true contact may lie before its frame is doubted: errors of a stage and a mould. Chosen.
    pub const OFF_SURFACE: f64 = 2e-3;
    /// Share of a press's force by which it changes from frame to frame while it is held. Chosen.
    pub const HELD: f64 = 0.03;
    /// \[s\] from the first untouched frame on that the zero of a run is taken from. Chosen.
    pub const ZERO_AT_START: f64 = 1.0;
    /// \[s\] before a press that its zero is taken from. Chosen.
    pub const ZERO_BEFORE_PRESS: f64 = 0.5;
    /// Share of the time between frames within which a ground truth belongs to a frame, and at least so much \[s\]. Chosen.
    pub const SAME_TIME: [f64; 2] = [0.5, 0.01];
    /// Changes of [`HELD`] within four frames from which on a press is loaded or unloaded. Chosen.
    pub const CHANGES: f64 = 4.0;
    /// \[N\] of a contact that pulls below which it is noise of the force cell. Chosen.
    pub const PULLS: f64 = 0.05;
    /// Shares of contacts off the surface, and of those that pull, from which on the frame of the ground truth is wrong. Chosen.
    pub const WRONG_FRAME: [f64; 2] = [0.05, 0.2];
    /// \[m\] off the surface from which on millimetres stand for metres. Chosen: no skin that one rig presses is as large.
    pub const MILLIMETRES: f64 = 0.5;
    /// \[m\] diameter of a tip of which none is stated. Chosen.
    pub const TIP: f64 = 0.004;
}

/// Drawing samples.
pub(crate) mod sampling {
    /// \[s\] after a contact has ended for which frames still belong to it. Chosen.
    pub const AFTER: f64 = 2.0;
    /// Readings (samples × channels), at most. Chosen.
    pub const READINGS: usize = 1_500_000;
    /// Groups, at most. Chosen.
    pub const GROUPS: usize = 240;
    /// Share of groups that is neither fitted nor selected on. Chosen.
    pub const TEST: f64 = 0.25;
}

/// Measuring noise and gap.
pub(crate) mod noise {
    /// Frames that a channel's noise is measured on, at most. Chosen.
    pub const FRAMES: usize = 20_000;
    /// Steps between frames below which the declared noise is taken. Chosen.
    pub const FEWEST_STEPS: usize = 50;
    /// Median of |a − b| of two standard normal numbers: √2 times the upper quartile, 0.6745. Exact to four digits.
    pub const MEDIAN_STEP: f64 = 0.9539;
    /// Share of the declared noise below which a measured one is not believed: quantized readings repeat. Chosen.
    pub const BELIEVED: f64 = 0.1;
    /// Relative difference of the forces of a press that is done again. Chosen.
    pub const SAME_FORCE: f64 = 0.05;
    /// \[m\] between the locations of a press that is done again. Chosen.
    pub const SAME_PLACE: f64 = 1e-4;
    /// Pairs of repeats from which on the irreproducible share is measured. Chosen.
    pub const REPEATS: usize = 10;
    /// Relative difference of the times since contact of frames of such presses, and from which time on \[s\] it is relative. Chosen.
    pub const SAME_COURSE: [f64; 2] = [0.2, 0.05];
    /// \[N\] from which force on its difference is relative. Chosen.
    pub const SMALL_FORCE: f64 = 0.05;
    /// Pairs of frames from which on the noise is that of pairs and not the measured one between frames. Chosen.
    pub const PAIRS: f64 = 5.0;
    /// Quantiles of the interval of the gap: 95 %.
    pub const INTERVAL: [f64; 2] = [0.025, 0.975];
    /// Bootstrap draws of groups for the interval of the gap. Chosen; Efron and Tibshirani 1993 ask for 200 and more.
    pub const DRAWS: usize = 400;
}

/// Stage `check`.
pub(crate) mod check {
    /// Presses below which no cause is named. Chosen.
    pub const FEWEST_PRESSES: usize = 30;
    /// Samples below which nothing is compared. Chosen.
    pub const FEWEST_SAMPLES: usize = 100;
    /// Samples that channels are compared on, at most. Chosen.
    pub const COMPARED: usize = 400;
    /// Correlation of readings and model below which something else than an effect is likely. Chosen.
    pub const AGREES: f64 = 0.8;
    /// Correlation above which a wrong factor is a wrong unit, and below whose negative the sign is turned. Chosen.
    pub const SAME_SHAPE: f64 = 0.5;
    /// Least and largest factor between readings and model that an effect may make. Chosen: units differ by 1000.
    pub const FACTOR: [f64; 2] = [0.02, 50.0];
    /// Correlation below which readings and model are unrelated. Chosen.
    pub const UNRELATED: f64 = 0.3;
    /// Correlation that another frame of the ground truth must gain. Chosen.
    pub const FRAME_GAIN: f64 = 0.1;
    /// Correlation with its own model above which a channel is in its place. Chosen.
    pub const IN_PLACE: f64 = 0.9;
    /// Correlation with the model of another channel that an exchanged one has at least, and its advantage. Chosen.
    pub const EXCHANGED: [f64; 2] = [0.7, 0.15];
    /// \[K\] range of temperature below which it tells nothing. Chosen.
    pub const KELVIN: f64 = 0.2;
    /// Untouched frames from which on a recording has windows without contact. Chosen.
    pub const IDLE: usize = 50;
    /// Share of frames without a number from which on a channel makes the recording useless. Chosen.
    pub const NO_NUMBER: f64 = 0.5;
    /// Frames without a change from which on a channel is dead. Chosen.
    pub const NEVER_CHANGES: usize = 100;
    /// Correlation in another frame of the ground truth below which channels may be mirrored, too. Chosen.
    pub const MIRRORED: f64 = 0.999;
    /// Relative difference of two quantization steps that are one. Chosen.
    pub const SAME_STEP: f64 = 0.02;
    /// \[s\] below which no press of the recording is a long one, on which slow creep shows. Chosen.
    pub const LONG_HOLD: f64 = 1.0;
}

/// Checks of readings that need no model, or next to none.
pub(crate) mod consistency {
    /// Comparisons from which on a check says anything. Chosen.
    pub const COMPARED: usize = 10;
    /// Factor of the noise above which a check is violated. Chosen.
    pub const FACTOR: f64 = 1.5;
    /// Standard errors of that noise, besides, roughly: chance over dozens of channels and checks. Chosen.
    pub const DEVIATIONS: f64 = 4.0;
    /// Factor of the noise of a mean over channels above which they have something in common. Chosen.
    pub const TOGETHER: f64 = 4.0;
    /// Ratio of forces between which presses are too alike for homogeneity. Chosen.
    pub const ALIKE: [f64; 2] = [0.77, 1.3];
}

/// Quantized readings.
pub(crate) mod quantization {
    /// Readings that are compared, at most. Chosen.
    pub const READINGS: usize = 20_000;
    /// Readings that say anything, at least. Chosen.
    pub const FEWEST: usize = 200;
    /// Distinct values per reading above which readings are not quantized. Chosen.
    pub const DISTINCT: f64 = 0.2;
    /// Share of a step that a reading may lie beside a multiple of it. Chosen.
    pub const BESIDE: f64 = 0.02;
    /// Share of readings that must lie on a multiple. Chosen.
    pub const ON: f64 = 0.98;
}

/// Mains interference.
pub(crate) mod interference {
    /// Frames of a stretch whose spectrum is taken. Chosen: a resolution of 1/64 of the frame rate.
    pub const STRETCH: usize = 64;
    /// Stretches that say anything, at least. Chosen.
    pub const FEWEST: usize = 4;
    /// Ratio of a line to the median of the spectrum. Chosen: averages of a few
    /// stretches of noise stay well below.
    pub const ABOVE: f64 = 8.0;
    /// First line that is no drift, in multiples of the resolution. Chosen.
    pub const SLOW: usize = 4;
    /// \[Hz\] of mains. IEC 60038.
    pub const MAINS: [f64; 2] = [50.0, 60.0];
}

/// Where a gap lies.
pub(crate) mod location {
    /// Permutations whose mean is what an axis explains by chance. Chosen.
    pub const PERMUTATIONS: usize = 8;
    /// Share of the gap that chance loses at most. Chosen and checked.
    pub const UNLUCKY: f64 = 0.1;
    /// Bins of a continuous axis. Chosen.
    pub const BINS: usize = 8;
    /// Samples that a bin must hold to be fitted. Chosen.
    pub const LEAST: usize = 8;
    /// Ridge of a bin's factor: sum of squares of the signals, in deviations of the noise, at which the factor is halved. Chosen.
    pub const RIDGE: f64 = 10.0;
    /// \[1/s\] a force that changes by less of itself is held. Chosen.
    pub const STILL: f64 = 0.02;
    /// Share of the frames of a place or press in one bin from which on the axis is one of locations or presses. Chosen.
    pub const COMMON: f64 = 0.95;
    /// Correlation of bins from which on two axes are one in a recording. Chosen.
    pub const ONE: f64 = 0.97;
    /// Share of the samples of the larger axis that two axes must have in common to be one. Chosen.
    pub const IN_BOTH: f64 = 0.9;
    /// \[m\] that contacts must spread along an axis to be cut into cells along it. Chosen.
    pub const SPREAD: f64 = 1e-3;
    /// \[N\] below which a force does not scale speed and history. Chosen.
    pub const FORCE: f64 = 0.01;
    /// Single contacts from which on there is a map. Chosen.
    pub const MAPPED: usize = 20;
    /// Contacts on a square that is as wide as the kernel of a map. Chosen.
    pub const KERNEL_CONTACTS: f64 = 4.0;
    /// Widths of the kernel over the extent of a surface, at most. Chosen.
    pub const KERNELS: f64 = 40.0;
    /// Widths of the kernel of a map beyond which contacts do not count. Chosen: 1 % of its height.
    pub const KERNEL: f64 = 3.0;
    /// Weight of contacts, and their effective number, from which on a point of a map is known. Chosen.
    pub const KNOWN: [f64; 2] = [0.05, 1.0];
    /// Standard errors by which a point of a map must exceed the noise. Chosen.
    pub const BEYOND: f64 = 3.0;
    /// Points of a map, at most. Chosen.
    pub const POINTS: usize = 400;
    /// Cells of the surface, about. Chosen.
    pub const CELLS: usize = 24;
    /// Bootstrap draws for the interval of a share, and the indices of its 95 % interval. Chosen.
    pub const DRAWS: usize = 200;
    /// See [`DRAWS`].
    pub const INTERVAL: [usize; 2] = [5, 194];
}

/// Stage `signatures`.
pub(crate) mod signatures {
    /// Devices that a random effect is drawn for. Chosen.
    pub const DEVICES: u64 = 8;
    /// Share of the energy of realisations that columns hold. Chosen.
    pub const HELD: f64 = 0.998;
    /// The same of components of courses, whose changes are many times larger than the noise. Chosen.
    pub const WHOLE: f64 = 0.9999;
    /// The same of the model discrepancy. Chosen.
    pub const DISCREPANCY: f64 = 0.9995;
    /// Share of all readings at power-on that a column of a decay is for. Chosen: small, as the signature is linear.
    pub const DECAY_SHARE: f64 = 0.1;
    /// Columns of an effect for all channels together, at most. Chosen.
    pub const TOGETHER: usize = 5;
    /// Columns of an effect for each channel, at most. Chosen.
    pub const EACH: usize = 3;
    /// Share that components of the other devices must predict of a device for an effect to act alike on all channels. Chosen.
    pub const PREDICTED: f64 = 0.9;
    /// With so many components. Chosen.
    pub const FEW: usize = 3;
    /// Root mean square change, in deviations of the noise, below which an effect does not move the output. Chosen.
    pub const MOVED: f64 = 1e-3;
    /// Share of the energy of a change that must not be proportional to its amount to be a column of its own. Chosen.
    pub const NONLINEAR: f64 = 0.01;
    /// Share that two effects must explain of each other to be two names of one thing. Chosen.
    pub const SAME: f64 = 0.97;
    /// Relative tolerance of every number of a data sheet. Chosen: Shore hardness is sold within 5 points, which is some 15 % of a
    /// modulus; lengths of moulded and machined parts are within 1 to 5 % at these sizes (ISO 2768-m, ISO 3302-1 class M3).
    pub const TOLERANCE: f64 = 0.05;
    /// Large change of a number of the description, as a share of it: what its signature stands for. Chosen: five tolerances.
    pub const REACH: f64 = 0.25;
    /// Factor within which such a number is fitted. Chosen.
    pub const WITHIN: f64 = 5.0;
    /// Numbers or elements of a list that are hypotheses of their own; a longer one is a pattern. Chosen.
    pub const LIST: usize = 4;
    /// Share that two memoryless effects explain of each other from which on they are two names of one thing: what no press of the
    /// recording shows apart, at any place or force, is apart in none. Chosen: an angle of 4 degrees.
    pub const ALIAS: f64 = 0.995;
    /// Relative tolerance of a contact law: exponent of the force, width of a footprint. Chosen.
    pub const LAW: f64 = 0.05;
    /// Columns of the model discrepancy, at most. Chosen.
    pub const DISCREPANCIES: usize = 12;
    /// Simulations whose readings are held at once, about. Chosen: bounds memory.
    pub const AT_ONCE: usize = 16;
    /// \[m\] by which taxels are moved for central differences. Chosen: small against a footprint of millimetres.
    pub const SHIFT: f64 = 2e-4;
    /// \[s\] time constants of zeros that decay from power-on, half an order of magnitude apart. Chosen.
    pub const DECAYS: [f64; 5] = [30.0, 95.0, 300.0, 950.0, 3000.0];
    /// Components of these decays. Chosen.
    pub const DECAY_COLUMNS: usize = 2;
    /// Knots of a piecewise linear course through time, in each run. Chosen.
    pub const KNOTS: usize = 12;
    /// \[s\] without samples after which a course through time starts anew. Chosen.
    pub const PAUSE: f64 = 120.0;
    /// Share that the knots must hold of a device's course for it to be one. Chosen.
    pub const SMOOTH: f64 = 0.9;
    /// Share that one pattern over channels must hold for a course to be common to all. Chosen.
    pub const ONE_COURSE: f64 = 0.97;
    /// Columns of random drifts, at most. Chosen.
    pub const DRIFTS: usize = 160;
}

/// Stage `select`; the defaults of [`SelectOptions`](crate::SelectOptions) are among them.
pub(crate) mod select {
    /// Systematic gap [FVU] below which there is none that matters. Design note, §2.
    pub const MARGIN: f64 = 0.005;
    /// Least gain of an effect [FVU]. Design note, §6: set on its pilot.
    pub const FLOOR: f64 = 0.002;
    /// Part of that floor for an effect beside others whose signatures are exact: what is little of a gap that matters counts. Chosen.
    pub const SECOND: f64 = 0.5;
    /// What a sample leaves, as a share of the energy that the prior of the model discrepancy stands for, while the former is measured: so
    /// little that the discrepancy is nearly free. Chosen.
    pub const NEARLY_FREE: f64 = 0.1;
    /// Least gain of a first effect, as a share of the systematic gap. Chosen and checked.
    pub const SHARE: f64 = 0.05;
    /// The same of an effect beside others. Chosen and checked.
    pub const BESIDE: f64 = 0.01;
    /// The same beside others that are nonlinear or drift: what their columns leave may look like one. Chosen and checked.
    pub const BESIDE_NONLINEAR: f64 = 0.12;
    /// Probability of a false alarm over the whole library. Design note, §6.
    pub const LEVEL: f64 = 0.01;
    /// Effects at most. Design note, §6.
    pub const MOST: usize = 5;
    /// Candidates that are tried in all pairs: this many that do best alone, and as many beside each accepted one. Chosen.
    pub const PAIRED: usize = 16;
    /// Folds of cross-validation. Design note, §6.
    pub const FOLDS: usize = 6;
    /// Sign permutations of the max-T test. Westfall and Young 1993; 299 make the least p 1/300.
    pub const PERMUTATIONS: usize = 299;
    /// Posterior odds from which on a candidate is distinguished from the one that is named. Kass and Raftery 1995: 20 to 1 is strong.
    pub const DECISIVE_ODDS: f64 = 20.0;
    /// Effective samples that a place of contact gives: errors of laws go on from press to press. Chosen and checked.
    pub const EFFECTIVE_SAMPLES: f64 = 0.5;
    /// Inverse variance of coefficients of effects: a weak prior. Chosen.
    pub const PRIOR: f64 = 0.05;
    /// Share of the energy of an effect that its law leaves at least: a fifth of the amplitude. Chosen and checked.
    pub const LAW: f64 = 0.04;
    /// Share of the Bayesian information criterion's price of a column that is charged (Schwarz 1978): cross-validation has paid some
    /// of it. Chosen and checked.
    pub const OCCAM: f64 = 0.5;
    /// Margins that a gap must exceed with certainty for any firm name. Chosen and checked.
    pub const CLEARLY: f64 = 1.0;
    /// The same for a name that may as well be the model discrepancy. Chosen and checked.
    pub const SURELY: f64 = 1.4;
    /// Share of a gap near the margin that an effect must explain beyond the model discrepancy. Chosen and checked.
    pub const BEYOND: f64 = 0.5;
    /// Columns of one effect that are paid for, at most. Chosen.
    pub const MANY: usize = 6;
    /// The same of one that drifts randomly, which can follow the temperature as well. Chosen and checked.
    pub const MANY_DRIFTING: usize = 12;
    /// Multiple of the firm threshold beyond which the permutation test is not run. Chosen.
    pub const BEYOND_TEST: f64 = 3.0;
    /// Multiple of the level at which permutations end early: enough is known. Chosen.
    pub const ENOUGH: f64 = 4.0;
    /// Share of an effect's signature that a more general one of twice the columns must hold to cover it. Chosen.
    pub const COVERED: f64 = 0.95;
}

/// Generic rivals of the named effects.
pub(crate) mod rivals {
    /// Folds of cross-validation. Design note, §6.
    pub const FOLDS: usize = 6;
    /// Channels that rivals are fitted on, at most: those with the largest residual. Chosen: bounds memory.
    pub const CHANNELS: usize = 48;
    /// Inverse variance of coefficients: that of effects. Chosen.
    pub const PRIOR: f64 = 0.05;
    /// Share of the energy that components of channels hold. Chosen.
    pub const HELD: f64 = 0.999;
    /// Width of a patch, in distances to the next one. Chosen: patches overlap at half of their height.
    pub const WIDTH: f64 = 0.6;
    /// Factor that a coefficient of 1 stands for: that of gains. Chosen.
    pub const AMOUNT: f64 = 0.05;
    /// Patterns of all channels that each may hold. Chosen.
    pub const PATTERNS: usize = 3;
    /// Patches of a surface, at most, and locations that each must have. Chosen.
    pub const PATCHES: usize = 16;
    /// See [`PATCHES`].
    pub const PLACES_A_PATCH: usize = 6;
    /// Knots of a zero that drifts, in each run. Chosen.
    pub const ZERO_KNOTS: usize = 6;
    /// \[s\] in which what a press leaves behind fades. Chosen.
    pub const FADE: f64 = 0.2;
    /// \[m\], and share of the widest axis, that locations must extend to both sides of their middle along an axis to differ in it. Chosen:
    /// a millimetre in a decimetre is no axis of its own.
    pub const WIDE: [f64; 2] = [5e-4, 0.05];
    /// Powers of the force, from 0 on. Chosen.
    pub const POWERS: i32 = 4;
    /// \[s\] after contact before which the logarithm of the time does not change. Chosen.
    pub const FIRST_SINCE: f64 = 0.01;
    /// \[1/s\] change of a force by itself from which on a faster one makes no difference. Chosen.
    pub const SPEED: f64 = 20.0;
    /// \[m\] from all middles of patches below which a location is not the middle of another one. Chosen.
    pub const DISTINCT: f64 = 1e-4;
    /// Widths of a patch beyond which it is zero. Chosen: 4 millionths of its height.
    pub const PATCH_END: f64 = 5.0;
}

/// Stage `refine`.
pub(crate) mod refine {
    /// Rounds of Levenberg and Marquardt. Chosen.
    pub const ROUNDS: usize = 6;
    /// Relative deviation of a value from what another law of the same effect would have. Chosen and checked.
    pub const LAW: f64 = 0.08;
    /// Relative gain below which a round was the last. Chosen.
    pub const ENOUGH: f64 = 1e-3;
    /// Step of finite differences, in large changes of a number. Chosen.
    pub const STEP: f64 = 0.02;
    /// First damping; factors by which it falls after a step that helps, to no less than the third, and rises after one that does not.
    /// Marquardt 1963 begins at 0.01 and takes 1/10 and 10.
    pub const DAMPING: [f64; 4] = [1e-3, 0.2, 1e-6, 10.0];
    /// Steps that are tried in a round. Chosen.
    pub const TRIES: usize = 4;
    /// Large changes of a number that a step makes at most. Chosen.
    pub const FAR: f64 = 2.0;
    /// Candidates that are fitted on the full simulator for each accepted effect. Chosen.
    pub const CANDIDATES: usize = 8;
    /// Starting points of a candidate. Design note, §5.
    pub const STARTS: usize = 8;
    /// Share of a random effect's energy that offsets, gains and locations must hold to stand for it. Chosen.
    pub const HELD: f64 = 0.8;
}

/// Stage `predict`.
pub(crate) mod predict {
    /// Share of what is left between readings and model that counts as systematic at least, where reductions are shares of it. Chosen: noise
    /// that is estimated too high makes no reduction infinite.
    pub const LEAST_GAP: f64 = 0.05;
    /// Share of the gap that effects remove on other contacts at least, if their signature is to be believed beyond that.
    /// Chosen and checked.
    pub const HELPS: f64 = 0.15;
    /// Share of the systematic gap that signatures may explain beyond what effects remove once they are simulated. Chosen and checked.
    pub const APART: f64 = 0.15;
    /// Margins that effects may leave once they are switched on, if their signature is to be believed beyond that: what the model
    /// discrepancy makes up on average is one. Chosen and checked.
    pub const STRETCHED: f64 = 3.0;
    /// What the reduction in another recording of the same device differs by, beyond resampling. Chosen and checked.
    pub const ELSEWHERE: f64 = 0.03;
    /// The same, of effects that depend on the past. Chosen and checked.
    pub const HISTORY: f64 = 0.1;
    /// Relative error of the noise floor. Chosen and checked.
    pub const FLOOR_ERROR: f64 = 0.1;
    /// Resamples of selection and fit for the interval. Chosen.
    pub const RESAMPLES: usize = 16;
}

/// Stage `report`, and what decides whether there is something to explain.
pub(crate) mod report {
    /// Share of the gap below which it is not systematic enough to be explained. Chosen.
    pub const UNSYSTEMATIC: f64 = 0.2;
    /// Share of the systematic gap that effects must explain on other contacts to be named. Design note, §8.
    pub const NAMED: f64 = 0.3;
    /// Share of the systematic gap that named effects may leave: laws are not known better. Chosen and checked.
    pub const REMAINDER: f64 = 0.26;
    /// Share of what single presses leave that must differ between repeats to be a gap of its own. Chosen and checked.
    pub const IRREPRODUCIBLE: f64 = 0.5;
    /// Share of what is left that a smoother must predict for it to be systematic. Design note, §8.
    pub const EXPLAINABLE: f64 = 0.3;
    /// Share of what is left that must be systematic for a smoother to say what of it can be explained. Chosen.
    pub const LEFT: f64 = 0.02;
    /// Share of the gap that a shape must explain for the sentence to name it. Chosen.
    pub const SHAPED: f64 = 0.3;
    /// The same of what names leave. Chosen.
    pub const SHAPE_LEFT: f64 = 0.01;
    /// Share of the gap along an axis from which on the sentence names the axis. Chosen.
    pub const ALONG: f64 = 0.1;
    /// Share of the systematic gap that makes the model discrepancy the verdict. Chosen.
    pub const DISCREPANCY: f64 = 0.5;
    /// Share of the gap below which the fingerprint of what is left is reported. Design note, §8.
    pub const FINGERPRINT: f64 = 0.8;
    /// Share of the gap from which on axes are those of what the named effects make. Chosen.
    pub const EFFECTS_ALONG_AXES: f64 = 0.5;
    /// Correlation of covariates from which on one may be taken for the other. Design note, §8.
    pub const ALIAS: f64 = 0.8;
    /// Effects that are listed as suspects. Chosen.
    pub const SUSPECTS: usize = 5;
}

/// Stage `contest`.
pub(crate) mod contest {
    /// Share of the gap by which a rival must explain more than the named effects to beat them. Calibrated: of 245 simulated devices with a
    /// cause of the library 0.031 at most (`dermis gap calibrate`, seeds 101 and 202).
    pub const BEATEN: f64 = 0.05;
    /// Standard errors over locations by which it must. 99 % of a normal distribution.
    pub const DEVIATIONS: f64 = 2.33;
    /// Share of the gap that may still go with the place beside a firm effect of channels. Calibrated on some twenty development cases of the
    /// barometer row (`dermis gap benchmark generate --skin launch/skins/baro-line.toml`, seeds 771922, 771916 and 771910; `docs/results/gap.md`
    /// has the numbers of cases). No limb or pad was among them, and the figures of that page are of these cases, too.
    pub const PLACE: f64 = 0.15;
    /// Probability of a value under its prior below which no device has it. Chosen: beyond six half widths of what devices have.
    pub const IMPLAUSIBLE: f64 = 0.1;
}

/// What could be explained at all.
pub(crate) mod explainability {
    /// Samples that are predicted, at most. Chosen.
    pub const PREDICTED: usize = 800;
    /// Samples that predict, at most. Chosen.
    pub const KNOWN: usize = 4000;
    /// Neighbours. Chosen.
    pub const NEAREST: usize = 6;
    /// \[N\] below which a force does not scale what is predicted. Chosen.
    pub const FORCE: f64 = 0.02;
    /// \[s\] after contact before which the logarithm of the time does not change. Chosen.
    pub const FIRST_SINCE: f64 = 1e-3;
    /// Added to squared distances of neighbours, whose inverses are their weights: equal samples weigh no more than 1000. Chosen.
    pub const SOFTENING: f64 = 1e-3;
    /// Weights of place (three), force, phase, time since contact, temperature, session time, history. Chosen.
    pub const WEIGHTS: [f64; 9] = [3.0, 3.0, 3.0, 1.0, 1.0, 1.0, 1.0, 0.5, 1.0];
}

/// Next experiments.
pub(crate) mod experiments {
    /// Share of a reading that a simulator is wrong by in ways that nobody knows. Chosen.
    pub const TRUST: f64 = 0.02;
    /// Probability of confusion below which an experiment settles a question. Design note, §7.
    pub const SETTLED: f64 = 0.01;
    /// Experiments that are listed. Chosen.
    pub const LISTED: usize = 5;
}

/// 95 % and 90 % of a normal distribution, half widths in standard deviations.
pub(crate) const Z95: f64 = 1.96;
/// See [`Z95`].
pub(crate) const Z90: f64 = 1.645;
