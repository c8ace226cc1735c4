//! A plan without an end: it is carried out round after round, with another seed each time.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use dermis_model::ForwardModel;
use dermis_skin::Stamp;

use crate::{GroundTruth, Plan, TestbedError, Timeline};

pub(super) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // What a panicking thread left behind is still a list of timelines.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A plan that is carried out again and again, with another seed each time.
pub(super) struct Script {
    pub(super) plan: Plan,
    pub(super) model: Arc<dyn ForwardModel>,
    pub(super) seed: u64,
    pub(super) start: Stamp,
    pub(super) rounds: Mutex<Rounds>,
}

/// The last rounds of a script.
pub(super) struct Rounds {
    /// How many there were.
    pub(super) count: u64,
    /// Start \[s\] and timeline of each.
    pub(super) last: VecDeque<(f64, Arc<Timeline>)>,
}

/// Rounds of a plan that a device keeps.
pub(super) const ROUNDS: usize = 4;

impl Script {
    pub(super) fn new(plan: Plan, model: Arc<dyn ForwardModel>, seed: u64) -> Result<Self, TestbedError> {
        let first = Arc::new(Timeline::new(&plan, &model, seed)?);
        Ok(Self {
            plan,
            model,
            seed,
            start: 0,
            rounds: Mutex::new(Rounds { count: 1, last: VecDeque::from([(0.0, first)]) }),
        })
    }

    /// The first moment of full force.
    pub(super) fn first_touch(&self) -> GroundTruth {
        lock(&self.rounds).last.front().map(|(_, timeline)| timeline.first_touch()).unwrap_or_default()
    }

    /// What happens `t` \[s\] after the start; `None` before it, and for rounds that are no longer kept.
    pub(super) fn at(&self, t: f64) -> Result<Option<GroundTruth>, TestbedError> {
        let (begin, timeline) = {
            let mut rounds = lock(&self.rounds);
            while let Some((begin, last)) = rounds.last.back()
                && t >= begin + last.duration()
            {
                let next = begin + last.duration();
                let timeline = Timeline::new(&self.plan, &self.model, self.seed.wrapping_add(rounds.count))?;
                rounds.count += 1;
                rounds.last.push_back((next, Arc::new(timeline)));
                if rounds.last.len() > ROUNDS {
                    rounds.last.pop_front();
                }
            }
            match rounds.last.iter().rev().find(|(begin, _)| *begin <= t) {
                Some((begin, timeline)) => (*begin, Arc::clone(timeline)),
                None => return Ok(None),
            }
        };
        Ok(Some(timeline.at(t - begin)))
    }
}
