//! Least squares: contacts near a start that explain readings best.

use dermis_model::{
    Differences, ForwardModel, Indentation, MovedForce, Stimulus, Unknown, Unknowns, Untouched, tangents,
};
use dermis_skin::ModelError;
use nalgebra::{DMatrix, DVector, Vector3};

/// \[m\] by which a place is moved for its derivative.
const MOVE: f64 = 2e-5;
/// Share of a force by which it is changed for its derivative.
const CHANGE: f64 = 1e-3;
/// \[N\] by which a force is changed at least.
const LEAST_CHANGE: f64 = 1e-5;
/// The same where derivatives are differences of responses: pictures of 32-bit numbers do not tell smaller ones.
const WIDE_MOVE: f64 = 1e-4;
const WIDE_CHANGE: f64 = 0.05;
const WIDE_LEAST_CHANGE: f64 = 1e-3;
/// \[N\] of the lightest press.
const LIGHTEST: f64 = 1e-4;
/// \[m\] farthest that a place moves in one step, on skins of a hand's width.
pub(crate) const STRIDE: f64 = 3e-3;
/// What a step gains at the least that there is another, far below what noise does.
pub(crate) const LEAST_GAIN: f64 = 1e-4;
/// Share by which a step may gain more or less than derivatives say for these to be kept.
const KEPT: f64 = 0.25;
/// Steps at most.
const STEPS: usize = 25;

/// What one channel says.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Datum {
    /// Its signal, and one over its standard deviation.
    Exact(f64, f64),
    /// The signal is this or more: the channel is at the upper end of its range.
    AtLeast(f64, f64),
    /// The signal is this or less.
    AtMost(f64, f64),
    /// Nothing.
    None,
}

impl Datum {
    /// With its value and weight as `of` makes them.
    pub(crate) fn map(self, of: impl FnOnce(f64, f64) -> (f64, f64)) -> Self {
        let (kind, v, w): (fn(f64, f64) -> Self, f64, f64) = match self {
            Self::Exact(v, w) => (Self::Exact, v, w),
            Self::AtLeast(v, w) => (Self::AtLeast, v, w),
            Self::AtMost(v, w) => (Self::AtMost, v, w),
            Self::None => return Self::None,
        };
        let (v, w) = of(v, w);
        kind(v, w)
    }

    /// What is left of the reading where something else makes `signal` of it.
    pub(crate) fn less(self, signal: f64) -> Self {
        self.map(|v, w| (v - signal, w))
    }

    /// Square of the reading in units of its noise; 0 where there is none.
    pub(crate) fn square(self) -> f64 {
        match self {
            Self::Exact(v, w) | Self::AtLeast(v, w) | Self::AtMost(v, w) => (v * w).powi(2),
            Self::None => 0.0,
        }
    }

    /// Deviation of the reading from `model` in standard deviations, and its derivative by the model's value.
    pub(crate) fn residual(self, model: f64) -> (f64, f64) {
        match self {
            Self::Exact(value, weight) => ((value - model) * weight, -weight),
            Self::AtLeast(value, weight) if model < value => ((value - model) * weight, -weight),
            Self::AtMost(value, weight) if model > value => ((value - model) * weight, -weight),
            _ => (0.0, 0.0),
        }
    }
}

/// A least-squares problem.
pub(crate) struct Problem<'a> {
    pub model: &'a dyn ForwardModel,
    pub unknowns: Unknowns,
    pub data: &'a [Datum],
    /// Reading of the device per reading of the model, one a channel.
    pub gains: &'a [f64],
    /// Untouched readings of the model.
    pub untouched: &'a Untouched,
    pub force_max: f64,
    /// \[m\] farthest that a place moves in one step.
    pub stride: f64,
    /// Standard deviation of shear along each direction over the pressing force, before the readings; any where absent.
    pub shear: Option<f64>,
    /// Whether derivatives are kept for as long as steps gain what they say (the chord method): where they cost more than responses do.
    pub keeps: bool,
    /// What a step gains of the sum of squared deviations, in units of the noise, at the least that there is another.
    pub least_gain: f64,
    /// Whether derivatives are differences of responses, whatever the model knows of them: those of a model may be so rough that a search ends on
    /// a slope.
    pub by_differences: bool,
}

/// A minimum.
#[derive(Debug, Clone)]
pub(crate) struct Minimum {
    pub contacts: Vec<Indentation>,
    pub chi2: f64,
    /// Inverse of JᵀJ over all unknowns, contact by contact; `None` where the readings do not fix them.
    pub covariance: Option<DMatrix<f64>>,
    /// Signal of the model, one a channel.
    pub signal: Vec<f64>,
}

impl Minimum {
    /// Of no contact.
    pub fn untouched(data: &[Datum]) -> Self {
        let signal = vec![0.0; data.len()];
        Self { contacts: Vec::new(), chi2: sum_of_squares(data), covariance: None, signal }
    }
}

/// Sum of the squares of readings in units of their noise.
pub(crate) fn sum_of_squares(data: &[Datum]) -> f64 {
    data.iter().map(|datum| datum.square()).sum()
}

/// Contacts on the way to a minimum, and what the model says of them.
struct Iterate {
    contacts: Vec<Indentation>,
    signal: Vec<f64>,
    chi2: f64,
    /// Room for the signal of a step.
    spare: Vec<f64>,
}

/// Derivatives of the residuals by every unknown.
struct Slopes {
    jacobian: DMatrix<f64>,
    normal_matrix: DMatrix<f64>,
    /// Derivative of each residual by the model's value.
    weights: Vec<f64>,
    /// Whether they are those of a place near by, and readings still count as they did there.
    kept: bool,
}

impl Slopes {
    fn new(channels: usize, unknowns: usize) -> Self {
        Self {
            jacobian: DMatrix::zeros(channels, unknowns),
            normal_matrix: DMatrix::zeros(unknowns, unknowns),
            weights: vec![0.0; channels],
            kept: false,
        }
    }
}

/// Normal equations of one step.
struct Equations {
    matrix: DMatrix<f64>,
    gradient: DVector<f64>,
    /// \[N\] standard deviation of the shear of each contact before the readings.
    expected: Vec<f64>,
}

impl Problem<'_> {
    /// Signal (gains included) of these contacts.
    pub fn signal(&self, contacts: &[Indentation], out: &mut [f64]) -> Result<(), ModelError> {
        let stimulus = Stimulus { contacts: contacts.to_vec(), ..Stimulus::default() };
        self.model.response(&stimulus, out)?;
        self.untouched.subtract(out);
        out.iter_mut().zip(self.gains).for_each(|(value, gain)| *value *= gain);
        Ok(())
    }

    /// Sum of squared deviations of the readings from a signal, in units of their noise.
    pub fn chi2(&self, signal: &[f64]) -> f64 {
        self.data.iter().zip(signal).map(|(datum, model)| datum.residual(*model).0.powi(2)).sum()
    }

    /// How unknowns are moved for derivatives.
    fn differences(&self) -> Differences {
        Differences {
            place: MOVE,
            force: CHANGE,
            least_force: LEAST_CHANGE,
            pressing: [LIGHTEST, self.force_max],
            moved_force: MovedForce::Turned,
        }
    }

    /// Levenberg–Marquardt from `start` (K. Levenberg 1944, D. W. Marquardt 1963), every step kept on the surface and
    /// between no force and the largest.
    pub fn minimise(&self, start: Vec<Indentation>) -> Result<Minimum, ModelError> {
        let channels = self.data.len();
        let mut signal = vec![0.0; channels];
        self.signal(&start, &mut signal)?;
        let chi2 = self.chi2(&signal);
        let mut slopes = Slopes::new(channels, self.unknowns.list().len() * start.len());
        let mut at = Iterate { contacts: start, signal, chi2, spare: vec![0.0; channels] };
        let mut damping = 1e-3;
        for step in 0..STEPS {
            let Some(residuals) = self.linearise(&at, &mut slopes) else { break };
            let equations = self.equations(&at.contacts, &slopes, &residuals);
            if step + 1 == STEPS {
                slopes.normal_matrix = equations.matrix;
                break;
            }
            let Some(promised) = self.step(&mut at, &equations, slopes.kept, &mut damping) else {
                slopes.normal_matrix = equations.matrix;
                break;
            };
            slopes.kept = self.keeps && promised;
            if !slopes.kept {
                slopes.normal_matrix = equations.matrix;
            }
        }
        let covariance = slopes.normal_matrix.cholesky().map(|f| f.inverse());
        Ok(Minimum { contacts: at.contacts, chi2: at.chi2, covariance, signal: at.signal })
    }

    /// Residuals at these contacts; their derivatives go to `slopes`, unless those that are there still hold. `None` where the model
    /// has no derivatives.
    fn linearise(&self, at: &Iterate, slopes: &mut Slopes) -> Option<DVector<f64>> {
        let channels = self.data.len();
        let mut residuals = DVector::zeros(channels);
        let mut now = vec![0.0; channels];
        for (i, (datum, model)) in self.data.iter().zip(&at.signal).enumerate() {
            (residuals[i], now[i]) = datum.residual(*model);
        }
        slopes.kept &= now == slopes.weights;
        if !slopes.kept {
            slopes.weights = now;
            // Derivatives of the residuals by every unknown.
            let stimulus = Stimulus { contacts: at.contacts.clone(), ..Stimulus::default() };
            let out = slopes.jacobian.as_mut_slice();
            // Beside an edge of the surface, where its normal jumps, a sheared contact may pull at its neighbours' locations: as far as here
            // the model knows an answer.
            let known = if self.by_differences {
                let wide = Differences {
                    place: WIDE_MOVE,
                    force: WIDE_CHANGE,
                    least_force: WIDE_LEAST_CHANGE,
                    ..self.differences()
                };
                wide.jacobian(self.model, &stimulus, self.unknowns, out)
            } else {
                self.model.jacobian(&stimulus, self.unknowns, &self.differences(), out)
            };
            if known.is_err() {
                return None;
            }
            for mut column in slopes.jacobian.column_iter_mut() {
                for ((slope, weight), gain) in column.iter_mut().zip(&slopes.weights).zip(self.gains) {
                    *slope *= weight * gain;
                }
            }
            slopes.normal_matrix = slopes.jacobian.tr_mul(&slopes.jacobian);
        }
        Some(residuals)
    }

    /// The normal equations of the next step, with the prior's part.
    fn equations(&self, contacts: &[Indentation], slopes: &Slopes, residuals: &DVector<f64>) -> Equations {
        let mut gradient = slopes.jacobian.tr_mul(residuals);
        let expected = self.expected_shears(contacts);
        let mut matrix = slopes.normal_matrix.clone();
        self.add_prior(contacts, &expected, &mut matrix, &mut gradient);
        Equations { matrix, gradient, expected }
    }

    /// Goes to where damped equations lead and the sum of squares is less. Whether that gains what derivatives say, so that they can be
    /// kept; `None` where there is nothing left to gain. `kept` says whether derivatives are those of a place near by.
    fn step(
        &self,
        at: &mut Iterate,
        Equations { matrix, gradient, expected }: &Equations,
        kept: bool,
        damping: &mut f64,
    ) -> Option<bool> {
        let list = self.unknowns.list();
        let before = at.chi2 + self.penalty(&at.contacts, expected);
        for _ in 0..8 {
            let mut damped = matrix.clone();
            for d in 0..damped.nrows() {
                let diagonal = damped[(d, d)];
                damped[(d, d)] = diagonal * (1.0 + *damping) + 1e-30;
            }
            let Some(factor) = damped.cholesky() else {
                *damping *= 10.0;
                continue;
            };
            let change = -factor.solve(gradient);
            let changes = change.as_slice().chunks_exact(list.len());
            let moved = at.contacts.iter().zip(changes);
            let tried: Vec<Indentation> = moved.map(|(c, change)| self.stepped(c, list, change)).collect();
            let now = match self.signal(&tried, &mut at.spare) {
                Ok(()) => self.chi2(&at.spare),
                // For the same reason: a shorter step.
                Err(_) => f64::INFINITY,
            };
            let after = now + self.penalty(&tried, expected);
            if after < before {
                let gain = before - after;
                // What the step gains by these derivatives.
                let promised = -2.0 * gradient.dot(&change) - change.dot(&(matrix * &change));
                at.contacts = tried;
                std::mem::swap(&mut at.signal, &mut at.spare);
                at.chi2 = now;
                *damping = (*damping * 0.1).max(1e-9);
                // What is left to gain is far below what noise does.
                return (gain > self.least_gain).then_some((gain - promised).abs() < KEPT * promised);
            }
            // Derivatives of another place lead nowhere from here.
            if kept {
                return Some(false);
            }
            *damping *= 10.0;
        }
        None
    }

    /// \[N\] standard deviation of the shear of each contact before the readings; infinite where any is as likely. The pressing force that
    /// it is a share of is that of now: readings alone decide about that.
    fn expected_shears(&self, contacts: &[Indentation]) -> Vec<f64> {
        let Some(share) = self.shear else { return vec![f64::INFINITY; contacts.len()] };
        contacts.iter().map(|c| share * self.split(c).0.max(LIGHTEST)).collect()
    }

    /// \[N\] pressing force and shear along both directions.
    fn split(&self, contact: &Indentation) -> (f64, [f64; 2]) {
        let (_, normal) = self.model.surface().project(&contact.position);
        (-contact.force.dot(&normal), tangents(&normal).map(|axis| contact.force.dot(&axis)))
    }

    /// Squares of shears over what is expected.
    fn penalty(&self, contacts: &[Indentation], expected: &[f64]) -> f64 {
        if self.shear.is_none() {
            return 0.0;
        }
        let one = |(contact, expected): (&Indentation, &f64)| {
            self.split(contact).1.iter().map(|shear| (shear / expected).powi(2)).sum::<f64>()
        };
        contacts.iter().zip(expected).map(one).sum()
    }

    /// Adds the prior's part to the normal equations.
    fn add_prior(
        &self,
        contacts: &[Indentation],
        expected: &[f64],
        normal_matrix: &mut DMatrix<f64>,
        gradient: &mut DVector<f64>,
    ) {
        if self.shear.is_none() {
            return;
        }
        let list = self.unknowns.list();
        for (c, (contact, expected)) in contacts.iter().zip(expected).enumerate() {
            let shears = self.split(contact).1;
            for (k, unknown) in list.iter().enumerate() {
                if let Unknown::Shear(axis) = unknown {
                    let place = c * list.len() + k;
                    normal_matrix[(place, place)] += 1.0 / expected.powi(2);
                    gradient[place] += shears[*axis] / expected.powi(2);
                }
            }
        }
    }

    /// A contact that is moved along the surface by `stride` \[m\], and its force turned with the surface.
    pub fn shifted(&self, contact: &Indentation, stride: &Vector3<f64>) -> Indentation {
        self.differences().shifted(self.model.surface(), contact, self.unknowns, stride)
    }

    /// A contact after one step in all of its unknowns.
    fn stepped(&self, contact: &Indentation, list: &[Unknown], change: &[f64]) -> Indentation {
        let surface = self.model.surface();
        let differences = self.differences();
        let (_, normal) = surface.project(&contact.position);
        let axes = tangents(&normal);
        let mut stride = Vector3::zeros();
        let mut force = contact.clone();
        for (unknown, by) in list.iter().zip(change) {
            match unknown {
                Unknown::Along(k) => stride += axes[*k] * *by,
                _ => force = differences.moved(surface, &force, self.unknowns, *unknown, *by).0,
            }
        }
        let length = stride.norm();
        if length > self.stride {
            stride *= self.stride / length;
        }
        differences.shifted(surface, &force, self.unknowns, &stride)
    }
}
