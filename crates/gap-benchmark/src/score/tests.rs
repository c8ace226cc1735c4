use super::*;
use crate::Cell;

#[test]
fn wilson_is_what_tables_say() {
    // Wilson 1927: 0 of 30 is at most 11.4 %, 9 of 10 lies between 59.6 and 98.2 %.
    let [low, high] = Share { hits: 0.0, of: 30 }.interval();
    assert!(low == 0.0 && (high - 0.1135).abs() < 1e-3, "{high}");
    let [low, high] = Share { hits: 9.0, of: 10 }.interval();
    assert!((low - 0.596).abs() < 1e-3 && (high - 0.982).abs() < 1e-3, "{low} {high}");
}

/// A ground truth of one cause, as JSON says it.
fn truth(kind: &str, cause: &str, region: &serde_json::Value) -> GroundTruth {
    let causes = match cause {
        "" => serde_json::json!([]),
        _ => {
            serde_json::json!([{ "id": cause, "strength": 0.5, "seed": 1, "what": "", "parameters": { "size": 0.5 },
            "region": region }])
        }
    };
    serde_json::from_value(serde_json::json!({
        "schema": "gap-ground-truth/1", "generator": "", "case": "case-0001", "kind": kind, "salt": "",
        "seed": 1, "causes": causes, "gap": if cause.is_empty() { 0.0 } else { 3.0 }, "noise": 1.0, "floor": 0.01,
        "unexplained": 0.03, "alone": [0.03], "numerics": crate::Numerics::default(), "only_warmer": false,
        "size": 1.0,
    }))
    .unwrap()
}

fn says(classes: &[&[&str]]) -> Answer {
    let named = |class: &&[&str]| Named {
        class: class.iter().map(|n| (*n).to_owned()).collect(),
        firm: true,
        ..Named::default()
    };
    Answer {
        gap: true,
        ranking: classes.iter().flat_map(|c| c.iter().map(|n| (*n).to_owned())).collect(),
        named: classes.iter().map(named).collect(),
        ..Answer::default()
    }
}

#[test]
fn answers_are_scored_by_what_the_library_holds() {
    let mapping = Mapping::from_toml(
        "[causes]\nleads = { names = [\"dead\", \"gain\"], parameter = \"dead.loss\", axes = [\"channel\"] }\n\
         hole = { names = [\"void\"], axes = [\"place\"] }\n",
    )
    .unwrap();
    let library: BTreeSet<String> = ["dead", "gain", "friction"].map(str::to_owned).into();
    let channels = serde_json::json!({ "kind": "channels", "names": ["g3"] });
    let place = serde_json::json!({ "kind": "place", "at": [0.0, 0.0, 0.0], "within": 0.01 });
    let leads = truth("singles", "leads", &channels);
    let hole = truth("out-of-library", "hole", &place);
    let none = truth("controls", "", &serde_json::Value::Null);

    let mut right = says(&[&["dead", "friction"]]);
    right.axes = vec!["force".to_owned(), "channel".to_owned()];
    right.channel = Some("g3".to_owned());
    right.named[0].parameters.insert("dead.loss".to_owned(), (0.6, Some([0.4, 0.55])));
    right.residual_reduction = Some([0.9, 0.85]);
    (right.interval, right.elsewhere) = (Some([0.8, 0.95]), Some(0.7));
    let mut unknown = Answer { gap: true, unknown: true, unexplained: Some(0.9), ..Answer::default() };
    unknown.peak = Some([0.02, 0.0, 0.0]);
    let alarm = says(&[&["friction"]]);
    let cases = [(&leads, &right), (&hole, &unknown), (&none, &alarm), (&none, &Answer::default())];
    let scorecard = Scorecard::new(cases, &mapping, &library);
    let s = &scorecard.headline;
    let of = |share: Share| (share.hits, share.of);
    assert_eq!((of(s.top1), of(s.class), of(s.top3)), ((0.5, 1), (1.0, 1), (1.0, 1)));
    assert_eq!((of(s.unknown_found), of(s.unknown_at_2)), ((1.0, 1), (1.0, 1)));
    assert_eq!((of(s.false_alarms), of(s.precision)), ((1.0, 2), (0.0, 1)));
    assert_eq!((of(s.axis), of(s.axis_of_two)), ((0.0, 2), (1.0, 2)));
    assert_eq!((of(s.region), of(s.located)), ((1.0, 2), (1.0, 2)));
    assert_eq!((of(s.reduction_covered), of(s.elsewhere_covered)), ((1.0, 1), (0.0, 1)));
    assert!((median(&s.parameter_errors) - 0.2).abs() < 1e-9 && of(s.covered) == (1.0, 1));
    assert_eq!(scorecard.not_in_library, ["void"]);
    // Nine tenths to two names, one tenth to four answers.
    let probability = right.probability(mapping.of("leads"), &library);
    assert!((probability - (0.45 + 0.05)).abs() < 1e-9, "{probability}");
    assert!(scorecard.table().contains("| friction |") || scorecard.table().contains("1× friction"));
}

#[test]
fn cases_that_differ_in_kind_are_counted_apart() {
    let mapping = Mapping::from_toml(Mapping::TEXT).unwrap();
    let nothing = serde_json::Value::Null;
    let of = |cause: &str| truth("singles", cause, &nothing);
    for (cause, counts) in [
        ("element-gains", Cell::SameLaw),
        ("creeping", Cell::OtherLaw),
        ("preisach-friction", Cell::OtherLaw),
        ("built-poisson", Cell::DesignNumber),
        ("cable-tug", Cell::DoesNotRepeat),
        ("soft-spot", Cell::Foreign),
        ("", Cell::Controls),
    ] {
        assert_eq!(cell(&of(cause), &mapping), counts, "{cause}");
    }
    // What a tool does not have is foreign to it, and what it has beyond the literature has a law of its own.
    assert_eq!(cell(&of("element-gains"), &mapping.within(&BTreeSet::new())), Cell::Foreign);
    assert_eq!(cell(&of("warming-up"), &mapping), Cell::OtherLaw);

    let mut cells = Cells::default();
    let known = of("creeping");
    let right = says(&[&["relaxation = something.path", "modulus"]]);
    let mut unknown = Answer { gap: true, unknown: true, unexplained: Some(0.9), ..Answer::default() };
    cells.add(&known, &right, &mapping);
    cells.add(&known, &unknown, &mapping);
    unknown.evidence = Some(3.0);
    cells.add(&of("soft-spot"), &unknown, &mapping);
    cells.add(&of(""), &says(&[&["modulus"]]), &mapping);
    let other = &cells.cells[&Cell::OtherLaw];
    let of = |share: Share| (share.hits, share.of);
    assert_eq!((of(other.first), of(other.class), of(other.unknown)), ((0.5, 2), (1.0, 2), (1.0, 2)));
    assert_eq!((of(other.firm), of(other.loose)), ((0.0, 0), (1.0, 1)));
    assert_eq!(of(cells.cells[&Cell::Foreign].unknown_only), (1.0, 1));
    assert_eq!(of(cells.false_names[&crate::set::Disturbance::Plain]), (1.0, 1));
    assert_eq!(cells.unknown.unwrap().value, 1.0);
    assert!(cells.table().contains("| systematic and foreign | 1 |"), "{}", cells.table());
}

#[test]
fn every_cause_is_mapped_once() {
    let mapping = Mapping::from_toml(Mapping::TEXT).unwrap();
    let known: BTreeSet<String> = crate::every_cause().map(|c| c.id.to_owned()).collect();
    assert_eq!(mapping.causes.keys().cloned().collect::<BTreeSet<_>>(), known);
}
