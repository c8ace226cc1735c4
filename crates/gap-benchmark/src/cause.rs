//! What can make a reference device differ from its design.

use std::collections::BTreeMap;

use dermis_skin::Surface;
use nalgebra::Point3;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use serde::{Deserialize, Deserializer, Serialize};

use crate::BenchmarkError;

/// A cause of a gap, and how it is described where nobody knows the names of any tool.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct CauseInfo {
    /// Name in ground truths.
    pub id: &'static str,
    /// Physical description.
    pub what: &'static str,
    /// Where the law comes from.
    pub source: &'static str,
    /// Its size: name, SI unit, and value at strength 1, the most that makes sense.
    pub size: (&'static str, &'static str, f64),
    /// Whether the size is drawn with either sign.
    pub signed: bool,
    /// Whether the literature lists it among the effects of such a sensor, so that a library should know it.
    pub listed: bool,
    /// What its cases are counted as.
    pub cell: Cell,
}

/// What a case counts as: rates of different cells say different things of a tool, and are never averaged.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Cell {
    /// The cause does not come again with the same press: no model of the skin takes it away.
    DoesNotRepeat,
    /// A library holds the cause, and its law is the one that libraries have.
    SameLaw,
    /// A library holds the cause, with another law.
    OtherLaw,
    /// A number of the skin's description is another one.
    DesignNumber,
    /// Systematic, and in no library.
    Foreign,
    /// Two causes.
    TwoCauses,
    /// Three causes, or one that the recording cannot tell from another.
    Hard,
    /// No cause.
    Controls,
}

impl Cell {
    /// As tables call it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::DoesNotRepeat => "does not repeat",
            Self::SameLaw => "in the library, same law",
            Self::OtherLaw => "in the library, another law",
            Self::DesignNumber => "design number off",
            Self::Foreign => "systematic and foreign",
            Self::TwoCauses => "two causes",
            Self::Hard => "three causes, or confounded",
            Self::Controls => "controls",
        }
    }
}

impl CauseInfo {
    /// A cause whose fields come in their order.
    pub(crate) const fn new(
        id: &'static str,
        what: &'static str,
        source: &'static str,
        size: (&'static str, &'static str, f64),
        signed: bool,
        listed: bool,
    ) -> Self {
        let cell = if listed { Cell::SameLaw } else { Cell::Foreign };
        Self { id, what, source, size, signed, listed, cell }
    }

    /// Counted as this.
    pub(crate) const fn cell(mut self, cell: Cell) -> Self {
        self.cell = cell;
        self
    }

    /// Size in its SI unit.
    #[must_use]
    pub fn of(&self, cause: &Cause) -> f64 {
        cause.strength * self.size.2 * if self.signed { cause.sign() } else { 1.0 }
    }
}

/// Old names of causes in ground truths that were sealed before, and the names of today.
const RENAMED: [(&str, &str); 2] =
    [("mains-hum", "mains-interference"), ("bent-characteristic", "nonlinear-characteristic")];

fn current_id<'de, D: Deserializer<'de>>(from: D) -> Result<String, D::Error> {
    let id = String::deserialize(from)?;
    let renamed = RENAMED.iter().find(|(old, _)| *old == id);
    Ok(renamed.map_or(id, |(_, now)| (*now).to_owned()))
}

/// A cause at work in one reference device.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Cause {
    /// Which.
    #[serde(deserialize_with = "current_id")]
    pub id: String,
    /// Share of the most that makes sense, 0 to 1.
    pub strength: f64,
    /// What is drawn of it: signs, channels, locations.
    pub seed: u64,
}

impl Cause {
    /// Its random choices.
    pub(crate) fn rng(&self) -> ChaCha8Rng {
        ChaCha8Rng::seed_from_u64(self.seed)
    }

    /// One of -1 and 1.
    pub(crate) fn sign(&self) -> f64 {
        let mut rng = self.rng();
        rng.set_stream(9);
        if rng.random::<bool>() { 1.0 } else { -1.0 }
    }

    /// A point of a surface that it sits at.
    pub(crate) fn point_of(&self, surface: &Surface) -> Point3<f64> {
        surface.points[self.rng().random_range(0..surface.points.len())]
    }

    /// Standard normal numbers, one a channel.
    pub(crate) fn normals(&self, count: usize) -> Vec<f64> {
        let mut rng = self.rng();
        (0..count).map(|_| rng.sample(StandardNormal)).collect()
    }
}

/// The causes of one reference device.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Causes {
    known: &'static [CauseInfo],
    causes: Vec<Cause>,
}

impl Causes {
    pub fn new(known: &'static [CauseInfo], causes: &[Cause]) -> Result<Self, BenchmarkError> {
        for cause in causes {
            if !known.iter().any(|k| k.id == cause.id) {
                let known: Vec<&str> = known.iter().map(|k| k.id).collect();
                return Err(BenchmarkError::Cause { id: cause.id.clone(), known: known.join(", ") });
            }
        }
        Ok(Self { known, causes: causes.to_vec() })
    }

    /// The cause and its size in SI units, where it is at work.
    pub fn get(&self, id: &str) -> Option<(&Cause, f64)> {
        let cause = self.causes.iter().find(|c| c.id == id)?;
        let info = self.known.iter().find(|k| k.id == id)?;
        Some((cause, info.of(cause)))
    }

    /// Its size, 0 where it is not at work.
    pub fn size(&self, id: &str) -> f64 {
        self.get(id).map_or(0.0, |(_, size)| size)
    }
}

/// The parameters of a cause in SI units, by name.
#[must_use]
pub fn parameters(known: &[CauseInfo], cause: &Cause) -> BTreeMap<String, f64> {
    let info = known.iter().find(|k| k.id == cause.id);
    info.map(|k| (k.size.0.to_owned(), k.of(cause))).into_iter().collect()
}
