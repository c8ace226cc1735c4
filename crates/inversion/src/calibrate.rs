//! How far a device and its forward model are apart.

use dermis_model::{ForwardModel, Indentation, Stimulus, Unknowns, Untouched};
use dermis_skin::ModelError;

use crate::fit::{Datum, LEAST_GAIN, Problem, STRIDE};

/// Channel gains and what remains beyond the noise, measured on readings of known stimuli.
#[derive(Debug, Clone, PartialEq)]
pub struct Calibration {
    /// Reading of the device per reading of the model, one a channel.
    pub gains: Vec<f64>,
    /// Share of a signal by which they still differ (standard deviation).
    pub model_error: f64,
    /// Frames that were used.
    pub frames: usize,
}

/// Why there is no calibration.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CalibrationError {
    /// Too little was seen.
    #[error(
        "channel {channel} was never pressed hard enough to measure its gain; press over all of the skin"
    )]
    Unseen {
        /// Index of the channel.
        channel: usize,
    },
    /// The model has no answer.
    #[error("the forward model has no answer: {0}")]
    Model(#[from] ModelError),
}

/// Signals count for gains from this many noise deviations on.
const STRONG: f64 = 5.0;
/// Least number of such signals of a channel.
const FEWEST: usize = 10;
/// Frames that are fitted at most; of more, every n-th is.
const MOST: usize = 400;
/// Sum of squared deviations over its expectation up to which the noise explains what remains.
const CHANCE: f64 = 1.05;
/// Least and largest error of a model that is looked for, and halvings of the interval.
const ERRORS: (f64, f64, usize) = (1e-4, 0.5, 12);

/// Share of the surface up to which a channel that only presses there tell may go without a gain.
const QUIET: f64 = 0.02;
/// Locations that say so, at most.
const LOCATIONS: usize = 500;

/// One labelled frame.
struct Labelled<'a> {
    stimulus: &'a Stimulus,
    signal: &'a [f32],
    /// Signal of the model for the label.
    expected: Vec<f64>,
}

impl Calibration {
    /// Measures on pairs of a stimulus and what the channels read minus their untouched readings (`NaN`: not known), in the
    /// unit of the skin.
    ///
    /// Gains are taken at the labels. A force cell and a stage are off, though, which must not count against the model: its
    /// error is the one with which the contacts that fit best, near the labelled ones, leave as much as can be expected.
    ///
    /// # Errors
    ///
    /// [`CalibrationError`] names the channel that was never pressed.
    pub fn measure<'a>(
        model: &dyn ForwardModel,
        unknowns: Unknowns,
        frames: impl Iterator<Item = (&'a Stimulus, &'a [f32])>,
    ) -> Result<Self, CalibrationError> {
        Self::of(model, unknowns, true, frames)
    }

    /// [`measure`](Self::measure) where channels have no gains of their own, as the numbers of a picture: their gains are 1.
    ///
    /// # Errors
    ///
    /// [`CalibrationError::Model`] where the model has no answer.
    pub fn without_gains<'a>(
        model: &dyn ForwardModel,
        unknowns: Unknowns,
        frames: impl Iterator<Item = (&'a Stimulus, &'a [f32])>,
    ) -> Result<Self, CalibrationError> {
        Self::of(model, unknowns, false, frames)
    }

    fn of<'a>(
        model: &dyn ForwardModel,
        unknowns: Unknowns,
        with_gains: bool,
        frames: impl Iterator<Item = (&'a Stimulus, &'a [f32])>,
    ) -> Result<Self, CalibrationError> {
        let channels = model.channels();
        let noise = model.noise();
        let untouched = Untouched::of(model)?;
        let mut all = Vec::new();
        for (stimulus, signal) in frames {
            if signal.iter().zip(noise).any(|(v, n)| f64::from(*v).abs() > 2.0 * STRONG * n) {
                let mut expected = vec![0.0; channels];
                model.response(stimulus, &mut expected)?;
                untouched.subtract(&mut expected);
                all.push(Labelled { stimulus, signal, expected });
            }
        }
        let contacts = || all.iter().flat_map(|f| &f.stimulus.contacts);
        let force_max = contacts().map(|c| c.force.norm()).fold(0.0, f64::max);
        let diameter = contacts().map(Indentation::diameter).fold(0.0, f64::max);
        let mut shares: Option<Vec<f64>> = None;
        let mut responds = |channel| {
            if shares.is_none() {
                shares = Some(responding(model, &untouched, force_max, diameter)?);
            }
            Ok(shares.as_ref().and_then(|all| all.get(channel)).is_some_and(|share| *share > QUIET))
        };
        let gains = if with_gains { gains(&all, noise, &mut responds)? } else { vec![1.0; channels] };
        let fits = Fits { model, unknowns, gains: &gains, untouched: &untouched, force_max: force_max * 2.0 };
        // A zero that is off shows in weak and strong signals alike; what grows with the signal is the model's error.
        let strongest = |f: &Labelled<'_>| f.signal.iter().map(|v| v.abs()).fold(0.0f32, f32::max);
        all.sort_by(|a, b| strongest(a).total_cmp(&strongest(b)));
        let third = all.len() / 3;
        let (weak, strong) = (some(&all[..third]), some(&all[all.len() - third..]));
        let scale = fits.excess(&weak, 1.0, 0.0)?.sqrt().max(1.0);
        let mut error = 0.0;
        if fits.excess(&strong, scale, 0.0)? > CHANCE {
            error = model_error(|error| Ok::<_, ModelError>(fits.excess(&strong, scale, error)? > 1.0))?;
        }
        Ok(Self { gains, model_error: error, frames: all.len() })
    }
}

/// Smallest error of a model for which what is left does not exceed what can be expected.
pub(crate) fn model_error<E>(mut exceeds: impl FnMut(f64) -> Result<bool, E>) -> Result<f64, E> {
    let (mut low, mut high, halvings) = ERRORS;
    for _ in 0..halvings {
        let middle = f64::sqrt(low * high);
        if exceeds(middle)? {
            low = middle;
        } else {
            high = middle;
        }
    }
    Ok(f64::sqrt(low * high))
}

/// Fits of contacts to labelled frames.
struct Fits<'a> {
    model: &'a dyn ForwardModel,
    unknowns: Unknowns,
    gains: &'a [f64],
    untouched: &'a Untouched,
    force_max: f64,
}

impl Fits<'_> {
    /// Sum of squared deviations over what is expected, if the noise is `scale` times what it should be and the model is off by
    /// `error`.
    fn excess(&self, frames: &[&Labelled<'_>], scale: f64, error: f64) -> Result<f64, ModelError> {
        let (mut chi2, mut expected) = (0.0, 0.0);
        for frame in frames {
            let datum = |(v, n): (&f32, &f64)| {
                let v = f64::from(*v);
                if v.is_finite() { Datum::Exact(v, 1.0 / (scale * n).hypot(error * v)) } else { Datum::None }
            };
            let data: Vec<Datum> = frame.signal.iter().zip(self.model.noise()).map(datum).collect();
            let known = data.iter().filter(|d| **d != Datum::None).count();
            let problem = Problem {
                model: self.model,
                unknowns: self.unknowns,
                data: &data,
                gains: self.gains,
                untouched: self.untouched,
                force_max: self.force_max,
                stride: STRIDE,
                shear: None,
                keeps: false,
                least_gain: LEAST_GAIN,
                by_differences: false,
            };
            let fit = problem.minimise(frame.stimulus.contacts.clone())?;
            let freedom = known.saturating_sub(self.unknowns.count() * fit.contacts.len()) as f64;
            // A frame that nothing explains must not stand for all.
            chi2 += fit.chi2.min(10.0 * freedom);
            expected += freedom;
        }
        Ok(if expected > 0.0 { chi2 / expected } else { 0.0 })
    }
}

/// At most [`MOST`] of them, evenly.
fn some<'b, 'a>(frames: &'b [Labelled<'a>]) -> Vec<&'b Labelled<'a>> {
    frames.iter().step_by(frames.len().div_ceil(MOST).max(1)).collect()
}

/// Share of the surface, channel by channel, where a press of `force` \[N\] by a tip of `diameter` \[m\] counts for gains.
fn responding(
    model: &dyn ForwardModel,
    untouched: &Untouched,
    force: f64,
    diameter: f64,
) -> Result<Vec<f64>, ModelError> {
    let (surface, noise) = (model.surface(), model.noise());
    let step = surface.points.len().div_ceil(LOCATIONS).max(1);
    let locations: Vec<_> = surface.points.iter().zip(&surface.normals).step_by(step).collect();
    let (mut shares, mut out) = (vec![0.0; noise.len()], vec![0.0; noise.len()]);
    for (position, normal) in &locations {
        let contacts = vec![Indentation::sphere(**position, -**normal * force, diameter)];
        model.response(&Stimulus { contacts, ..Stimulus::default() }, &mut out)?;
        untouched.subtract(&mut out);
        for ((share, signal), noise) in shares.iter_mut().zip(&out).zip(noise) {
            *share += if signal.abs() > STRONG * noise { 1.0 / locations.len() as f64 } else { 0.0 };
        }
    }
    Ok(shares)
}

/// Least squares of what is read over what is expected, drawn towards 1 by what noise makes of it (W. James and C. Stein, 1961): strong
/// presses, whose force is known best, count most. A channel that was never pressed, and hardly `responds` to any press, has a gain of 1.
fn gains(
    frames: &[Labelled<'_>],
    noise: &[f64],
    responds: &mut dyn FnMut(usize) -> Result<bool, ModelError>,
) -> Result<Vec<f64>, CalibrationError> {
    let channels = noise.len();
    let strong = |frame: &Labelled<'_>, i: usize| {
        frame.signal[i].is_finite() && frame.expected[i].abs() > STRONG * noise[i]
    };
    let seen = |i: usize| frames.iter().filter(|f| strong(f, i)).count();
    let mut quiet = vec![false; channels];
    for (channel, quiet) in quiet.iter_mut().enumerate().filter(|(i, _)| seen(*i) < FEWEST) {
        if responds(channel)? {
            return Err(CalibrationError::Unseen { channel });
        }
        *quiet = true;
    }
    Ok((0..channels)
        .map(|i| {
            if quiet[i] {
                return 1.0;
            }
            let (mut product, mut square) = (0.0, 0.0);
            for frame in frames.iter().filter(|f| strong(f, i)) {
                product += f64::from(frame.signal[i]) * frame.expected[i];
                square += frame.expected[i].powi(2);
            }
            // Of very many channels each is pressed rarely: what noise says of its gain would make it worse than 1.
            let off = product / square - 1.0;
            let chance = noise[i].powi(2) / square;
            1.0 + off * (1.0 - chance / off.powi(2).max(f64::MIN_POSITIVE)).max(0.0)
        })
        .collect())
}

#[cfg(test)]
mod tests {
    use rand::Rng;

    use rand_distr::{Distribution, StandardNormal};

    use super::*;
    use crate::testing::{grid, press, random};

    /// Presses all over the grid, whose device has these gains and an error of its own in proportion to the signal; labels
    /// are off by what a stage and a force cell are off by.
    fn recording(gains: &[f64], error: f64) -> Vec<(Stimulus, Vec<f32>)> {
        let model = grid(20.0);
        let mut random = random(7);
        (0..400)
            .map(|_| {
                let (x, y) = (random.random_range(-0.015..0.015), random.random_range(-0.015..0.015));
                let force: f64 = random.random_range(0.1..1.5);
                let stimulus = Stimulus { contacts: vec![press(x, y, force)], ..Stimulus::default() };
                let signal = model
                    .read(&stimulus.contacts)
                    .iter()
                    .zip(gains)
                    .map(|(v, gain)| {
                        let noise: f64 = StandardNormal.sample(&mut random);
                        (v * gain * (1.0 + error * random.random_range(-1.7..1.7)) + 20.0 * noise) as f32
                    })
                    .collect();
                let label = press(x + 1e-5, y - 1e-5, force + random.random_range(-0.007..0.007));
                (Stimulus { contacts: vec![label], ..Stimulus::default() }, signal)
            })
            .collect()
    }

    fn measured(recording: &[(Stimulus, Vec<f32>)]) -> Calibration {
        let frames = recording.iter().map(|(s, v)| (s, v.as_slice()));
        Calibration::measure(&grid(20.0), Unknowns::Normal, frames).unwrap()
    }

    fn without_gains(recording: &[(Stimulus, Vec<f32>)]) -> Calibration {
        let frames = recording.iter().map(|(s, v)| (s, v.as_slice()));
        Calibration::without_gains(&grid(20.0), Unknowns::Normal, frames).unwrap()
    }

    #[test]
    fn gains_are_found_although_labels_are_off() {
        let gains: Vec<f64> = (0..25).map(|i| 1.1 + 0.02 * f64::from(i % 5)).collect();
        let found = measured(&recording(&gains, 0.0));
        for (found, gain) in found.gains.iter().zip(&gains) {
            assert!((found / gain - 1.0).abs() < 0.01, "{found} is not {gain}");
        }
        assert!(found.model_error < 3e-3, "{}", found.model_error);
    }

    #[test]
    fn what_the_model_does_not_explain_is_its_error() {
        let error = measured(&recording(&[1.0; 25], 0.03)).model_error;
        assert!((0.02..0.04).contains(&error), "{error}");
    }

    #[test]
    fn without_gains_what_they_are_off_by_is_the_model_s_error() {
        // One gain of all is a force: it is only what they differ by that no contact explains.
        let even = without_gains(&recording(&[1.05; 25], 0.0));
        assert_eq!(even.gains, [1.0; 25]);
        assert!(even.model_error < 0.01, "{}", even.model_error);
        let uneven: Vec<f64> = (0..25).map(|i| 1.0 + 0.05 * f64::from(i % 2)).collect();
        let error = without_gains(&recording(&uneven, 0.0)).model_error;
        assert!((0.01..0.05).contains(&error), "{error}");
    }

    #[test]
    fn frames_count_from_ten_deviations_of_the_noise_on() {
        let frames = |strongest: f32| {
            let mut signal = vec![0.0; 25];
            signal[12] = strongest;
            let stimulus = Stimulus { contacts: vec![press(0.0, 0.0, 0.2)], ..Stimulus::default() };
            without_gains(&[(stimulus, signal)]).frames
        };
        assert_eq!([199.0, 201.0, -201.0].map(frames), [0, 1, 1]);
    }

    #[test]
    fn noise_that_is_larger_than_declared_is_no_error_of_the_model() {
        let mut recording = recording(&[1.0; 25], 0.0);
        let mut random = random(8);
        for value in recording.iter_mut().flat_map(|(_, signal)| signal) {
            let noise: f64 = StandardNormal.sample(&mut random);
            // Three times the noise of the model, with what is there.
            *value += (8f64.sqrt() * 20.0 * noise) as f32;
        }
        let found = measured(&recording);
        assert!(found.model_error < 3e-3, "{}", found.model_error);
    }

    #[test]
    fn frames_that_nothing_explains_do_not_stand_for_all() {
        let mut recording = recording(&[1.0; 25], 0.03);
        for (_, signal) in recording.iter_mut().step_by(50) {
            signal.iter_mut().step_by(2).for_each(|v| *v *= -1.0);
        }
        let found = without_gains(&recording);
        assert!((0.02..0.06).contains(&found.model_error), "{}", found.model_error);
    }

    #[test]
    fn a_press_that_fits_best_may_be_stronger_than_any_label() {
        // A force cell that says two thirds of what there is: no error of the model.
        let mut recording = recording(&[1.0; 25], 0.0);
        for (stimulus, _) in &mut recording {
            stimulus.contacts.iter_mut().for_each(|c| c.force *= 2.0 / 3.0);
        }
        let found = without_gains(&recording);
        assert!(found.model_error < 3e-3, "{}", found.model_error);
    }

    #[test]
    fn a_channel_that_hardly_any_press_tells_keeps_the_gain_of_its_design() {
        let model = grid(20.0);
        let untouched = Untouched::of(&model).unwrap();
        // So light that the strongest press is lost in the noise of every channel.
        let silent = responding(&model, &untouched, 1e-4, 0.004).unwrap();
        assert_eq!(silent, [0.0; 25]);
        let loud = responding(&model, &untouched, 1.5, 0.004).unwrap();
        assert!(loud.iter().all(|share| *share > QUIET), "{loud:?}");
        let found = gains(&[], &[1.0; 2], &mut |_| Ok(false)).unwrap();
        assert_eq!(found, [1.0; 2]);
    }

    #[test]
    fn a_channel_that_was_never_pressed_is_named() {
        let mut recording = recording(&[1.0; 25], 0.0);
        for (_, signal) in &mut recording {
            signal[3] = f32::NAN;
        }
        let frames = recording.iter().map(|(s, v)| (s, v.as_slice()));
        let error = Calibration::measure(&grid(20.0), Unknowns::Normal, frames).unwrap_err();
        insta::assert_snapshot!(error, @"channel 3 was never pressed hard enough to measure its gain; press over all of the skin");
    }
}
