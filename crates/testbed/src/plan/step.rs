//! One part of a plan.

use serde::Serialize;

use super::step_file::StepFile;

/// What a press goes up to: a pressing force \[N\], or a depth of the tip below first contact \[m\], which takes a skin whose
/// model knows how deep tips sink in. Of several tips at once each sinks in as if it were alone.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Level<T> {
    /// \[N\].
    Force(T),
    /// \[m\].
    Depth(T),
}

impl<T> Level<T> {
    /// The same kind of level with another number.
    pub fn map<U>(&self, change: impl FnOnce(&T) -> U) -> Level<U> {
        match self {
            Self::Force(force) => Level::Force(change(force)),
            Self::Depth(depth) => Level::Depth(change(depth)),
        }
    }

    /// The number.
    pub fn value(&self) -> &T {
        match self {
            Self::Force(value) | Self::Depth(value) => value,
        }
    }
}

/// What a number is drawn from.
#[derive(Debug, Clone, PartialEq)]
pub enum Drawn {
    /// A range, as [`ForceDistribution`](super::ForceDistribution) says.
    Within([f64; 2]),
    /// One of these, each as likely as any other: weights that lie on a table, say.
    OneOf(Vec<f64>),
}

/// What is done in a step.
#[derive(Debug, Clone, PartialEq)]
pub enum Action {
    /// Nothing touches.
    Idle {
        /// \[s\].
        duration: f64,
    },
    /// Single presses at random locations.
    Presses {
        /// Number of locations.
        count: u32,
        /// Range of what each press goes up to.
        level: Level<[f64; 2]>,
        /// Presses at each place, each with a level of its own.
        repeats: u32,
    },
    /// Single presses at random locations, all up to the same levels.
    Levels {
        /// Number of locations.
        count: u32,
        /// What each place is pressed up to.
        levels: Levels,
    },
    /// Single presses on a grid of locations, in random order of the locations.
    Grid {
        /// \[m\] between locations, along x and y of the skin's link.
        pitch: [f64; 2],
        /// What each place is pressed up to.
        levels: Levels,
    },
    /// Single presses at locations that are named, in order.
    Locations {
        /// \[m\] on the surface, in the frame of the skin's link.
        at: Vec<[f64; 3]>,
        /// What each place is pressed up to.
        levels: Levels,
    },
    /// Presses that slide along the surface at full force.
    Slides {
        /// Number of slides.
        count: u32,
        /// \[N\] range of the pressing force.
        force: [f64; 2],
        /// \[m\] range of the way.
        length: [f64; 2],
        /// \[m/s\] range of the speed.
        speed: [f64; 2],
        /// How the slide goes on.
        strokes: Strokes,
    },
    /// Several contacts at once, at random locations.
    Multi {
        /// Number of presses.
        count: u32,
        /// Range of the number of contacts in a press, both ends included.
        contacts: [u32; 2],
        /// \[m\] least distance between the contacts of a press, and the most; infinite where the plan names one number.
        distance: [f64; 2],
        /// What each contact of a press goes up to is drawn from, for itself.
        level: Level<Drawn>,
    },
    /// Several tips of one plate, lowered together: each sits on an arm of a hexagon about the middle of the plate, all as far from
    /// it. One level is that of all tips.
    Hex {
        /// Number of locations of the plate.
        count: u32,
        /// Range of the number of tips, 1 to 6, both ends included. They sit on the arms of [`HEX_ARMS`].
        contacts: [u32; 2],
        /// \[m\] range of the distance of every tip from the middle of the plate.
        radius: [f64; 2],
        /// \[rad\] range of the angle of the first arm about the outward normal, from the link's x axis.
        turn: [f64; 2],
        /// What each place is pressed up to.
        levels: Levels,
    },
    /// Nothing touches, and the skin is held still in one posture after another: gravity pulls another way in its frame. In posture (yaw, roll)
    /// the skin is first turned by `roll` about the z axis of its link and then by `yaw` about the y axis of the rig, from where the plan's
    /// gravity is what it says (straight down along z where it says nothing). Postures of opposite yaw whose rolls differ by half a turn are the
    /// same as seen by the skin.
    Postures {
        /// \[rad\] range of the angle between the link's z axis and where it points in the plan's own posture.
        yaw: [f64; 2],
        /// \[rad\] range of the angle about the link's z axis.
        roll: [f64; 2],
        /// Which of these.
        set: PostureSet,
        /// \[s\] that each is held.
        duration: f64,
    },
}

/// Which postures of two ranges of angles are taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PostureSet {
    /// So many, drawn at random.
    Drawn(u32),
    /// So many angles of yaw, and so many of roll at each, in order, evenly from one end of the range to the other. Of a range of a whole turn
    /// or more the end is left out: it is the beginning again.
    Grid([u32; 2]),
}

/// How a slide goes on after it has begun.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Strokes {
    /// Strokes one way, all in one line, each as long as the step says.
    pub count: u32,
    /// \[s\] range of how long the tip stops, pressing, after each stroke.
    pub stop: [f64; 2],
    /// How often the tip goes all strokes and back again; 0: one way only.
    pub cycles: u32,
}

impl Default for Strokes {
    fn default() -> Self {
        Self { count: 1, stop: [0.0, 0.0], cycles: 0 }
    }
}

impl Strokes {
    /// Strokes of the whole slide, both ways.
    #[must_use]
    pub fn all(&self) -> u64 {
        u64::from(self.count).saturating_mul(self.ways())
    }

    /// Times that its length is gone, one way or the other.
    pub(crate) fn ways(&self) -> u64 {
        if self.cycles == 0 { 1 } else { 2 * u64::from(self.cycles) }
    }
}

/// Arms that one to six tips sit on, counted in steps of 60° from the first: spread as evenly as six arms allow.
pub const HEX_ARMS: [&[u32]; 6] =
    [&[0], &[0, 3], &[0, 2, 4], &[0, 1, 3, 4], &[0, 1, 2, 3, 4], &[0, 1, 2, 3, 4, 5]];

/// What one place is pressed up to.
#[derive(Debug, Clone, PartialEq)]
pub struct Levels {
    /// One after another.
    pub values: Level<Vec<f64>>,
    /// All in one press that holds at each, instead of a press for each.
    pub incremental: bool,
    /// How often they are gone through.
    pub repeats: u32,
}

impl Levels {
    /// Presses each time they are gone through.
    #[must_use]
    pub fn presses(&self) -> usize {
        if self.incremental { 1 } else { self.values.value().len() }
    }
}

/// How the presses of a step are done, where it says more than the plan.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PressProfile {
    /// \[m\] of the indenter's spherical tip; of several, one is drawn for each place. The plan's where empty.
    pub diameter: Vec<f64>,
    /// Range of the ratio of tangential to normal force that the tip is moved sideways to, after it has held each level.
    pub shear: Option<[f64; 2]>,
    /// \[rad\] of that motion, about the outward normal from the link's x axis (from its y axis where x is the normal); drawn
    /// for each contact where absent.
    pub shear_direction: Option<f64>,
    /// Range of how long it takes to full force \[s\], instead of the plan's.
    pub load: Option<[f64; 2]>,
    /// Range of how long it holds \[s\], instead of the plan's.
    pub hold: Option<[f64; 2]>,
    /// Range of how long it takes to let go \[s\], instead of the plan's.
    pub unload: Option<[f64; 2]>,
    /// Range of how long nothing touches after it \[s\], instead of the plan's.
    pub gap: Option<[f64; 2]>,
    /// \[N\] levels at which a tip presses with less are left out, and so are presses of which nothing is left.
    pub least_force: Option<f64>,
    /// \[N\] at which a press stops: the first level at which a tip presses with more, and all that follow, are left out.
    pub most_force: Option<f64>,
}

/// One part of a plan; parts follow one another.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(into = "StepFile")]
pub struct Step {
    /// What is done.
    pub action: Action,
    /// How its presses are done.
    pub profile: PressProfile,
}

impl From<Action> for Step {
    fn from(action: Action) -> Self {
        Self { action, profile: PressProfile::default() }
    }
}
