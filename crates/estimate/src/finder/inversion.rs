//! Contacts of maximum likelihood on a forward model.
//!
//! Problem: locations and forces of contacts whose readings, as the forward model has them, are those of a frame. Method: least
//! squares in units of the noise ([`Inverter`]), begun in one of several ways ([`Start`]). Each frame is taken by itself, unless the
//! finder [follows](InversionFinder::following) contacts from frame to frame as a node does. Cost: that of the inverter, a
//! millisecond or so for one contact, tens of them for all pairs of locations; who follows pays for the frames that it passes, too.

use dermis_inversion::{ContactEstimate, Inverter, InverterError, Reading, Search, Solution, SparseSettings};
use dermis_model::{Indentation, Unknowns};
use dermis_skin::{Contact, Estimate, ForceComponents, ImageGrid, Stamp};

use super::{Before, ConditionedFrame, ContactFinder, FindError, GivenMaps, readings, spread_forces};

/// The contacts that an inverter `found` in a frame or, where it found none, those that were `learned`; and whether they are the former.
pub(crate) fn refined(
    inverter: &Inverter,
    found: &[ContactEstimate],
    learned: Vec<Contact>,
) -> (Vec<Contact>, bool) {
    let components = inverter.settings().unknowns.force_components();
    let contacts: Vec<Contact> = found.iter().map(|found| inverted(found, components)).collect();
    if contacts.is_empty() { (learned, false) } else { (contacts, true) }
}

/// What an inverter found, as a contact.
fn inverted(found: &ContactEstimate, components: ForceComponents) -> Contact {
    let mut contact = Contact::at(found.position, found.normal);
    contact.force = found.force;
    contact.force_components = components;
    contact.position_covariance = found.position_covariance;
    contact.force_covariance = found.force_covariance;
    contact
}

/// What a learned model says of a frame.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Learned<'a> {
    /// Its contacts.
    pub(crate) contacts: &'a [Contact],
    /// They are all that there are, as far as it knows: not one, whatever touches.
    pub(crate) complete: bool,
}

/// The contacts that explain readings best, in the manner that a bundle asks for: among all pairs of locations, from all that were `learned`
/// where these are complete; near those of the frame `before` or what was learned; or one after the other, the first near what was learned.
pub(crate) fn search(
    inverter: &Inverter,
    readings: &[Reading],
    learned: Learned<'_>,
    before: &[ContactEstimate],
) -> Result<Solution, InverterError> {
    if inverter.settings().in_pairs() {
        let complete = if learned.complete { learned.starts(inverter) } else { Vec::new() };
        return inverter.search_from(readings, &complete);
    }
    if inverter.settings().search == Search::Near {
        return inverter.search_near(readings, before, &learned.starts(inverter));
    }
    let hint = learned.contacts.first().filter(|c| is_known(c));
    inverter.solve(readings, hint.map(|c| indentation(inverter, c)).as_ref())
}

/// The same, near the contacts before only, which it goes on with: `None` where a search has to tell.
pub(crate) fn follow(
    inverter: &Inverter,
    readings: &[Reading],
    learned: Learned<'_>,
    before: &mut Before,
) -> Result<Option<Solution>, InverterError> {
    let followed = if inverter.settings().search == Search::Near {
        inverter.follow_near(readings, before.likeliest(), &learned.starts(inverter))?
    } else {
        inverter.follow(readings, before.minima(), before.misfit())?
    };
    if let Some(solution) = &followed {
        before.follow(inverter, solution);
    }
    Ok(followed)
}

/// The contacts that explain the readings of the frame of this stamp best. Where they are looked for in pairs, those of the frame before are
/// followed for as long as they explain what they did: as where searches run in the background, if one took no time.
pub(crate) fn solve(
    inverter: &Inverter,
    readings: &[Reading],
    learned: Learned<'_>,
    before: &mut Before,
    stamp: Stamp,
) -> Result<Solution, InverterError> {
    if inverter.settings().in_pairs()
        && let Some(solution) = follow(inverter, readings, learned, before)?
        && !before.may_have_changed(inverter, stamp)
    {
        return Ok(solution);
    }
    let solution = search(inverter, readings, learned, before.likeliest())?;
    before.search(inverter, &solution, stamp);
    Ok(solution)
}

/// What can be said of a frame while a search takes its time: the contacts of the frame `before` or those that were learned, moved to where they
/// explain these readings best; the best single one where there are none.
pub(crate) fn provisional(
    inverter: &Inverter,
    readings: &[Reading],
    learned: Learned<'_>,
    before: &Before,
) -> Result<Solution, InverterError> {
    let mut starts = inverter.settings().indentations(before.likeliest());
    if starts.is_empty() {
        starts = learned.starts(inverter);
    }
    inverter.guess(readings, &starts)
}

fn is_known(contact: &Contact) -> bool {
    contact.position.iter().chain(&contact.force).all(|v| v.is_finite()) && contact.normal_force() > 0.0
}

impl Learned<'_> {
    /// Where a search begins at them.
    fn starts(self, inverter: &Inverter) -> Vec<Indentation> {
        self.contacts.iter().filter(|c| is_known(c)).map(|c| indentation(inverter, c)).collect()
    }
}

/// A contact as what a forward model takes.
fn indentation(inverter: &Inverter, contact: &Contact) -> Indentation {
    inverter.settings().indentation(contact.position, contact.force)
}

/// Where a search for the contacts begins.
pub enum Start {
    /// One contact after the other, as long as another one explains the readings better.
    Greedy,
    /// The best of all pairs of locations.
    Pairs,
    /// What another finder finds; refined together.
    Refine(Box<dyn ContactFinder>),
    /// In the manner of the inverter's settings, as in a node: what another finder finds is where the first contact is
    /// looked for or, of one that finds [all](ContactFinder::complete), where all are; a search of all pairs does without a single one.
    /// Where nothing is found, the answer of the other stands.
    Bundle(Box<dyn ContactFinder>),
    /// Sparse recovery on a grid of locations; refined.
    Sparse(SparseSettings),
    /// Sparse recovery by itself.
    SparseOnly(SparseSettings),
}

impl Start {
    /// The finder that it asks first.
    fn other(&mut self) -> Option<&mut dyn ContactFinder> {
        match self {
            Self::Refine(finder) | Self::Bundle(finder) => Some(finder.as_mut()),
            Self::Greedy | Self::Pairs | Self::Sparse(_) | Self::SparseOnly(_) => None,
        }
    }

    /// The same, to look at.
    fn initializer(&self) -> Option<&dyn ContactFinder> {
        match self {
            Self::Refine(finder) | Self::Bundle(finder) => Some(finder.as_ref()),
            Self::Greedy | Self::Pairs | Self::Sparse(_) | Self::SparseOnly(_) => None,
        }
    }
}

/// What a finder remembers of the frames before.
#[derive(Debug, Default)]
struct Followed {
    before: Before,
    /// Something touched in the last frame.
    present: bool,
}

/// Maximum likelihood on a forward model.
pub struct InversionFinder {
    inverter: Inverter,
    start: Start,
    followed: Option<Followed>,
}

impl InversionFinder {
    /// A finder that begins there.
    #[must_use]
    pub fn new(inverter: Inverter, start: Start) -> Self {
        Self { inverter, start, followed: None }
    }

    /// Follows contacts from frame to frame while they last, as a node does: frames must come in order and without gaps, those that
    /// nobody asks about by [`pass`](ContactFinder::pass). It makes a difference with [`Start::Bundle`] where the settings
    /// [ask for it](dermis_inversion::Settings::follows); all other searches take each frame by itself in a node, too.
    #[must_use]
    pub fn following(mut self) -> Self {
        let follows = matches!(self.start, Start::Bundle(_)) && self.inverter.settings().follows();
        self.followed = follows.then(Followed::default);
        self
    }

    /// Forgets the contacts before where nothing touches now.
    fn watch(&mut self, readings: &[Reading]) {
        let Some(followed) = &mut self.followed else { return };
        let settings = self.inverter.settings();
        // Whatever one contact leaves unexplained: a second one explains it. A node knows such frames by their level.
        let (gain, _) = self.inverter.evidence(readings);
        followed.present = settings.exceeds_threshold((gain, 0.0), followed.present);
        if !followed.present {
            followed.before = Before::default();
        }
    }

    /// Fits contacts to readings, all together.
    fn refine(
        &self,
        readings: &[Reading],
        starts: &[Indentation],
    ) -> Result<Vec<ContactEstimate>, InverterError> {
        if starts.is_empty() {
            return Ok(Vec::new());
        }
        Ok(self.inverter.refine(readings, starts)?.contacts)
    }

    /// The contacts of a frame, and whether the forward model found them: otherwise they are those of the other finder.
    fn search(&mut self, frame: &ConditionedFrame<'_>) -> Result<(Vec<Contact>, bool), FindError> {
        let readings: Vec<_> = readings(frame.signal, frame.flags).collect();
        let others = self.start.other().map(|finder| finder.find(frame)).transpose()?.unwrap_or_default();
        self.watch(&readings);
        let inverter = &self.inverter;
        let found = match &self.start {
            Start::Greedy => inverter.solve(&readings, None)?.contacts,
            Start::Pairs => inverter.search(&readings)?.contacts,
            Start::Bundle(finder) => {
                let learned = Learned { contacts: &others, complete: finder.complete() };
                let mut nothing = Before::default();
                let before = self.followed.as_mut().map_or(&mut nothing, |followed| &mut followed.before);
                let found = solve(inverter, &readings, learned, before, frame.stamp)?.contacts;
                return Ok(refined(inverter, &found, others));
            }
            Start::Refine(_) => {
                let starts: Vec<_> = others.iter().map(|c| indentation(inverter, c)).collect();
                self.refine(&readings, &starts)?
            }
            Start::Sparse(settings) => self.refine(&readings, &inverter.sparse(&readings, settings)?)?,
            Start::SparseOnly(settings) => {
                let components = inverter.settings().unknowns.force_components();
                let found = inverter.sparse(&readings, settings)?;
                return Ok((found.iter().map(|c| placed(inverter, c, components)).collect(), true));
            }
        };
        Ok(refined(inverter, &found, Vec::new()))
    }
}

impl ContactFinder for InversionFinder {
    fn find(&mut self, frame: &ConditionedFrame<'_>) -> Result<Vec<Contact>, FindError> {
        Ok(self.search(frame)?.0)
    }

    fn given_maps(&self) -> GivenMaps {
        self.start.initializer().map_or_else(GivenMaps::default, ContactFinder::given_maps)
    }

    fn estimate(&mut self, frame: &ConditionedFrame<'_>) -> Result<Estimate, FindError> {
        let (contacts, refined) = self.search(frame)?;
        let GivenMaps { force, displacement: displacement_map } = self.given_maps();
        let whole = self.inverter.settings().unknowns == Unknowns::Full;
        let spread = || refined.then(|| spread_forces(self.inverter.surface(), &contacts, whole));
        let force_map = force.or_else(spread);
        Ok(Estimate { contacts, force_map, displacement_map })
    }

    fn pass(&mut self, frame: &ConditionedFrame<'_>) -> Result<(), FindError> {
        self.start.other().map_or(Ok(()), |finder| finder.pass(frame))?;
        if self.followed.is_none() {
            return Ok(());
        }
        let readings: Vec<_> = readings(frame.signal, frame.flags).collect();
        self.watch(&readings);
        if let Some(Followed { before, present: true }) = &mut self.followed {
            // A search in pairs can do without the other finder.
            solve(&self.inverter, &readings, Learned::default(), before, frame.stamp)?;
        }
        Ok(())
    }

    fn reset(&mut self) {
        if let Some(finder) = self.start.other() {
            finder.reset();
        }
        if let Some(followed) = &mut self.followed {
            *followed = Followed::default();
        }
    }

    fn image(&self) -> Option<ImageGrid> {
        self.start.initializer().and_then(ContactFinder::image)
    }
}

/// An indentation that was found without its errors.
fn placed(inverter: &Inverter, at: &Indentation, components: ForceComponents) -> Contact {
    let (position, normal) = inverter.surface().project(&at.position);
    let mut contact = Contact::at(position, normal);
    contact.force = at.force;
    contact.force_components = components;
    contact
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use dermis_inversion::{Search, Settings};
    use dermis_skin::ChannelFlags;
    use nalgebra::{Point3, Vector3};

    use super::*;
    use crate::testing::{membrane, nine};

    /// Finds nothing.
    struct Nothing;

    impl ContactFinder for Nothing {
        fn find(&mut self, _: &ConditionedFrame<'_>) -> Result<Vec<Contact>, FindError> {
            Ok(Vec::new())
        }
    }

    fn inverter(search: Search) -> Inverter {
        let mut settings = Settings::new(0.004, 5.0);
        (settings.contacts, settings.distance, settings.search) = (2, 0.006, search);
        Inverter::new(Arc::new(membrane(&nine())), settings).unwrap()
    }

    fn bundle(search: Search) -> InversionFinder {
        InversionFinder::new(inverter(search), Start::Bundle(Box::new(Nothing)))
    }

    /// What a pad whose gains are so far from its model's reads of two presses, the first of which is so far \[m\] on its way.
    fn read(moved: f64, gains: f64) -> Vec<f32> {
        let press = |x: f64, y: f64, force: f64| {
            Indentation::sphere(Point3::new(x, y, 0.0), Vector3::new(0.0, 0.0, -force), 0.004)
        };
        let presses = [press(-0.007 + moved, -0.006, 1.0), press(0.006, 0.007, 1.2)];
        let gain = |i: usize| 1.0 + gains * (i as f64 * 2.4).sin();
        membrane(&nine()).read(&presses).iter().enumerate().map(|(i, v)| (v * gain(i)) as f32).collect()
    }

    const MS: Stamp = 1_000_000;
    const WELL: [ChannelFlags; 9] = [ChannelFlags::OK; 9];

    fn frame(stamp: Stamp, signal: &[f32]) -> ConditionedFrame<'_> {
        ConditionedFrame { stamp, reading: signal, signal, flags: &WELL, image: &[], image_signal: &[] }
    }

    fn minima(finder: &InversionFinder) -> &[Vec<ContactEstimate>] {
        finder.followed.as_ref().map_or(&[], |followed| followed.before.minima())
    }

    fn locations(found: &[ContactEstimate]) -> Vec<Point3<f64>> {
        found.iter().map(|f| f.position).collect()
    }

    #[test]
    fn a_finder_that_follows_begins_where_the_contacts_were() {
        // A device as designed, and one that differs from its model.
        for gains in [0.0, 0.2] {
            let (first, second, nothing) = (read(0.0, gains), read(0.0005, gains), vec![0.0; 9]);
            let mut finder = bundle(Search::Pairs).following();
            // Frames that were not checked count.
            finder.pass(&frame(0, &first)).unwrap();
            finder.pass(&frame(10 * MS, &first)).unwrap();
            assert_eq!(minima(&finder)[0].len(), 2);
            let before = finder.followed.as_ref().unwrap().before.clone();
            assert_eq!(before.misfit() > 0.0, gains > 0.0);
            let contacts = finder.find(&frame(11 * MS, &second)).unwrap();
            // What a node does with the second frame.
            let node = inverter(Search::Pairs);
            let readings: Vec<_> = readings(&second, &WELL).collect();
            let followed = node.follow(&readings, before.minima(), before.misfit()).unwrap().unwrap();
            assert_eq!(
                contacts.iter().map(|c| c.position).collect::<Vec<_>>(),
                locations(&followed.contacts)
            );
            assert_eq!(locations(&minima(&finder)[0]), locations(&followed.minima[0]));
            // Later a search tells, on the device that differs, whether other contacts explain them better.
            let later = finder.find(&frame(1000 * MS, &second)).unwrap();
            let searched = match gains > 0.0 {
                true => node.search(&readings).unwrap(),
                false => node.follow(&readings, &followed.minima, 0.0).unwrap().unwrap(),
            };
            assert_eq!(later.iter().map(|c| c.position).collect::<Vec<_>>(), locations(&searched.contacts));
            // Contacts that ended are not where the next ones begin.
            finder.pass(&frame(1001 * MS, &nothing)).unwrap();
            assert!(minima(&finder).is_empty());
            finder.find(&frame(1002 * MS, &first)).unwrap();
            assert_eq!(minima(&finder)[0].len(), 2);
            finder.reset();
            assert!(minima(&finder).is_empty());
        }
    }

    #[test]
    fn who_takes_each_frame_by_itself_remembers_nothing() {
        let signal = read(0.0, 0.0);
        for mut finder in [bundle(Search::Pairs), bundle(Search::Greedy).following()] {
            finder.pass(&frame(0, &signal)).unwrap();
            assert_eq!(finder.find(&frame(1, &signal)).unwrap().len(), 2);
            assert!(minima(&finder).is_empty());
        }
    }
}
