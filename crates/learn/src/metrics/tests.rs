use super::*;
use crate::dataset::tests::contact;

const ID: SampleId = SampleId { run: 0, sample: 0 };

/// The middle of the surface is 3 mm and 4 mm from the origin.
const RULE: Rule = Rule {
    centre: Some(Point3::new(0.003, 0.004, 0.1)),
    position: true,
    normal_force: true,
    force: [true; 3],
    depth: false,
};

fn truth(location: u32, contacts: Vec<TruthContact>) -> Truth {
    Truth { press: u64::from(location), location, idle: false, contacts }
}

fn at(x: f64, y: f64, force: f64) -> Answer {
    Answer {
        position: Some([x, y, 0.0]),
        normal_force: Some(force),
        contact: Some(true),
        ..Answer::default()
    }
}

#[test]
fn figures_are_those_computed_by_hand() {
    let mut scores = Scores::new(RULE);
    // Distances 5, 0 and 1 mm; force errors +1, -2 and 0 N.
    scores.push(ID, &truth(1, vec![contact(0.0, 0.0, 1.0)]), &at(0.003, -0.004, 2.0));
    scores.push(ID, &truth(2, vec![contact(0.01, 0.0, 3.0)]), &at(0.01, 0.0, 1.0));
    scores.push(ID, &truth(3, vec![contact(0.0, 0.01, 3.5)]), &at(0.0, 0.011, 3.5));
    let s = scores.summaries(1);
    let position = &s["position"];
    approx::assert_relative_eq!(position.rms, (26e-6_f64 / 3.0).sqrt(), max_relative = 1e-9);
    approx::assert_relative_eq!(position.mean, 0.002, max_relative = 1e-9);
    approx::assert_relative_eq!(position.median, 0.001, max_relative = 1e-9);
    approx::assert_relative_eq!(position.p95, 0.0046, max_relative = 1e-9);
    approx::assert_relative_eq!(position.max, 0.005, max_relative = 1e-9);
    assert_eq!((position.samples, position.groups, position.bias), (3, 3, None));
    let force = &s["force.normal"];
    approx::assert_relative_eq!(force.rms, (5.0_f64 / 3.0).sqrt(), max_relative = 1e-9);
    approx::assert_relative_eq!(force.bias.unwrap(), -1.0 / 3.0, max_relative = 1e-9);
    approx::assert_relative_eq!(s["position.y"].rms, (17e-6_f64 / 3.0).sqrt(), max_relative = 1e-9);
    assert!(!s.contains_key("position.z"));
    let [low, high] = position.rms_interval.unwrap();
    assert!(low < position.rms && position.rms <= high && high <= 0.005 + 1e-12);

    let bins = &scores.by_force(&FORCE_BINS)["force.normal"];
    let rows: Vec<(f64, usize, f64)> = bins.iter().map(|b| (b.from, b.samples, b.rms)).collect();
    assert_eq!(rows, [(1.0, 1, 1.0), (2.0, 2, 2.0_f64.sqrt())]);
}

#[test]
fn missed_and_false_contacts_are_counted() {
    let mut scores = Scores::new(RULE);
    let none = Answer { contact: Some(false), normal_force: Some(0.0), ..Answer::default() };
    scores.push(ID, &truth(1, vec![contact(0.0, 0.0, 2.0)]), &none);
    scores.push(ID, &truth(1, vec![contact(0.0, 0.0, 2.0)]), &at(0.0, 0.0, 2.0));
    scores.push(ID, &truth(1, vec![]), &at(0.0, 0.0, 0.5));
    assert_eq!((scores.missed(), scores.false_contacts()), (Some(0.5), Some(1.0)));
    let s = scores.summaries(1);
    assert_eq!((s["position"].samples, s["force.normal"].samples), (2, 2));
    // The one that was missed is 5 mm from the middle of the surface; what was found is listed apart.
    approx::assert_relative_eq!(s["position"].rms, 0.005 / 2.0_f64.sqrt(), max_relative = 1e-9);
    assert_eq!((s["position found"].samples, s["position found"].rms), (1, 0.0));
    assert_eq!((s["force.normal found"].samples, s["force.normal found"].rms), (1, 0.0));
    approx::assert_relative_eq!(s["force.normal"].rms, 2.0_f64.sqrt(), max_relative = 1e-9);
    approx::assert_relative_eq!(s["force.normal untouched"].rms, 0.5, max_relative = 1e-9);
    assert_eq!(s["force.normal"].rms_interval, None);
}

#[test]
fn frames_without_an_answer_count_in_number_and_position() {
    let mut scores = Scores::new(RULE);
    let pair = truth(1, vec![contact(0.0, 0.0, 2.0), contact(0.006, 0.0, 3.0)]);
    scores.unanswered(ID, &truth(2, vec![contact(0.0, 0.0, 2.0)]));
    scores.unanswered(ID, &pair);
    let mut found = Contact::at(Point3::new(0.006, 0.001, 0.0), Vector3::z());
    found.force = Vector3::new(0.0, 0.0, -3.5);
    found.force_components = ForceComponents::Normal;
    scores.push_contacts(ID, &pair, &[found]);
    scores.push_contacts(ID, &pair, &[]);
    // Of untouched skin nothing can be missed.
    scores.unanswered(ID, &truth(3, vec![]));
    assert_eq!(scores.count_right(), BTreeMap::from([(1, 0.0), (2, 0.0)]));
    let s = scores.summaries(1);
    assert_eq!((s["position"].samples, s["position of 2"].samples), (1, 6));
    assert_eq!((s["position of 2 found"].samples, s["force.normal of 2"].samples), (1, 6));
    approx::assert_relative_eq!(s["position of 2 found"].rms, 0.001, max_relative = 1e-9);
    approx::assert_relative_eq!(s["force.normal of 2 found"].bias.unwrap(), 0.5, max_relative = 1e-9);
    // Three are missed of 2 N, and two of 3 N; the middle of the surface is 0.1 m above.
    let forces: f64 = [2.0, 2.0, 2.0, 3.0, 3.0].iter().sum();
    approx::assert_relative_eq!(s["force.normal of 2"].mean, (forces + 0.5) / 6.0, max_relative = 1e-9);
    let far = (0.003_f64.powi(2) + 0.004_f64.powi(2) + 0.1_f64.powi(2)).sqrt();
    approx::assert_relative_eq!(s["position of 2"].max, far, max_relative = 1e-9);
    let lost = scores.contacts().iter().filter(|c| !c.found).count();
    assert_eq!((scores.contacts().len(), lost), (7, 6));
}

#[test]
fn who_gives_no_position_misses_none() {
    let mut scores = Scores::new(Rule { position: false, ..RULE });
    let force = Answer { normal_force: Some(1.5), ..Answer::default() };
    scores.push(ID, &truth(1, vec![contact(0.0, 0.0, 2.0)]), &force);
    let none = Answer { contact: Some(false), normal_force: Some(1.5), ..Answer::default() };
    scores.push(ID, &truth(1, vec![contact(0.0, 0.0, 2.0)]), &none);
    let s = scores.summaries(1);
    assert!(!s.contains_key("position"));
    // What is said not to touch has no force.
    approx::assert_relative_eq!(s["force.normal"].mean, 1.25, max_relative = 1e-9);
    assert_eq!(s["force.normal found"].samples, 1);
}

#[test]
fn a_force_of_which_one_component_is_known_is_compared() {
    let mut scores = Scores::new(Rule { position: false, force: [true, false, false], ..RULE });
    // The load cell measures along x only.
    let mut known = contact(f64::NAN, f64::NAN, 1.0);
    known.force = Vector3::new(-3.0, f64::NAN, f64::NAN);
    let answer = Answer { force: Some([-2.5, f64::NAN, f64::NAN]), contact: Some(true), ..Answer::default() };
    scores.push(ID, &truth(1, vec![known.clone()]), &answer);
    // What was missed is a force of 0 along x, and says nothing across.
    scores.push(
        ID,
        &truth(1, vec![known]),
        &Answer { contact: Some(false), force: Some([0.0; 3]), ..answer },
    );
    let s = scores.summaries(1);
    assert_eq!(s.keys().collect::<Vec<_>>(), ["force.x", "force.x found"]);
    approx::assert_relative_eq!(s["force.x"].mean, f64::midpoint(0.5, 3.0), max_relative = 1e-12);
    approx::assert_relative_eq!(s["force.x found"].mean, 0.5, max_relative = 1e-12);
}

#[test]
fn infinite_bounds_have_a_median() {
    assert_eq!(median(&mut [f64::INFINITY, 1.0, 2.0]), 2.0);
    assert_eq!(median(&mut [f64::INFINITY; 4]), f64::INFINITY);
    let binned = bins(&[0.0], [(1.0, f64::INFINITY), (1.0, -3.0), (1.0, 1.0)].into_iter());
    assert_eq!((binned[0].rms, binned[0].median), (f64::INFINITY, Some(3.0)));
}

proptest::proptest! {
    #[test]
    fn no_other_assignment_is_shorter(
        true_ones in proptest::collection::vec((-0.02..0.02f64, -0.02..0.02f64), 0..6),
        found in proptest::collection::vec((-0.02..0.02f64, -0.02..0.02f64), 0..6),
    ) {
        /// Sum of distances of the best assignment of `rest` to what `free` marks, every possible one tried.
        fn shortest(rest: &[(f64, f64)], found: &[(f64, f64)], free: usize, pairs: usize) -> f64 {
            if pairs == 0 {
                return 0.0;
            }
            let Some((first, rest)) = rest.split_first() else { return f64::INFINITY };
            let mut least = shortest(rest, found, free, pairs);
            for (f, place) in found.iter().enumerate().filter(|(f, _)| free & (1 << f) != 0) {
                let distance = (first.0 - place.0).hypot(first.1 - place.1);
                least = least.min(distance + shortest(rest, found, free & !(1 << f), pairs - 1));
            }
            least
        }
        let pairs = true_ones.len().min(found.len());
        let least = shortest(&true_ones, &found, (1 << found.len()) - 1, pairs);
        let truth = truth(1, true_ones.iter().map(|(x, y)| contact(*x, *y, 1.0)).collect());
        let contacts: Vec<Contact> = found
            .iter()
            .map(|(x, y)| Contact::at(Point3::new(*x, *y, 0.0), Vector3::z()))
            .collect();
        let distance = |t: usize, f: usize| (contacts[f].position - truth.contacts[t].position).norm();
        let assigned = assign(truth.contacts.len(), contacts.len(), distance);
        let sum: f64 = assigned
            .iter()
            .enumerate()
            .filter_map(|(t, f)| f.map(|f| (contacts[f].position - truth.contacts[t].position).norm()))
            .sum();
        let mut taken: Vec<usize> = assigned.iter().flatten().copied().collect();
        taken.sort_unstable();
        taken.dedup();
        proptest::prop_assert_eq!(taken.len(), pairs);
        approx::assert_abs_diff_eq!(sum, least, epsilon = 1e-10);
    }
}

#[test]
fn intervals_widen_where_samples_repeat_a_location() {
    let spread = |locations: u32| {
        let mut scores = Scores::new(RULE);
        for i in 0..400_u32 {
            let location = i % locations;
            let error = f64::from(location * 7919 % 101) * 1e-5;
            scores.push(ID, &truth(location, vec![contact(0.0, 0.0, 1.0)]), &at(error, 0.0, 1.0));
        }
        let [low, high] = scores.summaries(3)["position"].mean_interval.unwrap();
        high - low
    };
    assert!(spread(10) > 2.0 * spread(400));
}
