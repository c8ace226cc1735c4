//! Searches on a forward model that frames do not wait for.
//!
//! A search for contacts takes as long as some frames of a fast skin, or some dozens where there are several, and least squares from the contacts
//! of the frame before take less than one. So it runs on a thread of its own, one at a time and on the newest frame of when it began. What it
//! finds is where the next frame begins. Cost: a copy of the readings and a thread, which waits while no search runs and ends with the estimator.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, TryRecvError, channel};

use dermis_inversion::{ContactEstimate, Inverter, InverterError, Reading, Solution};
use dermis_skin::Contact;

use crate::finder::{Learned, search};

/// A search, with all that it needs.
pub(super) struct Job {
    inverter: Arc<Inverter>,
    readings: Vec<Reading>,
    learned: Vec<Contact>,
    complete: bool,
    before: Vec<ContactEstimate>,
}

impl Job {
    pub(super) fn of(
        inverter: &Arc<Inverter>,
        readings: &[Reading],
        learned: Learned<'_>,
        before: &[ContactEstimate],
    ) -> Self {
        Self {
            inverter: Arc::clone(inverter),
            readings: readings.to_vec(),
            learned: learned.contacts.to_vec(),
            complete: learned.complete,
            before: before.to_vec(),
        }
    }

    pub(super) fn search(&self) -> Result<Solution, InverterError> {
        let learned = Learned { contacts: &self.learned, complete: self.complete };
        search(&self.inverter, &self.readings, learned, &self.before)
    }
}

type Found = Result<Solution, InverterError>;

/// The thread, from the first search on, and what it works on.
#[derive(Default)]
pub(super) struct BackgroundSearch {
    thread: Option<(Sender<Job>, Receiver<Found>)>,
    searching: bool,
    /// A search has ended since contacts were forgotten.
    ended: bool,
    /// The search that runs is for contacts that are gone: its answer does not count.
    stale: bool,
}

impl BackgroundSearch {
    /// What a search has found, once, after it has ended.
    pub(super) fn found(&mut self) -> Option<Found> {
        let (_, found) = self.thread.as_ref().filter(|_| self.searching)?;
        let answer = match found.try_recv() {
            Ok(answer) => Some(answer),
            Err(TryRecvError::Empty) => return None,
            Err(TryRecvError::Disconnected) => {
                self.thread = None;
                None
            }
        };
        self.searching = false;
        let answer = answer.filter(|_| !std::mem::take(&mut self.stale));
        self.ended |= answer.is_some();
        answer
    }

    pub(super) fn is_searching(&self) -> bool {
        self.searching
    }

    /// Whether no search has ended since contacts were forgotten: what is known of these is a guess.
    pub(super) fn guesses(&self) -> bool {
        !self.ended
    }

    /// Begins a search.
    ///
    /// # Errors
    ///
    /// The job, where the machine gives no thread: whoever asks has to do it.
    pub(super) fn begin(&mut self, job: Job) -> Result<(), Job> {
        if self.thread.is_none() {
            let (jobs, taken) = channel::<Job>();
            let (answers, found) = channel();
            let work = move || {
                for job in taken {
                    if answers.send(job.search()).is_err() {
                        break;
                    }
                }
            };
            if std::thread::Builder::new().name("search".to_owned()).spawn(work).is_err() {
                return Err(job);
            }
            self.thread = Some((jobs, found));
        }
        let Some((jobs, _)) = &self.thread else { return Err(job) };
        if let Err(refused) = jobs.send(job) {
            self.thread = None;
            return Err(refused.0);
        }
        (self.searching, self.stale) = (true, false);
        Ok(())
    }

    /// The contacts are gone: the answer of a search that runs for them does not count.
    pub(super) fn forget(&mut self) {
        self.stale = self.searching;
        self.ended = false;
    }
}

#[cfg(test)]
mod tests {
    use std::time::{Duration, Instant};

    use dermis_inversion::{Search, Settings};
    use dermis_model::{ForwardModel, Indentation, Stimulus};
    use nalgebra::{Point3, Vector3};

    use super::*;
    use crate::testing::{membrane, nine};

    fn job() -> Job {
        let model = membrane(&nine());
        let press = Indentation::sphere(Point3::new(0.002, 0.001, 0.0), Vector3::new(0.0, 0.0, -1.0), 0.004);
        let mut signal = [0.0; 9];
        model.response(&Stimulus { contacts: vec![press], ..Stimulus::default() }, &mut signal).unwrap();
        let mut settings = Settings::new(0.004, 5.0);
        (settings.contacts, settings.search) = (2, Search::Pairs);
        let inverter = Arc::new(Inverter::new(Arc::new(model), settings).unwrap());
        let readings: Vec<Reading> = signal.iter().map(|v| Reading::Exact(*v)).collect();
        Job::of(&inverter, &readings, Learned::default(), &[])
    }

    /// Until no search runs.
    fn ended(search: &mut BackgroundSearch) -> Option<Found> {
        let begun = Instant::now();
        while begun.elapsed() < Duration::from_secs(20) {
            let found = search.found();
            if !search.is_searching() {
                return found;
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        panic!("the search does not end");
    }

    #[test]
    fn what_is_found_in_the_background_is_what_is_found_here() {
        let mut search = BackgroundSearch::default();
        assert!(search.found().is_none() && !search.is_searching());
        let here = job().search().unwrap();
        for _ in 0..2 {
            assert!(search.begin(job()).is_ok() && search.is_searching());
            assert_eq!(ended(&mut search).unwrap().unwrap(), here);
        }
        assert!(search.found().is_none() && !search.guesses());
        search.forget();
        assert!(search.guesses());
    }

    #[test]
    fn what_was_found_of_contacts_that_are_gone_does_not_count() {
        let mut search = BackgroundSearch::default();
        search.forget();
        assert!(search.begin(job()).is_ok());
        search.forget();
        assert!(ended(&mut search).is_none());
        assert!(search.begin(job()).is_ok());
        assert!(ended(&mut search).is_some());
    }
}
