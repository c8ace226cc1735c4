use std::collections::BTreeMap;

use dermis_skin::SkinDescription;

use super::generate::wanted;
use super::*;
use crate::Designs;

const LINE: &str = include_str!("../../../../launch/skins/baro-line.toml");

fn order(kind: Kind, count: usize) -> SetSpec {
    SetSpec { cases: vec![(kind, count)], seed: 11, size: 0.12, cells: false }
}

#[test]
fn a_set_is_sealed_and_the_same_every_time() {
    let dir = tempfile::tempdir().unwrap();
    let (set, ground_truths) = (dir.path().join("set"), dir.path().join("truths"));
    let made = generate(LINE, &order(Kind::Singles, 3), &Designs::default(), &set, &ground_truths, |_| true)
        .unwrap();
    assert_eq!(Manifest::load(&set).unwrap(), made);
    for case in &made.cases {
        let truth = open_ground_truth(&ground_truths, case).unwrap();
        if truth.kind == Kind::Singles {
            let [withheld] = &truth.causes[..] else { panic!("{truth:?}") };
            assert!(!withheld.what.is_empty() && !withheld.parameters.is_empty());
            let reached = truth.unexplained / (truth.gap * truth.floor);
            assert!((0.7..1.5).contains(&reached), "{reached}: {truth:?}");
        }
        // Nothing public names what is withheld.
        let public = std::fs::read_to_string(set.join("manifest.json")).unwrap();
        for withheld in &truth.causes {
            assert!(!public.contains(&withheld.cause.id));
        }
    }
    let (set2, ground_truths2) = (dir.path().join("set2"), dir.path().join("truths2"));
    let again =
        generate(LINE, &order(Kind::Singles, 3), &Designs::default(), &set2, &ground_truths2, |_| true)
            .unwrap();
    let seals = |m: &Manifest| m.cases.iter().map(|c| c.ground_truth_sha256.clone()).collect::<Vec<_>>();
    assert_eq!(seals(&again), seals(&made));

    let case = &made.cases[0];
    let path = ground_truths.join(format!("{}.json", case.id));
    let text = std::fs::read_to_string(&path).unwrap();
    std::fs::write(&path, text.replace("\"seed\": 11", "\"seed\": 12")).unwrap();
    let refused = open_ground_truth(&ground_truths, case).unwrap_err().to_string();
    assert!(refused.contains("was changed after it was sealed"), "{refused}");
    let taken = generate(LINE, &order(Kind::Singles, 3), &Designs::default(), &set, &ground_truths, |_| true)
        .unwrap_err()
        .to_string();
    assert!(taken.contains("is not empty"), "{taken}");
}

#[test]
fn every_cause_is_dealt_as_often_as_any_other() {
    let skin = SkinDescription::from_toml(LINE, "line").unwrap();
    let known = crate::causes(&skin).unwrap();
    let listed = known.iter().filter(|k| k.listed).count();
    assert!(listed >= 12 && known.len() - listed >= 8);
    let cases = wanted(&order(Kind::Singles, 15 * listed), known);
    let mut seen: BTreeMap<(&str, u8, u8), usize> = BTreeMap::new();
    for case in &cases {
        *seen.entry((case.causes[0].id, case.gap as u8, (2.0 * case.noise) as u8)).or_default() += 1;
    }
    assert_eq!(seen.len(), 15 * listed, "every cause at every gap and noise level, once");
    for case in wanted(&order(Kind::Triples, 3), known) {
        assert_eq!(case.causes.len(), 3);
    }
    assert!(wanted(&order(Kind::Controls, 3), known).iter().all(|c| c.causes.is_empty()));
}

#[test]
fn sets_and_ground_truths_with_old_names_are_read() {
    let skin = SkinDescription::from_toml(LINE, "line").unwrap();
    let known = crate::causes(&skin).unwrap();
    let renamed = [("mains-hum", "mains-interference"), ("bent-characteristic", "nonlinear-characteristic")];
    for (old, now) in renamed {
        let truth: GroundTruth = serde_json::from_value(serde_json::json!({
            "schema": "gap-secret/1", "generator": "", "case": "case-0001", "kind": "foreign", "salt": "",
            "seed": 1, "causes": [{ "id": old, "strength": 0.5, "seed": 1, "what": "", "parameters": {} }],
            "gap": 3.0, "noise": 1.0, "floor": 0.01, "unexplained": 0.03, "alone": [0.03],
            "form": Numerics::default(), "only_warmer": false, "size": 1.0,
        }))
        .unwrap();
        assert_eq!(truth.causes[0].cause.id, now);
        assert!(known.iter().any(|k| k.id == now), "{now}");
    }
    let dir = tempfile::tempdir().unwrap();
    let case = r#"{ "id": "case-0001", "bag": "b", "secret_sha256": "s", "bag_sha256": "b", "presses": 0 }"#;
    let manifest = format!(
        r#"{{ "schema": "gap-pack/1", "generator": "", "kind": null, "skin": "s", "skin_hash": "h", "size": 1,
        "cases": [{case}] }}"#
    );
    std::fs::write(dir.path().join("manifest.json"), manifest).unwrap();
    assert_eq!(Manifest::load(dir.path()).unwrap().cases[0].ground_truth_sha256, "s");
}
