//! What is done to a skin: two sessions of presses on a rig, with repeats, holds and slides.

use std::sync::Arc;

use dermis_model::{ForwardModel, Stimulus};
use dermis_skin::TipKind;
use dermis_testbed::{GroundTruth, Phase, Plan, Timeline};

use crate::BenchmarkError;

/// How the skin's temperature runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Climate {
    /// Up and down again, other in each session: it is neither time nor the count of contacts.
    #[default]
    Varied,
    /// It only warms up, as the session goes on: whatever it does could be ageing or drift as well.
    OnlyWarmer,
}

/// What a rig presses with.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rig {
    /// \[m\] of the tip.
    pub diameter: f64,
    /// Its shape.
    pub tip: TipKind,
    /// \[N\] least and greatest pressing force.
    pub force: [f64; 2],
    /// \[m\] that contacts keep from the rim.
    pub margin: f64,
    /// \[m\] range of slides along the surface; none where it is 0.
    pub slide: [f64; 2],
    /// \[Hz\].
    pub rate: f64,
    /// How many presses, compared to the usual 150.
    pub size: f64,
    /// Noise of a case at most, in multiples of the skin's: more of it would bury every cause of a skin that is noisy by itself.
    pub loudest: f64,
}

impl Rig {
    /// Its tip in the words of a plan.
    fn tip(&self) -> String {
        match self.tip {
            TipKind::Sphere => format!("diameter = {:?}", self.diameter),
            TipKind::FlatPunch => {
                format!("tip = {{ shape = {{ shape = \"flat-punch\", diameter = {:?} }} }}", self.diameter)
            }
        }
    }
}

/// One instant.
#[derive(Debug, Clone, PartialEq)]
pub struct Instant {
    /// \[s\] since power-on.
    pub time: f64,
    /// Session, from 0.
    pub session: usize,
    /// What is done, as the rig knows it.
    pub moment: GroundTruth,
}

impl Instant {
    /// \[K\] above 20 °C.
    #[must_use]
    pub fn warmth(&self) -> f64 {
        self.moment.stimulus.temperature - 293.15
    }
}

/// Everything that is done, in the order of time.
#[derive(Debug, Clone, PartialEq)]
pub struct Script {
    /// \[s\] between instants of one session.
    pub step: f64,
    /// The instants.
    pub instants: Vec<Instant>,
    /// Instants at the beginning that are known to be untouched.
    pub quiet: usize,
}

/// \[s\] between the end of a session and the start of the next.
const BREAK: f64 = 600.0;
/// \[s\] of untouched readings before and after.
const QUIET: f64 = 3.0;
/// Locations of the other parts are counted from here on, so that no two locations share a number.
const LOCATIONS: u32 = 1000;

/// Presses of one session with one timing; both in the words of a plan.
struct Part {
    session: usize,
    seed: u64,
    timing: String,
    steps: String,
}

impl Part {
    /// The parts of a script, in their order. Locations, forces and speeds are the same in all parts of one seed.
    fn all(rig: &Rig, seed: u64) -> [Self; 5] {
        let count = |usual: f64| (usual * rig.size).round().max(2.0) as u32;
        let [low, high] = rig.force;
        let presses = |count: u32, extra: &str| {
            format!("[[steps]]\nkind = \"presses\"\ncount = {count}\nforce = [{low:?}, {high:?}]\n{extra}")
        };
        let slides = if rig.slide[1] > 0.0 {
            let [short, long] = rig.slide;
            format!(
                "[[steps]]\nkind = \"slides\"\ncount = {}\nforce = [{:?}, {:?}]\nlength = [{short:?}, {long:?}]\nspeed = [0.005, 0.03]\n",
                count(14.0),
                low + 0.15 * (high - low),
                low + 0.7 * (high - low),
            )
        } else {
            String::new()
        };
        let timing = |load: [f64; 2], hold: [f64; 2]| {
            format!(
                "[timing]\napproach = [0.05, 0.05]\nload = {load:?}\nhold = {hold:?}\nunload = {load:?}\ngap = [0.2, 0.3]\n"
            )
        };
        let again = |session: usize| Self {
            session,
            seed,
            timing: timing([0.2, 0.2], [0.3, 0.3]).replace("[0.2, 0.3]", "[0.25, 0.25]"),
            steps: presses(count(14.0), ""),
        };
        let slow = Self {
            session: 0,
            seed: seed ^ 0x51,
            timing: timing([0.15, 0.5], [0.1, 0.5]),
            steps: presses(count(44.0), "") + &presses(count(8.0), "hold = [2.0, 3.0]\n") + &slides,
        };
        let fast = Self {
            session: 1,
            seed: seed ^ 0x52,
            timing: timing([0.04, 0.2], [0.1, 0.3]),
            steps: presses(count(50.0), "") + &slides,
        };
        [again(0), again(0), slow, again(1), fast]
    }
}

impl Script {
    /// Draws a script: a part of the contacts is done twice in the first session and once in the second, some are held for long,
    /// the second session is quicker, and between the presses nothing touches.
    ///
    /// # Errors
    ///
    /// [`BenchmarkError::Testbed`] where no place of the skin is far enough from its rim for it.
    pub fn draw(
        model: &Arc<dyn ForwardModel>,
        rig: &Rig,
        climate: Climate,
        seed: u64,
    ) -> Result<Self, BenchmarkError> {
        let step = 1.0 / rig.rate;
        let mut script = Self { step, instants: Vec::new(), quiet: 0 };
        let (mut time, mut press) = (0.0, 0);
        let mut session = 0;
        script.rest(&mut time, 0, 0);
        script.quiet = script.instants.len();
        for (index, part) in Part::all(rig, seed).into_iter().enumerate() {
            if part.session != session {
                script.rest(&mut time, session, press);
                session = part.session;
                time += BREAK;
                script.rest(&mut time, session, press);
            }
            let Part { seed, timing, steps, .. } = part;
            let text = format!(
                "schema = \"dermis-plan/1\"\nname = \"part-{index}\"\n{}\nmargin = {:?}\nforce_distribution = \"uniform\"\n{timing}{steps}",
                rig.tip(),
                rig.margin
            );
            let plan = Plan::from_toml(&text, "script")?;
            let timeline = Timeline::new(&plan, model, seed)?;
            let count = (timeline.duration() / step).ceil() as usize;
            for i in 0..count {
                let mut moment = timeline.at(i as f64 * step);
                moment.press += press;
                match index {
                    0 => {}
                    1 => moment.repeat = 1,
                    3 => moment.repeat = 2,
                    _ if moment.location > 0 => moment.location += LOCATIONS * index as u32,
                    _ => {}
                }
                script.instants.push(Instant { time, session, moment });
                time += step;
            }
            press += timeline.presses();
        }
        script.rest(&mut time, session, press);
        script.warm(climate);
        Ok(script)
    }

    /// Appends untouched instants after so many presses, and moves the time on.
    fn rest(&mut self, time: &mut f64, session: usize, press: u64) {
        for _ in 0..(QUIET / self.step) as usize {
            let moment = GroundTruth { press, phase: Phase::Idle, ..GroundTruth::default() };
            self.instants.push(Instant { time: *time, session, moment });
            *time += self.step;
        }
    }

    /// A plan that somebody asked for, in one session at the temperature that stimuli have by default.
    ///
    /// # Errors
    ///
    /// [`BenchmarkError::Testbed`] where it is no plan, or does not fit the skin.
    pub fn of_plan(
        text: &str,
        model: &Arc<dyn ForwardModel>,
        rate: f64,
        seed: u64,
    ) -> Result<Self, BenchmarkError> {
        let plan = Plan::from_toml(text, "follow-up")?;
        let timeline = Timeline::new(&plan, model, seed)?;
        let step = 1.0 / rate;
        let count = (timeline.duration() / step).ceil() as usize;
        let instant = |i: usize| {
            let time = i as f64 * step;
            Instant { time, session: 0, moment: timeline.at(time) }
        };
        let instants: Vec<Instant> = (0..count).map(instant).collect();
        let quiet = instants.iter().take_while(|i| i.moment.stimulus.contacts.is_empty()).count();
        Ok(Self { step, instants, quiet })
    }

    /// Sets the temperature of every instant.
    fn warm(&mut self, climate: Climate) {
        let whole = self.instants.last().map_or(1.0, |i| i.time);
        for session in 0..2 {
            let of = |i: &Instant| i.session == session;
            let (start, end) = (
                self.instants.iter().find(|i| of(i)).map_or(0.0, |i| i.time),
                self.instants.iter().rfind(|i| of(i)).map_or(1.0, |i| i.time),
            );
            for instant in self.instants.iter_mut().filter(|i| i.session == session) {
                let part = (instant.time - start) / (end - start).max(1e-9);
                let warmth = match climate {
                    Climate::Varied if session == 0 => 6.0 * (std::f64::consts::PI * part).sin(),
                    Climate::Varied => 2.0 - 6.0 * part + 3.0 * (5.0 * part).sin(),
                    Climate::OnlyWarmer => 8.0 * instant.time / whole,
                };
                instant.moment.stimulus.temperature = Stimulus::default().temperature + warmth;
            }
        }
    }

    /// Number of presses.
    #[must_use]
    pub fn presses(&self) -> u64 {
        self.instants.last().map_or(0, |i| i.moment.press)
    }
}
