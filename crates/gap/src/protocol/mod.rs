//! Presses to come: what a rig is to do to a skin, block by block, and what each block is for.
//!
//! A block is a few presses at one place that are compared with one another: one thing differs between them (force, speed, tip, the
//! time held), everything else is the same. What is wrong with a simulator at a place is wrong in all presses of the block alike and
//! cancels, so that a block says more of a cause than as many presses at as many locations (paired comparison; Cox and Reid 2000, ch. 3).
//!
//! [`locations`](self::locations::locations) says where to press, [`menu`] what may be done there, [`design`](self::design::design) what of it is worth the time.

pub mod design;
pub mod locations;
pub mod open;

use dermis_model::{Indentation, Stimulus};
use dermis_skin::{Phase, Surface};
use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};

use crate::constants::protocol::{
    AGAIN, BEFORE, COARSE, HELD_AND_RESTED, LADDER, MOVE, PRESS, REST_AFTER_SPEEDS, SLOW_AFTER, SPEEDS, STEP,
    TIP_CHANGE, USUAL,
};
use crate::recording::{FrameLabel, Recording};

/// One press to come.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PlannedPress {
    /// \[N\] pressing force.
    pub force: f64,
    /// \[m\] diameter of the tip.
    pub tip: f64,
    /// \[s\] from first contact to full force.
    pub load: f64,
    /// \[s\] at full force.
    pub hold: f64,
    /// \[s\] from full force to none.
    pub unload: f64,
    /// \[s\] untouched afterwards.
    pub rest: f64,
}

impl PlannedPress {
    /// \[s\] with its rest.
    #[must_use]
    pub fn duration(&self) -> f64 {
        self.load + self.hold + self.unload + self.rest
    }
}

/// What the presses of a block differ in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum BlockKind {
    /// Nothing: one press.
    Single,
    /// Nothing: the same press again.
    Again,
    /// The force.
    Ladder,
    /// How fast it is loaded and released.
    TwoSpeeds,
    /// How long it is held, and what is left afterwards.
    HoldAndRest,
    /// The tip.
    TwoTips,
}

impl BlockKind {
    /// As tables call it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Single => "single press",
            Self::Again => "the same press again",
            Self::Ladder => "force ladder",
            Self::TwoSpeeds => "two speeds",
            Self::HoldAndRest => "hold and rest",
            Self::TwoTips => "two tips",
        }
    }

    /// What it tells, for people.
    #[must_use]
    pub const fn why(self) -> &'static str {
        match self {
            Self::Single => "where on the surface the gap lies",
            Self::Again => "what comes again with the same press, and what does not",
            Self::Ladder => "what bends with the force: stiffening, saturation, thresholds, local softness",
            Self::TwoSpeeds => {
                "what depends on the speed (delays, low passes, creep) and what does not (friction inside)"
            }
            Self::HoldAndRest => "what fades under a press that is held, and what is left after it",
            Self::TwoTips => {
                "what depends on the size of the contact: the tip, the medium, the width of a taxel"
            }
        }
    }
}

/// Presses at one place that are compared with one another.
#[derive(Debug, Clone, PartialEq)]
pub struct Block {
    /// What they differ in.
    pub kind: BlockKind,
    /// \[m\] on the surface, in the frame of the skin's link.
    pub at: Point3<f64>,
    /// In their order.
    pub presses: Vec<PlannedPress>,
}

impl Block {
    /// Minutes on a rig: presses, the way to the place, and changes of the tip.
    #[must_use]
    pub fn minutes(&self) -> f64 {
        let pressed: f64 = self.presses.iter().map(PlannedPress::duration).sum();
        let changes = self.presses.windows(2).filter(|w| w[0].tip != w[1].tip).count();
        (pressed + MOVE + TIP_CHANGE * changes as f64) / 60.0
    }
}

/// What presses have in common.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Range {
    /// \[N\] least and largest pressing force.
    pub force: [f64; 2],
    /// \[m\] diameter of the usual tip.
    pub tip: f64,
    /// \[m\] of a second one, where there is one.
    pub second_tip: Option<f64>,
}

impl Range {
    /// Force \[N\] at this share of the range.
    #[must_use]
    pub fn force(&self, share: f64) -> f64 {
        self.force[0] + share * (self.force[1] - self.force[0])
    }

    /// An ordinary press.
    #[must_use]
    pub fn press(&self, share: f64) -> PlannedPress {
        let [load, hold, unload, rest] = PRESS;
        PlannedPress { force: self.force(share), tip: self.tip, load, hold, unload, rest }
    }
}

/// All that may be done at one place.
#[must_use]
pub fn menu(range: &Range, at: Point3<f64>) -> Vec<Block> {
    let usual = range.press(USUAL);
    let block = |kind, presses| Block { kind, at, presses };
    let mut blocks = vec![
        block(BlockKind::Single, vec![usual]),
        block(BlockKind::Again, vec![usual; AGAIN]),
        block(BlockKind::Ladder, LADDER.map(|share| range.press(share)).into()),
        block(
            BlockKind::TwoSpeeds,
            SPEEDS.map(|t| PlannedPress { load: t, unload: t, rest: REST_AFTER_SPEEDS, ..usual }).into(),
        ),
        block(
            BlockKind::HoldAndRest,
            HELD_AND_RESTED.map(|[hold, rest]| PlannedPress { hold, rest, ..usual }).into(),
        ),
    ];
    if let Some(tip) = range.second_tip {
        blocks.push(block(BlockKind::TwoTips, vec![usual, PlannedPress { tip, ..usual }]));
    }
    blocks
}

/// Blocks as a recording without readings, one after another after some seconds in which nothing touches. Place numbers count the
/// locations, press numbers the presses, both from 1; `rate` \[Hz\] is that of the skin, which slow stretches do not need.
pub(crate) fn carried_out(blocks: &[Block], surface: &Surface, channels: usize, rate: f64) -> Recording {
    let mut recording = Recording::new("presses to come", channels);
    let step = (1.0 / rate).max(STEP);
    let mut time = 0.0;
    let mut press_number = 0u64;
    let mut locations: Vec<Point3<f64>> = Vec::new();
    let mut add = |time: f64, phase: Phase, contacts: Vec<Indentation>, press: u64, location: u32| {
        let stimulus = Stimulus { contacts, ..Stimulus::default() };
        let temperature = stimulus.temperature;
        let label =
            FrameLabel { time, run: 0, press, location, phase, stimulus: Some(stimulus), temperature };
        recording.push(label, &[]);
    };
    while time < BEFORE {
        add(time, Phase::Idle, Vec::new(), 0, 0);
        time += COARSE[0] * step;
    }
    for block in blocks {
        let (at, normal) = surface.project(&block.at);
        let known = locations.iter().position(|p| (p - at).norm() < 1e-9);
        let location = known.unwrap_or_else(|| {
            locations.push(at);
            locations.len() - 1
        }) as u32
            + 1;
        for press in &block.presses {
            press_number += 1;
            let begin = time;
            let ends = [press.load, press.load + press.hold, press.load + press.hold + press.unload];
            while time - begin < press.duration() {
                let t = time - begin;
                let (share, phase) = if t < ends[0] {
                    ((t + step) / (press.load + step), Phase::Load)
                } else if t < ends[1] {
                    (1.0, Phase::Hold)
                } else if t < ends[2] {
                    (1.0 - (t - ends[1]) / press.unload, Phase::Unload)
                } else {
                    (0.0, Phase::Approach)
                };
                let contact =
                    || Indentation::sphere(at, Vector3::from(normal * (-share * press.force)), press.tip);
                let contacts = if share > 0.0 { vec![contact()] } else { Vec::new() };
                add(time, phase, contacts, press_number, location);
                // What is held or rests for long changes slowly.
                let slow = (t > ends[0] + SLOW_AFTER && t < ends[1] - SLOW_AFTER) || t > ends[2] + SLOW_AFTER;
                time += if slow { COARSE[1] * step } else { step };
            }
        }
    }
    recording
}
