use std::path::Path;

use dermis_inference::{Bundle, Runtime, RuntimeChoice, RuntimeConfig};

use super::*;
use crate::dataset::tests::{presses, skin};
use crate::train::{Request, run};

const CONFIG: &str = r#"
    targets = ["position.x", "position.y", "force.normal", "contact"]
    [model]
    candidates = ["network", "gaussian", "vectors"]
    folds = 4
    [network]
    hidden = [4]
    [training]
    # Too few for the network to learn anything.
    epochs = 1
    batch = 256
    learning_rate = 1e-4
"#;

fn train(data: &Dataset, out: &Path) -> crate::train::Outcome {
    let config = TrainConfig::from_toml(CONFIG, "c.toml").unwrap();
    let how = RuntimeConfig { choice: RuntimeChoice::Embedded, library: None };
    let request = Request {
        data,
        others: &[],
        config: &config,
        model: None,
        out,
        resume: false,
        threads: 1,
        processor: crate::train::Processor::Cpu,
        runtime: Runtime::load(&how).unwrap(),
    };
    run(&request, &AtomicBool::new(false), &|_| {}).unwrap()
}

#[test]
fn outputs_are_grouped_by_quantity() {
    let all = groups(&["position.x", "position.y", "force.x", "force.normal", "contact"]);
    let named: Vec<_> = all.iter().map(|g| (g.name, g.columns.clone())).collect();
    assert_eq!(named, [("position", 0..2), ("force", 2..4), ("contact", 4..5)]);
    assert_eq!(groups(&["force.normal"]).len(), 1);
}

#[test]
fn who_errs_least_is_kept_and_answers_from_the_bundle() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("model");
    // Readings are linear in place and force: kernels learn them, and a network in one epoch does not.
    let outcome = train(&presses(16, 1), &out);
    let choice = outcome.choice.as_ref().unwrap();
    assert_eq!((choice.between, choice.folds, choice.judged.len()), ("locations", 4, 3));
    for (group, kept) in &choice.kept {
        let error = |j: &Judged| j.errors[group];
        let least = choice.judged.iter().map(error).fold(f64::INFINITY, f64::min);
        let own = choice.judged.iter().find(|j| j.candidate == *kept).unwrap();
        assert_eq!(error(own), least, "{group}: {choice}");
    }
    assert_ne!(choice.kept["position"], Candidate::Network, "{choice}");
    assert_ne!(choice.kept["force"], Candidate::Network, "{choice}");
    // Locations are 0.6 mm apart over 10 mm, forces 1 to 5 N, and nothing is noisy.
    let figures = outcome.held_out.figures();
    // Three locations are held out, sometimes at the ends; who knows nothing is 3 mm off.
    assert!(figures["position_found_rms"] < 1.5e-3, "{}", outcome.held_out);
    assert!(figures["force_normal_found_rms"] < 0.3, "{}", outcome.held_out);
    let card: serde_json::Value =
        serde_json::from_slice(&std::fs::read(out.join("card.json")).unwrap()).unwrap();
    assert_eq!(card["choice"]["between"], "locations");
    assert_eq!(card["config"]["model"]["folds"], 4);
    assert_eq!(Bundle::load(&out, &skin()).unwrap().manifest().output.values.len(), 4);
}

#[test]
fn a_mean_answers_from_the_bundle_what_its_parts_answer_on_average() {
    let rows = |values: [f64; 2]| Answers::from([("force", values.map(|v| vec![v, 2.0 * v]).to_vec())]);
    assert_eq!(mean(&[rows([1.0, 4.0]), rows([3.0, 5.0])])["force"], [vec![2.0, 4.0], vec![4.5, 9.0]]);

    let data = presses(16, 1);
    let config = TrainConfig::from_toml(CONFIG, "c.toml").unwrap();
    let ids: Vec<SampleId> = data.labelled().map(|(id, ..)| id).collect();
    let inputs: Vec<f32> = (0..ids.len()).map(|i| (i % 13) as f32 * 0.1).collect();
    let targets = inputs.iter().map(|x| x * x).collect();
    let batch = Batch { inputs, targets, width: 1, outputs: 1, ..Batch::default() };
    let table = Table::new(&data, &batch, &ids, &["force.normal"], &config).unwrap();
    let stop = AtomicBool::new(false);
    let mut config = config;
    config.model.candidates = vec![Candidate::Vectors, Candidate::Gaussian, Candidate::Mean];
    let mut choice = table.choose(&config, &stop).unwrap().unwrap();
    assert_eq!(choice.judged.len(), 3);
    assert!(!needs_network(&choice));
    let features = dermis_inference::FeatureConfig::newest(vec![0.0], vec![1.0]);
    let preparation = crate::train::prepare::Preparation::measure(
        crate::train::InputForm::Plain,
        &features,
        &[1.0],
        &batch.inputs,
    );
    let how = RuntimeConfig { choice: RuntimeChoice::Embedded, library: None };
    let runtime = Runtime::load(&how).unwrap();
    let mut answer = |kept: Candidate| {
        choice.kept.insert("force", kept);
        let group = table.groups()[0].clone();
        let kept = table.kept(&group, &choice, 500).unwrap();
        let graph = to_onnx(&[], &[(group, kept)], &preparation, 1).unwrap();
        let interface = dermis_inference::Interface::flat(1, 1);
        let mut model = dermis_inference::Model::load(runtime, &graph, &interface).unwrap();
        let mut out = Vec::new();
        model.run(&[0.55], &mut out).unwrap();
        out[0]
    };
    let (vectors, gaussian) = (answer(Candidate::Vectors), answer(Candidate::Gaussian));
    assert!((vectors - gaussian).abs() > 1e-6, "the test needs two that differ");
    assert!((answer(Candidate::Mean) - (vectors + gaussian) / 2.0).abs() < 1e-5);
}

#[test]
fn several_runs_are_held_out_one_by_one() {
    let dir = tempfile::tempdir().unwrap();
    let runs = [presses(6, 1), presses(7, 1), presses(8, 1)].map(|d| d.runs()[0].clone()).to_vec();
    let outcome = train(&Dataset::from_runs(&skin(), runs), &dir.path().join("model"));
    let choice = outcome.choice.unwrap();
    assert_eq!((choice.between, choice.folds), ("runs", 3));
    insta::assert_snapshot!(choice.to_string().lines().next().unwrap(), @"regressors judged between runs of the training part, 3 folds:");
}

#[test]
fn rows_of_one_fold_are_of_one_location() {
    let data = presses(20, 2);
    let ids: Vec<SampleId> = data.labelled().filter(|(_, _, t)| t.touched()).map(|(id, ..)| id).collect();
    let count = ids.len();
    let batch = Batch {
        inputs: vec![0.0; count],
        targets: vec![0.0; count],
        width: 1,
        outputs: 1,
        ..Batch::default()
    };
    let config = TrainConfig::from_toml(CONFIG, "c.toml").unwrap();
    let table = Table::new(&data, &batch, &ids, &["force.normal"], &config).unwrap();
    let mut by_place: BTreeMap<u32, usize> = BTreeMap::new();
    for (id, fold) in ids.iter().zip(&table.folds) {
        let place = data.sample(*id).unwrap().truth.as_ref().unwrap().location;
        assert_eq!(by_place.entry(place).or_insert(*fold), fold, "location {place}");
    }
    // One place only: the parts are stretches of time.
    let one = presses(1, 30);
    let ids: Vec<SampleId> = one.labelled().map(|(id, ..)| id).collect();
    let batch = Batch {
        inputs: vec![0.0; ids.len()],
        targets: vec![0.0; ids.len()],
        width: 1,
        outputs: 1,
        ..Batch::default()
    };
    let table = Table::new(&one, &batch, &ids, &["force.normal"], &config).unwrap();
    assert_eq!((table.between, table.count), ("stretches of time", 4));
    assert!(table.folds.windows(2).filter(|w| w[0] != w[1]).count() == 3, "each is one stretch");
}

#[test]
fn candidates_that_cannot_be_are_refused() {
    let message = |model: &str| {
        let text = format!("targets = [\"force.normal\"]\n[model]\n{model}");
        TrainConfig::from_toml(&text, "c.toml").unwrap_err().to_string()
    };
    insta::assert_snapshot!(message("candidates = [\"network\", \"trees\"]"), @"c.toml: field `model.candidates[1]`: is extra trees, which no bundle can hold: the embedded runtime has no operator for them; `dermis compare` measures them");
    insta::assert_snapshot!(message("candidates = [\"vectors\", \"vectors\"]"), @"c.toml: field `model.candidates[1]`: support vectors is already a candidate");
    insta::assert_snapshot!(message("candidates = [\"vectors\", \"mean\"]"), @"c.toml: field `model.candidates[1]`: is the mean of all others, and there are fewer than two");
    insta::assert_snapshot!(message("candidates = []"), @"c.toml: field `model.candidates`: is empty: someone has to be the model");
    insta::assert_snapshot!(message("folds = 1"), @"c.toml: field `model.folds`: is 1 and must be 2 to 20");
    let maps = "targets = [\"map.normal\"]\n[model]\ncandidates = [\"gaussian\"]";
    insta::assert_snapshot!(TrainConfig::from_toml(maps, "c.toml").unwrap_err(), @"c.toml: field `model.candidates`: is for scalar targets and dense networks; leave it out, or maps and `network.conv`");
}
