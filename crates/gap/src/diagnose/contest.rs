//! Stage `contest`: which of the named effects may be called the cause firmly.
//!
//! Selection compares effects of a library with each other and with the simulator's declared error. What is in no library is not among
//! them, and an effect with many numbers, or with values that no device has, takes its place. So a name is firm only where it
//! 1. can be switched on in a simulation,
//! 2. needs no value that its prior makes implausible,
//! 3. is not clearly beaten by a generic [rival](crate::rivals) on locations that neither was fitted to, and
//! 4. leaves nothing that goes with the place, where it has a number for each channel: what is wrong with a channel is wrong at each
//!    place that the channel sees, and
//! 5. leaves what right names leave, by the [calibration](crate::unknown) on the library itself.
//!
//! Where what it leaves is like what wrong names leave, the cause is called unknown: the name says what it looks like, and the shape that
//! finds most of the rest says where to look.

use std::collections::BTreeMap;

use super::data::Data;
use super::evidence;
use super::measure::Measured;
use super::predict::Explained;
use super::select::Selected;
use crate::constants::calibrate::{FIRM, KNOWN};
use crate::constants::contest::{BEATEN, DEVIATIONS, IMPLAUSIBLE, PLACE};
use crate::report::{NamedEffect, Verdict};
use crate::rivals::{self, Field, Named, Remains, Rival};
use crate::select::Tier;
use crate::unknown::MODEL;
use crate::wording::{percent, short};

/// Compares the named effects with their rivals, and makes those loose that must not be firm.
pub(super) fn contest(data: &Data<'_>, measured: &Measured, selected: &Selected, explained: &mut Explained) {
    let field = Field {
        samples: data.samples,
        channels: data.channels(),
        signals: &measured.modelled,
        noise: data.gap.floor * data.gap.variance,
        seed: data.options.select.seed,
    };
    let left = explained.left.as_deref().filter(|_| !explained.named.is_empty());
    let of = &data.signatures.discrepancy;
    let weights = data.samples.training();
    let training = data.selector(&selected.statistics, &selected.gram, &weights);
    let named = left.map(|left| Named {
        left,
        discrepancy: of.iter().map(|c| &selected.columns[*c]).collect(),
        prior: of.first().map_or(1.0, |c| training.prior(*c)),
    });
    let found = rivals::contest(&field, &measured.whitened, named.as_ref());
    let after = Named {
        left: left.unwrap_or(&measured.whitened),
        discrepancy: of.iter().map(|c| &selected.columns[*c]).collect(),
        prior: of.first().map_or(1.0, |c| training.prior(*c)),
    };
    let remains = rivals::remains(&field, &measured.whitened, &after);
    let structure = left.map(|left| rivals::structure(&field, &measured.whitened, left));
    let place = structure.map_or(0.0, |s| s.smooth_place + s.local_place + s.interaction);
    let beaten = best(&found);
    let tests = evidence::tests(data, explained, &found, &remains);
    let evidence = MODEL.evidence(&tests);
    let uncertain = evidence.is_some_and(|e| e > MODEL.firm);
    for named in &mut explained.named {
        let per_channel = data.signatures.candidates.iter().any(|c| c.name == named.label && c.per_channel);
        let why = doubt(named, beaten, place, per_channel)
            .or_else(|| uncertain.then(|| suspicion(&remains, evidence.is_some_and(|e| e > MODEL.unknown))));
        if let Some(why) = why {
            named.tier = Tier::Loose;
            explained.warnings.push(format!("{} is not named firmly: {why}", named.label));
        }
    }
    // No right name of the calibration was beaten so.
    let called = beaten.is_some() || evidence.is_some_and(|e| e > MODEL.unknown);
    explained.contested = called;
    explained.judged = Judged {
        evidence,
        threshold: evidence.map(|_| MODEL.unknown),
        tests,
        shape: remains.strongest().filter(|_| called).map(|(_, share, what)| (what.clone(), *share)),
    };
    (explained.rivals, explained.structure) = (found, structure);
}

/// What speaks for "unknown".
#[derive(Debug, Clone, Default)]
pub(super) struct Judged {
    /// Logarithm of its odds.
    pub evidence: Option<f64>,
    /// From which on the cause is called so.
    pub threshold: Option<f64>,
    /// What was measured, by name.
    pub tests: BTreeMap<String, f64>,
    /// Where the cause is called so, what the names leave is shaped like, and its share of the gap.
    pub shape: Option<(String, f64)>,
}

/// Why a name is not firm that the calibration makes uncertain.
fn suspicion(remains: &Remains, called: bool) -> String {
    let share = if called { KNOWN } else { FIRM };
    format!(
        "it leaves {} % of the gap, and what it leaves is more like what wrong names leave than in {} % of simulated devices whose \
         cause is in the library",
        percent(remains.left.max(0.0)),
        percent(share)
    )
}

/// The rival that leaves least, where it clearly beats the named effects.
fn best(rivals: &[Rival]) -> Option<&Rival> {
    let beats =
        |r: &&Rival| r.excess.is_some_and(|e| e > BEATEN) && r.deviations.is_some_and(|d| d > DEVIATIONS);
    rivals.iter().filter(beats).max_by(|a, b| a.excess.unwrap_or(0.0).total_cmp(&b.excess.unwrap_or(0.0)))
}

/// Why a name is not firm, if it is not.
fn doubt(named: &NamedEffect, beaten: Option<&Rival>, place: f64, per_channel: bool) -> Option<String> {
    if let Some(rival) = beaten {
        return Some(format!(
            "{} explains {} % more of the gap on other locations",
            rival.what,
            percent(rival.excess.unwrap_or(0.0))
        ));
    }
    if !named.written {
        return Some(
            "it cannot be switched on in a simulation, so that nothing but its signature speaks for it"
                .to_owned(),
        );
    }
    // What another name of it would have to be is nothing against it.
    let alias = |name: &str| named.class.iter().any(|a| a.alias && a.name == name);
    let strange =
        named.theta.iter().find(|v| !alias(&v.name) && v.plausibility.is_some_and(|p| p < IMPLAUSIBLE));
    if let Some(value) = strange {
        return Some(format!(
            "its {} would have to be {}, which no such device has",
            value.name,
            short(value.value)
        ));
    }
    (per_channel && place > PLACE).then(|| {
        format!(
            "{} % of the gap still goes with the place, which an error of channels does not leave",
            percent(place)
        )
    })
}

/// The verdict of a report that is complete otherwise: beside a name that is another thing's the rest is unknown.
pub(super) fn verdict(verdict: Verdict, contested: bool) -> Verdict {
    if contested && verdict == Verdict::Named { Verdict::NamedAndUnknown } else { verdict }
}

#[cfg(test)]
mod tests {
    use dermis_skin::Effect;

    use super::super::report::known_effect;
    use super::*;
    use crate::rivals::Shape;

    fn rival(excess: f64, deviations: f64) -> Rival {
        Rival {
            shape: Shape::Place,
            what: "a change of some locations".to_owned(),
            explains: 0.9,
            excess: Some(excess),
            deviations: Some(deviations),
        }
    }

    #[test]
    fn a_rival_beats_a_name_only_by_much_and_surely() {
        assert!(best(&[rival(0.5 * BEATEN, 9.0), rival(0.5, 0.5 * DEVIATIONS)]).is_none());
        let all = [rival(2.0 * BEATEN, 9.0), rival(0.5, 9.0)];
        assert_eq!(best(&all).and_then(|r| r.excess), Some(0.5));
    }

    #[test]
    fn a_name_that_is_another_things_stands_beside_unknown() {
        assert_eq!(verdict(Verdict::Named, true), Verdict::NamedAndUnknown);
        assert_eq!(verdict(Verdict::Named, false), Verdict::Named);
        assert_eq!(verdict(Verdict::Unmeasured, true), Verdict::Unmeasured);
    }

    #[test]
    fn names_are_doubted_for_what_speaks_against_them() {
        let firm = known_effect(&Effect::new("e").with("size", 1.0), "", "");
        assert_eq!(doubt(&firm, None, 0.0, true), None);
        assert!(doubt(&firm, Some(&rival(0.3, 9.0)), 0.0, true).unwrap().contains("30 % more"));
        assert!(doubt(&firm, None, 0.5, true).unwrap().contains("goes with the place"));
        // A law of the medium may leave what goes with the place.
        assert_eq!(doubt(&firm, None, 0.5, false), None);
        let mut unwritten = firm.clone();
        unwritten.written = false;
        assert!(doubt(&unwritten, None, 0.0, false).unwrap().contains("cannot be switched on"));
        let mut strange = firm.clone();
        strange.theta[0].plausibility = Some(0.01);
        assert!(doubt(&strange, None, 0.0, false).unwrap().contains("size would have to be 1"));
    }

    #[test]
    fn what_makes_a_name_uncertain_is_said() {
        let remains = Remains { left: 0.2, beyond: Vec::new() };
        assert!(suspicion(&remains, true).contains("20 % of the gap"));
        assert!(suspicion(&remains, true).contains("98 %") && suspicion(&remains, false).contains("80 %"));
        assert!(remains.strongest().is_none());
    }
}
