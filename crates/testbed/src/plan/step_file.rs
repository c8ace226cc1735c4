//! A step as files say it: keys, which kind of step has which of them, and back.

use serde::{Deserialize, Serialize};

use super::numbers::{OneOrMore, OneOrTwo};
use super::step::{Action, Drawn, Level, Levels, PostureSet, PressProfile, Step, Strokes};

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Kind {
    Idle,
    Presses,
    Grid,
    #[serde(alias = "places")]
    Locations,
    Slides,
    Multi,
    Hex,
    Postures,
}

impl Kind {
    const fn name(self) -> &'static str {
        match self {
            Self::Idle => "idle",
            Self::Presses => "presses",
            Self::Grid => "grid",
            Self::Locations => "locations",
            Self::Slides => "slides",
            Self::Multi => "multi",
            Self::Hex => "hex",
            Self::Postures => "postures",
        }
    }

    /// Keys that a step of this kind may have.
    fn keys(self) -> Vec<&'static str> {
        let (own, common): (&[&str], &[&str]) = match self {
            Self::Idle => (&["duration"], &[]),
            Self::Presses => {
                (&["count", "force", "depth", "forces", "depths", "incremental", "repeats"], &PROFILE)
            }
            Self::Grid => (&["pitch", "forces", "depths", "incremental", "repeats"], &PROFILE),
            Self::Locations => (&["at", "forces", "depths", "incremental", "repeats"], &PROFILE),
            Self::Slides => {
                (&["count", "force", "length", "speed", "strokes", "stop", "cycles", "diameter"], &[])
            }
            Self::Multi => {
                (&["count", "contacts", "distance", "force", "depth", "forces", "depths"], &PROFILE)
            }
            Self::Hex => (
                &["count", "contacts", "radius", "turn", "forces", "depths", "incremental", "repeats"],
                &PROFILE,
            ),
            Self::Postures => (&["yaw", "roll", "count", "counts", "duration"], &[]),
        };
        [own, common].concat()
    }

    /// Says that a step of this kind lacks a key.
    fn missing(self, key: &'static str) -> impl FnOnce() -> Wrong {
        move || (key, format!("is missing: a step of kind `{}` needs it", self.name()))
    }
}

/// A key that is wrong, and why.
type Wrong = (&'static str, String);

/// A step as files say it: every key that some kind of step has.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct StepFile {
    kind: Kind,
    #[serde(skip_serializing_if = "Option::is_none")]
    duration: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    count: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pitch: Option<OneOrTwo>,
    #[serde(skip_serializing_if = "Option::is_none")]
    at: Option<Vec<[f64; 3]>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    contacts: Option<[u32; 2]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    distance: Option<OneOrTwo>,
    #[serde(skip_serializing_if = "Option::is_none")]
    force: Option<[f64; 2]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    depth: Option<[f64; 2]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    forces: Option<Vec<f64>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    depths: Option<Vec<f64>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    incremental: Option<bool>,
    #[serde(skip_serializing_if = "Option::is_none")]
    repeats: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    length: Option<[f64; 2]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    speed: Option<[f64; 2]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    diameter: Option<OneOrMore>,
    #[serde(skip_serializing_if = "Option::is_none")]
    shear: Option<OneOrTwo>,
    #[serde(skip_serializing_if = "Option::is_none")]
    shear_direction: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    load: Option<[f64; 2]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    hold: Option<[f64; 2]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    unload: Option<[f64; 2]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    gap: Option<[f64; 2]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    least_force: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    most_force: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    radius: Option<OneOrTwo>,
    #[serde(skip_serializing_if = "Option::is_none")]
    turn: Option<OneOrTwo>,
    #[serde(skip_serializing_if = "Option::is_none")]
    strokes: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    stop: Option<OneOrTwo>,
    #[serde(skip_serializing_if = "Option::is_none")]
    cycles: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    yaw: Option<OneOrTwo>,
    #[serde(skip_serializing_if = "Option::is_none")]
    roll: Option<OneOrTwo>,
    #[serde(skip_serializing_if = "Option::is_none")]
    counts: Option<[u32; 2]>,
}

/// Keys of how it is pressed, the same for every kind of press that stands still.
const PROFILE: [&str; 9] =
    ["diameter", "shear", "shear_direction", "load", "hold", "unload", "gap", "least_force", "most_force"];

impl StepFile {
    const fn of(kind: Kind) -> Self {
        Self {
            kind,
            duration: None,
            count: None,
            pitch: None,
            at: None,
            contacts: None,
            distance: None,
            force: None,
            depth: None,
            forces: None,
            depths: None,
            incremental: None,
            repeats: None,
            length: None,
            speed: None,
            diameter: None,
            shear: None,
            shear_direction: None,
            load: None,
            hold: None,
            unload: None,
            gap: None,
            least_force: None,
            most_force: None,
            radius: None,
            turn: None,
            strokes: None,
            stop: None,
            cycles: None,
            yaw: None,
            roll: None,
            counts: None,
        }
    }

    /// Keys that are there.
    fn keys(&self) -> Vec<&'static str> {
        let all = [
            ("duration", self.duration.is_some()),
            ("count", self.count.is_some()),
            ("pitch", self.pitch.is_some()),
            ("at", self.at.is_some()),
            ("contacts", self.contacts.is_some()),
            ("distance", self.distance.is_some()),
            ("force", self.force.is_some()),
            ("depth", self.depth.is_some()),
            ("forces", self.forces.is_some()),
            ("depths", self.depths.is_some()),
            ("incremental", self.incremental.is_some()),
            ("repeats", self.repeats.is_some()),
            ("length", self.length.is_some()),
            ("speed", self.speed.is_some()),
            ("diameter", self.diameter.is_some()),
            ("shear", self.shear.is_some()),
            ("shear_direction", self.shear_direction.is_some()),
            ("load", self.load.is_some()),
            ("hold", self.hold.is_some()),
            ("unload", self.unload.is_some()),
            ("gap", self.gap.is_some()),
            ("least_force", self.least_force.is_some()),
            ("most_force", self.most_force.is_some()),
            ("radius", self.radius.is_some()),
            ("turn", self.turn.is_some()),
            ("strokes", self.strokes.is_some()),
            ("stop", self.stop.is_some()),
            ("cycles", self.cycles.is_some()),
            ("yaw", self.yaw.is_some()),
            ("roll", self.roll.is_some()),
            ("counts", self.counts.is_some()),
        ];
        all.into_iter().filter_map(|(name, there)| there.then_some(name)).collect()
    }

    /// The step that this says, or the key that is wrong and why.
    pub(super) fn step(mut self) -> Result<Step, Wrong> {
        let known = self.kind.keys();
        if let Some(key) = self.keys().into_iter().find(|key| !known.contains(key)) {
            let (kind, known) = (self.kind.name(), known.join(", "));
            return Err((key, format!("is no key of a step of kind `{kind}`, which has {known}")));
        }
        Ok(Step { action: self.action()?, profile: self.profile()? })
    }

    /// What is done.
    fn action(&mut self) -> Result<Action, Wrong> {
        let kind = self.kind;
        Ok(match kind {
            Kind::Idle => Action::Idle { duration: self.duration.ok_or_else(kind.missing("duration"))? },
            Kind::Presses => self.presses()?,
            Kind::Grid => Action::Grid {
                pitch: self.pitch.ok_or_else(kind.missing("pitch"))?.both(),
                levels: self.levels()?,
            },
            Kind::Locations => Action::Locations {
                at: self.at.take().ok_or_else(kind.missing("at"))?,
                levels: self.levels()?,
            },
            Kind::Slides => Action::Slides {
                count: self.count.ok_or_else(kind.missing("count"))?,
                force: self.force.ok_or_else(kind.missing("force"))?,
                length: self.length.ok_or_else(kind.missing("length"))?,
                speed: self.speed.ok_or_else(kind.missing("speed"))?,
                strokes: self.strokes(),
            },
            Kind::Multi => Action::Multi {
                count: self.count.ok_or_else(kind.missing("count"))?,
                contacts: self.contacts.ok_or_else(kind.missing("contacts"))?,
                distance: match self.distance.ok_or_else(kind.missing("distance"))? {
                    OneOrTwo::One(least) => [least, f64::INFINITY],
                    OneOrTwo::Two(range) => range,
                },
                level: self.drawn()?,
            },
            Kind::Hex => Action::Hex {
                count: self.count.ok_or_else(kind.missing("count"))?,
                contacts: self.contacts.ok_or_else(kind.missing("contacts"))?,
                radius: self.radius.ok_or_else(kind.missing("radius"))?.both(),
                turn: self.turn.map_or([0.0; 2], OneOrTwo::both),
                levels: self.levels()?,
            },
            Kind::Postures => Action::Postures {
                yaw: self.yaw.ok_or_else(kind.missing("yaw"))?.both(),
                roll: self.roll.ok_or_else(kind.missing("roll"))?.both(),
                set: self.postures()?,
                duration: self.duration.ok_or_else(kind.missing("duration"))?,
            },
        })
    }

    /// How a slide goes on: in one stroke and one way, unless it says otherwise.
    fn strokes(&self) -> Strokes {
        let once = Strokes::default();
        Strokes {
            count: self.strokes.unwrap_or(once.count),
            stop: self.stop.map_or(once.stop, OneOrTwo::both),
            cycles: self.cycles.unwrap_or(once.cycles),
        }
    }

    /// Which postures: so many that are drawn, or a grid.
    fn postures(&self) -> Result<PostureSet, Wrong> {
        self.one_of(
            ("count", self.count.map(PostureSet::Drawn)),
            ("counts", self.counts.map(PostureSet::Grid)),
        )
    }

    /// What one of two keys says, of which a step of this kind has exactly one.
    fn one_of<T>(
        &self,
        (first, one): (&'static str, Option<T>),
        (second, other): (&'static str, Option<T>),
    ) -> Result<T, Wrong> {
        match (one, other) {
            (Some(said), None) | (None, Some(said)) => Ok(said),
            (Some(_), Some(_)) => Err((second, format!("stands beside `{first}`: name one of them"))),
            (None, None) => {
                let kind = self.kind.name();
                Err((first, format!("is missing: a step of kind `{kind}` needs it, or `{second}`")))
            }
        }
    }

    /// Single presses: to levels of a range, or to each that is listed.
    fn presses(&mut self) -> Result<Action, Wrong> {
        let listed = self.forces.is_some() || self.depths.is_some();
        if listed && (self.force.is_some() || self.depth.is_some()) {
            let reason = "names levels: leave out the range `force` or `depth` beside it";
            return Err((if self.forces.is_some() { "forces" } else { "depths" }, reason.to_owned()));
        }
        if !listed && self.incremental.is_some() {
            return Err(("incremental", "goes with `forces` or `depths`: name the levels".to_owned()));
        }
        let count = self.count.ok_or_else(self.kind.missing("count"))?;
        Ok(if listed {
            Action::Levels { count, levels: self.levels()? }
        } else {
            Action::Presses { count, level: self.range()?, repeats: self.repeats.unwrap_or(1) }
        })
    }

    /// The range that levels are drawn from.
    fn range(&self) -> Result<Level<[f64; 2]>, Wrong> {
        self.one_of(("force", self.force.map(Level::Force)), ("depth", self.depth.map(Level::Depth)))
    }

    /// The levels that are listed.
    fn levels(&mut self) -> Result<Levels, Wrong> {
        let (forces, depths) = (self.forces.take(), self.depths.take());
        let values =
            self.one_of(("forces", forces.map(Level::Force)), ("depths", depths.map(Level::Depth)))?;
        let (incremental, repeats) = (self.incremental.unwrap_or(false), self.repeats.unwrap_or(1));
        Ok(Levels { values, incremental, repeats })
    }

    /// What the levels of several contacts at once are drawn from.
    fn drawn(&mut self) -> Result<Level<Drawn>, Wrong> {
        if self.forces.is_none() && self.depths.is_none() {
            return Ok(self.range()?.map(|range| Drawn::Within(*range)));
        }
        if self.force.is_some() || self.depth.is_some() {
            let reason = "names one of some: leave out the range `force` or `depth` beside it";
            return Err(("forces", reason.to_owned()));
        }
        Ok(self.levels()?.values.map(|listed| Drawn::OneOf(listed.clone())))
    }

    /// How it is pressed.
    fn profile(self) -> Result<PressProfile, Wrong> {
        let diameter = self.diameter.map(OneOrMore::all);
        if diameter.as_ref().is_some_and(Vec::is_empty) {
            return Err(("diameter", "is empty: a tip has a diameter".to_owned()));
        }
        Ok(PressProfile {
            diameter: diameter.unwrap_or_default(),
            shear: self.shear.map(OneOrTwo::both),
            shear_direction: self.shear_direction,
            load: self.load,
            hold: self.hold,
            unload: self.unload,
            gap: self.gap,
            least_force: self.least_force,
            most_force: self.most_force,
        })
    }
}

impl From<Step> for StepFile {
    fn from(step: Step) -> Self {
        let file = Self::doing(step.action);
        let PressProfile {
            diameter,
            shear,
            shear_direction,
            load,
            hold,
            unload,
            gap,
            least_force,
            most_force,
        } = step.profile;
        Self {
            diameter: OneOrMore::of(diameter),
            shear: shear.map(OneOrTwo::from),
            shear_direction,
            load,
            hold,
            unload,
            gap,
            least_force,
            most_force,
            ..file
        }
    }
}

impl StepFile {
    /// What a step does, without how each press is made.
    fn doing(action: Action) -> Self {
        let ranges = |level: Level<[f64; 2]>| match level {
            Level::Force(force) => (Some(force), None),
            Level::Depth(depth) => (None, Some(depth)),
        };
        let lists = |levels: Levels, mut file: Self| {
            match levels.values {
                Level::Force(forces) => file.forces = Some(forces),
                Level::Depth(depths) => file.depths = Some(depths),
            }
            file.incremental = Some(levels.incremental);
            file.repeats = Some(levels.repeats);
            file
        };
        match action {
            Action::Idle { duration } => Self { duration: Some(duration), ..Self::of(Kind::Idle) },
            Action::Presses { count, level, repeats } => {
                let (force, depth) = ranges(level);
                Self { count: Some(count), force, depth, repeats: Some(repeats), ..Self::of(Kind::Presses) }
            }
            Action::Levels { count, levels } => {
                lists(levels, Self { count: Some(count), ..Self::of(Kind::Presses) })
            }
            Action::Grid { pitch, levels } => {
                lists(levels, Self { pitch: Some(pitch.into()), ..Self::of(Kind::Grid) })
            }
            Action::Locations { at, levels } => {
                lists(levels, Self { at: Some(at), ..Self::of(Kind::Locations) })
            }
            Action::Slides { count, force, length, speed, strokes } => {
                let once = Strokes::default();
                Self {
                    count: Some(count),
                    force: Some(force),
                    length: Some(length),
                    speed: Some(speed),
                    strokes: (strokes.count != once.count).then_some(strokes.count),
                    stop: (strokes.stop != once.stop).then_some(strokes.stop.into()),
                    cycles: (strokes.cycles != once.cycles).then_some(strokes.cycles),
                    ..Self::of(Kind::Slides)
                }
            }
            Action::Multi { count, contacts, distance, level } => {
                let [least, most] = distance;
                let distance = if most.is_finite() { OneOrTwo::Two(distance) } else { OneOrTwo::One(least) };
                let (count, contacts, distance) = (Some(count), Some(contacts), Some(distance));
                let file = Self { count, contacts, distance, ..Self::of(Kind::Multi) };
                match level {
                    Level::Force(Drawn::Within(force)) => Self { force: Some(force), ..file },
                    Level::Depth(Drawn::Within(depth)) => Self { depth: Some(depth), ..file },
                    Level::Force(Drawn::OneOf(forces)) => Self { forces: Some(forces), ..file },
                    Level::Depth(Drawn::OneOf(depths)) => Self { depths: Some(depths), ..file },
                }
            }
            Action::Hex { count, contacts, radius, turn, levels } => {
                let (count, contacts) = (Some(count), Some(contacts));
                let (radius, turn) = (Some(radius.into()), Some(turn.into()));
                lists(levels, Self { count, contacts, radius, turn, ..Self::of(Kind::Hex) })
            }
            Action::Postures { yaw, roll, set, duration } => {
                let (yaw, roll) = (Some(yaw.into()), Some(roll.into()));
                let file = Self { yaw, roll, duration: Some(duration), ..Self::of(Kind::Postures) };
                match set {
                    PostureSet::Drawn(count) => Self { count: Some(count), ..file },
                    PostureSet::Grid(counts) => Self { counts: Some(counts), ..file },
                }
            }
        }
    }
}
