//! Errors of the strongest peaks, as section 3.3.4 of the thesis counts them.
//!
//! The number of contacts T is taken as known. Peaks are sorted by their force, and each of the T strongest is held against the true
//! contact that lies nearest to it. Two peaks may be held against the same contact, so that a contact without a peak costs nothing;
//! the errors of [`Row`](super::Row), which assign each contact a peak of its own and count what is missed, are the stricter ones.
//! The second rule takes peak T + 1 in place of peak T where its force is within 10 % of it: spurious peaks between two contacts
//! tend to be of similar strength.

use anyhow::Result;
use dermis_inference::Runtime;
use dermis_learn::real2sim::Pipeline;
use dermis_model::{Indentation, Stimulus};
use dermis_skin::{Contact, Surface};
use serde::Serialize;

use super::Frames;

/// Share of the force of peak T within which peak T + 1 takes its place.
const NEAR: f64 = 0.10;

/// Which peaks are held against the truth.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Rule {
    /// The T strongest.
    Strongest,
    /// Peak T + 1 in place of peak T, where it is nearly as strong.
    NextWithinTenth,
}

/// Errors under a rule.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Strongest {
    /// Contacts of a frame.
    pub contacts: usize,
    /// Which peaks.
    pub rule: Rule,
    /// Frames.
    pub frames: usize,
    /// \[m\] mean distance of a peak from the nearest contact.
    pub position_mean: f64,
    /// \[N\] mean error of its force.
    pub force_mean: f64,
    /// Share of frames with fewer peaks than contacts; the peaks that there are count.
    pub short: f64,
}

/// Of one and of two contacts, under both rules: of the maps of a pipeline, and of the true ones: how far peaks err where the
/// map is known.
pub(super) fn of(
    pipeline: &Pipeline,
    surface: &Surface,
    frames: &Frames,
    runtime: &Runtime,
) -> Result<[Vec<Strongest>; 2]> {
    let mut reader = pipeline.contacts(surface, runtime)?;
    let mut all = [Vec::new(), Vec::new()];
    for contacts in [1, 2] {
        let (mut learned, mut truth) = (Vec::new(), Vec::new());
        for (stimulus, signal) in frames.each(contacts - 1) {
            learned.push((stimulus, reader.candidates(&pipeline.map(signal)?)?));
        }
        for (stimulus, map) in frames.true_maps(contacts - 1) {
            let map: Vec<f64> = map.iter().map(|d| f64::from(*d)).collect();
            truth.push((stimulus, reader.candidates(&map)?));
        }
        for (of, found) in all.iter_mut().zip([&learned, &truth]) {
            of.extend([Rule::Strongest, Rule::NextWithinTenth].map(|rule| sum(contacts, rule, found)));
        }
    }
    Ok(all)
}

fn sum(contacts: usize, rule: Rule, found: &[(&Stimulus, Vec<Contact>)]) -> Strongest {
    let (mut place, mut force, mut peaks, mut short) = (0.0, 0.0, 0, 0);
    for (stimulus, candidates) in found {
        let taken = taken(candidates, contacts, rule);
        short += usize::from(taken.len() < contacts);
        for peak in taken {
            let distance = |c: &&Indentation| (c.position - peak.position).norm();
            let nearest = stimulus.contacts.iter().min_by(|a, b| distance(a).total_cmp(&distance(b)));
            if let Some(truth) = nearest {
                place += distance(&truth);
                force += (peak.normal_force() - truth.force.norm()).abs();
                peaks += 1;
            }
        }
    }
    let mean = |sum: f64| sum / f64::from(peaks.max(1));
    Strongest {
        contacts,
        rule,
        frames: found.len(),
        position_mean: mean(place),
        force_mean: mean(force),
        short: short as f64 / found.len().max(1) as f64,
    }
}

/// The peaks that a rule takes, the strongest first.
fn taken(candidates: &[Contact], contacts: usize, rule: Rule) -> Vec<&Contact> {
    let mut order: Vec<&Contact> = candidates.iter().filter(|c| c.normal_force().is_finite()).collect();
    order.sort_by(|a, b| b.normal_force().total_cmp(&a.normal_force()));
    if rule == Rule::NextWithinTenth
        && let [.., last, next] = order[..order.len().min(contacts + 1)]
        && order.len() > contacts
        && next.normal_force() >= (1.0 - NEAR) * last.normal_force()
    {
        order.swap(contacts - 1, contacts);
    }
    order.truncate(contacts);
    order
}

#[cfg(test)]
mod tests {
    use nalgebra::{Point3, Vector3};

    use super::*;

    fn peak(x: f64, force: f64) -> Contact {
        let mut contact = Contact::at(Point3::new(x, 0.0, 0.0), Vector3::z());
        contact.force = Vector3::new(0.0, 0.0, -force);
        contact
    }

    fn press(x: f64, force: f64) -> Indentation {
        Indentation::sphere(Point3::new(x, 0.0, 0.0), Vector3::new(0.0, 0.0, -force), 0.01)
    }

    #[test]
    fn each_of_the_strongest_is_held_against_the_nearest_contact() {
        let stimulus = Stimulus { contacts: vec![press(0.0, 10.0), press(0.04, 8.0)], ..Stimulus::default() };
        // A spurious peak in the middle; the second contact's is a little weaker.
        let found = vec![peak(0.02, 7.0), peak(0.001, 10.5), peak(0.038, 6.8)];
        let one = [(&stimulus, found)];
        let strongest = sum(2, Rule::Strongest, &one);
        assert!((strongest.position_mean - 0.0105).abs() < 1e-12, "{strongest:?}");
        let next = sum(2, Rule::NextWithinTenth, &one);
        assert!((next.position_mean - 0.0015).abs() < 1e-12, "{next:?}");
        assert!((next.force_mean - 0.85).abs() < 1e-12, "{next:?}");
        assert_eq!((next.frames, next.short), (1, 0.0));
    }

    #[test]
    fn a_peak_that_is_much_weaker_takes_no_place_and_too_few_are_counted() {
        let all = [peak(0.0, 10.0), peak(0.02, 5.0), peak(0.04, 4.4)];
        let locations = |of: Vec<&Contact>| of.iter().map(|c| c.position.x).collect::<Vec<_>>();
        assert_eq!(locations(taken(&all, 2, Rule::NextWithinTenth)), [0.0, 0.02]);
        assert_eq!(locations(taken(&all[..2], 2, Rule::NextWithinTenth)), [0.0, 0.02]);
        let stimulus = Stimulus { contacts: vec![press(0.0, 9.0), press(0.1, 9.0)], ..Stimulus::default() };
        let few = sum(2, Rule::Strongest, &[(&stimulus, vec![peak(0.003, 10.0)])]);
        assert_eq!((few.short, few.frames), (1.0, 1));
        assert!((few.position_mean - 0.003).abs() < 1e-12 && (few.force_mean - 1.0).abs() < 1e-12);
    }
}
