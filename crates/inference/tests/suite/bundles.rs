//! What a bundle is refused for, and that one that fits works from frame to named output.

use std::path::{Path, PathBuf};

use dermis_inference::{
    Baseline, Bundle, BundleError, BundleWriter, CorrectionSection, FeatureConfig, Manifest, Missing,
    OutputConfig, OutputSpec, Taps, TrainingSection,
};
use dermis_inversion::{Correction, Settings};
use dermis_skin::SkinDescription;
use proptest::prelude::*;
use sha2::{Digest, Sha256};

use crate::graphs;
use crate::runtimes::embedded;

/// A skin of one channel per name.
fn skin(name: &str, unit: &str, channels: &[&str]) -> SkinDescription {
    let taxels: String = channels
        .iter()
        .enumerate()
        .map(|(i, c)| format!("{{ name = \"{c}\", position = [{}, 0.0, -0.002] }},", 0.001 * i as f64))
        .collect();
    let text = format!(
        "schema = \"dermis-skin/1\"\nname = \"{name}\"\nsensor = \"taxels\"\nframe_id = \"link\"\nunit = \"{unit}\"\n\
         rate = 100.0\nnoise = 1.0\nsurface = {{ type = \"rectangle\", size = [0.02, 0.02], spacing = 0.01 }}\n\
         taxels = [{taxels}]"
    );
    SkinDescription::from_toml(&text, "test").unwrap()
}

const CHANNELS: [&str; 5] = ["a", "b", "c", "d", "e"];

fn pad() -> SkinDescription {
    skin("pad", "Pa", &CHANNELS)
}

/// A bundle of the three-layer network for [`pad`].
fn writer() -> BundleWriter {
    let input = FeatureConfig::newest(vec![100.0; 5], vec![50.0; 5]);
    let output = OutputConfig {
        values: vec![
            OutputSpec::new("position.x", "m", 0.01, 0.005),
            OutputSpec::new("position.y", "m", 0.0, 0.005),
            OutputSpec::new("force.normal", "N", 2.0, 1.0),
        ],
    };
    let training = TrainingSection {
        data_hash: "sha256:0".into(),
        seed: 7,
        samples: 1000,
        held_out: "a fifth of the presses".into(),
    };
    let mut writer =
        BundleWriter::new(Manifest::new("pad-mlp", &pad(), Baseline::Tared, input, output, training));
    writer.manifest.metrics.insert("position_rmse_m".into(), 0.000_45);
    writer.manifest.force_range = Some([0.0, 8.0]);
    writer.card.insert("note".into(), "made by a test".into());
    writer
}

struct OnDisk {
    folder: tempfile::TempDir,
    path: PathBuf,
}

impl OnDisk {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("pad-mlp");
        writer().write(&path, &graphs::mlp().bytes).unwrap();
        Self { folder, path }
    }

    /// Changes the manifest's text.
    fn edit(&self, from: &str, to: &str) {
        let path = self.path.join("bundle.toml");
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(text.contains(from), "{from} is not in\n{text}");
        std::fs::write(path, text.replacen(from, to, 1)).unwrap();
    }

    /// Replaces the graph and makes the manifest agree with it.
    fn replace_graph(&self, bytes: &[u8]) {
        replace_graph(&self.path, bytes);
    }

    /// The refusal, with the folder's own path and hashes shortened.
    fn refusal(&self, skin: &SkinDescription) -> String {
        let text = Bundle::load(&self.path, skin).unwrap_err().to_string();
        self.shorten(&text)
    }

    fn shorten(&self, text: &str) -> String {
        let text = text.replace(self.folder.path().to_str().unwrap(), "");
        let mut short = String::new();
        for (i, part) in text.split("sha256:").enumerate() {
            let part = if i > 0 && part.len() >= 64 {
                assert!(part.as_bytes()[..64].iter().all(u8::is_ascii_hexdigit), "{part}");
                short.push('#');
                &part[64..]
            } else {
                part
            };
            short.push_str(part);
        }
        short
    }
}

fn replace_graph(path: &Path, bytes: &[u8]) {
    let mut manifest: toml::Table =
        std::fs::read_to_string(path.join("bundle.toml")).unwrap().parse().unwrap();
    let hex: String = Sha256::digest(bytes).iter().map(|b| format!("{b:02x}")).collect();
    let model = manifest["model"].as_table_mut().unwrap();
    model.insert("hash".into(), format!("sha256:{hex}").into());
    model.insert("bytes".into(), i64::try_from(bytes.len()).unwrap().into());
    std::fs::write(path.join("bundle.toml"), manifest.to_string()).unwrap();
    std::fs::write(path.join("model.onnx"), bytes).unwrap();
}

#[test]
fn a_frame_becomes_named_outputs() {
    let disk = OnDisk::new();
    let bundle = Bundle::load(&disk.path, &pad()).unwrap();
    assert_eq!(bundle.manifest().metrics["position_rmse_m"], 0.000_45);
    let mut features = bundle.features();
    let mut outputs = bundle.outputs();
    let mut model = bundle.session(embedded()).unwrap().unwrap();
    features.push(0, &[125.0, 100.0, 75.0, f32::NAN, 150.0]).unwrap();
    let mut raw = Vec::new();
    model.run(features.input().unwrap(), &mut raw).unwrap();
    outputs.decode(&raw).unwrap();
    let oracle = graphs::mlp().oracle.unwrap()(&[0.5, 0.0, -0.5, 0.0, 1.0]);
    assert!((outputs.get("position.x").unwrap() - (0.01 + 0.005 * oracle[0])).abs() < 1e-7);
    assert!((outputs.normal_force().unwrap() - (2.0 + oracle[2])).abs() < 1e-5);
}

#[test]
fn what_was_written_is_read_back_exactly() {
    let disk = OnDisk::new();
    let mut wanted = writer();
    wanted.manifest.input = FeatureConfig {
        mean: vec![0.1, 1e-7, 3.0e8, -5.0, 0.3],
        taps: Taps::Seconds(vec![0.0]),
        missing: Missing::Mean,
        ..wanted.manifest.input
    };
    let manifest = wanted.manifest.clone();
    wanted.write(&disk.path, &graphs::mlp().bytes).unwrap();
    let bundle = Bundle::load(&disk.path, &pad()).unwrap();
    assert_eq!(bundle.manifest().input, manifest.input);
    assert_eq!(bundle.manifest().output, manifest.output);
    assert_eq!(bundle.manifest().training, manifest.training);
    let card = std::fs::read_to_string(disk.path.join("card.json")).unwrap();
    assert!(card.contains("made by a test"));
    // An overwritten bundle leaves nothing behind.
    assert_eq!(std::fs::read_dir(disk.folder.path()).unwrap().count(), 1);
}

#[test]
fn missing_parts_are_named() {
    let disk = OnDisk::new();
    let nowhere = Bundle::load(disk.folder.path().join("nowhere"), &pad()).unwrap_err();
    insta::assert_snapshot!(disk.shorten(&nowhere.to_string()), @"model bundle /nowhere: there is no such folder; train one with `dermis train` or correct the path");
    std::fs::remove_file(disk.path.join("model.onnx")).unwrap();
    insta::assert_snapshot!(disk.refusal(&pad()), @"model bundle /pad-mlp: holds no `model.onnx`, so it is not a whole bundle; copy it again or train it anew");
    std::fs::remove_file(disk.path.join("bundle.toml")).unwrap();
    insta::assert_snapshot!(disk.refusal(&pad()), @"model bundle /pad-mlp: holds no `bundle.toml`, so it is not a whole bundle; copy it again or train it anew");
}

#[test]
fn a_truncated_or_damaged_graph_is_refused() {
    let disk = OnDisk::new();
    let bytes = graphs::mlp().bytes;
    std::fs::write(disk.path.join("model.onnx"), &bytes[..500]).unwrap();
    insta::assert_snapshot!(disk.refusal(&pad()), @"model file /pad-mlp/model.onnx: has 500 bytes where bundle.toml field `model.bytes` says 1217: it was cut short or replaced; copy the bundle again");
    let mut flipped = bytes;
    flipped[300] ^= 1;
    std::fs::write(disk.path.join("model.onnx"), flipped).unwrap();
    insta::assert_snapshot!(disk.refusal(&pad()), @"model file /pad-mlp/model.onnx: has hash # where bundle.toml field `model.hash` says #: it was damaged or replaced; copy the bundle again");
}

#[test]
fn a_graph_that_is_none_or_another_is_refused_though_its_hash_fits() {
    let disk = OnDisk::new();
    disk.replace_graph(b"<html>404 Not Found</html>");
    insta::assert_snapshot!(disk.refusal(&pad()), @"model file /pad-mlp/model.onnx: is not an ONNX model: it is cut short or garbled; export it again");
    disk.replace_graph(&graphs::all()[1].bytes);
    insta::assert_snapshot!(disk.refusal(&pad()), @"model file /pad-mlp/model.onnx: has input `input` [1, 4] where `input` [1, 5] is declared; export it again with that input");
}

#[test]
fn another_skin_is_refused_with_what_differs() {
    let disk = OnDisk::new();
    insta::assert_snapshot!(disk.refusal(&skin("glove", "Pa", &["a", "b", "x", "d"])), @"model bundle /pad-mlp: was trained for skin `pad` (#), not for `glove` (#): the bundle has channels `c`, `e` where the skin has `x`; train a model for this skin");
    insta::assert_snapshot!(disk.refusal(&skin("pad", "Pa", &["a", "c", "b", "d", "e"])), @"model bundle /pad-mlp: was trained for skin `pad` (#), not for `pad` (#): the channels are in another order: channel 1 is `b` in the bundle and `c` in the skin; train a model for this skin");
    insta::assert_snapshot!(disk.refusal(&skin("pad", "T", &CHANNELS)), @r#"model bundle /pad-mlp: was trained for skin `pad` (#), not for `pad` (#): the bundle's unit is "Pa" and the skin's is "T"; train a model for this skin"#);
    let mut moved = skin("pat", "Pa", &CHANNELS);
    moved.taxels[0].position[0] += 0.001;
    insta::assert_snapshot!(disk.refusal(&moved), @"model bundle /pad-mlp: was trained for skin `pad` (#), not for `pat` (#): channels and unit are the same, but the surface, taxel positions, ranges, noise or medium differ; train a model for this skin");
    insta::assert_snapshot!(disk.refusal(&skin("pad", "Pa", &["a", "b", "c", "d"])), @"model bundle /pad-mlp: was trained for skin `pad` (#), not for `pad` (#): the bundle has channels that the skin lacks: `e`; train a model for this skin");
}

#[test]
fn every_device_of_the_type_takes_the_bundle() {
    let disk = OnDisk::new();
    let renamed = skin("left-pad", "Pa", &CHANNELS);
    assert_eq!(Bundle::load(&disk.path, &renamed).unwrap().manifest().skin.name, "pad");
    let left = pad().into_instance(Some("left_pad"), Some("left_link"), None).unwrap();
    assert_eq!(Bundle::load(&disk.path, &left).unwrap().manifest().skin.hash, pad().hash());

    // A bundle that was trained when the hash still covered the name: of baro-grid that was this.
    let named = "sha256:c725fa4cf5c38301732468e689a2ed1cb162a746611719bfed53b2f350b424f0";
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let text = std::fs::read_to_string(root.join("launch/skins/baro-grid.toml")).unwrap();
    let grid = |text: &str| SkinDescription::from_toml(text, "grid").unwrap();
    let folder = tempfile::tempdir().unwrap();
    let model = folder.path().join("baro-grid");
    std::fs::create_dir(&model).unwrap();
    for file in ["bundle.toml", "card.json", "model.onnx"] {
        std::fs::copy(root.join("models/baro-grid").join(file), model.join(file)).unwrap();
    }
    let manifest = std::fs::read_to_string(model.join("bundle.toml")).unwrap();
    let manifest = manifest.replace(&grid(&text).hash(), named);
    assert!(manifest.contains(named), "the bundle that ships is of another skin");
    std::fs::write(model.join("bundle.toml"), manifest).unwrap();
    let old = Bundle::load(&model, &grid(&text)).unwrap();
    assert_ne!(old.manifest().skin.hash, grid(&text).hash());
    let renamed = text.replace("name = \"baro-grid\"", "name = \"right-palm\"");
    Bundle::load(&model, &grid(&renamed)).unwrap();
    let moved = renamed.replace("[-0.0130, -0.0130, -0.005]", "[-0.0130, -0.0130, -0.006]");
    assert!(matches!(Bundle::load(&model, &grid(&moved)), Err(BundleError::AnotherSkin(_))));
}

#[test]
fn a_device_can_have_a_correction_of_its_own() {
    let learned = OnDisk::corrected();
    let file = learned.path.join("correction.json");
    let shared = OnDisk::new();
    let left = pad().into_instance(Some("left_pad"), None, None).unwrap();
    let mut bundle = Bundle::load(&shared.path, &left).unwrap();
    assert!(bundle.correction().is_none());
    bundle.take_correction(&file, &left).unwrap();
    assert_eq!(bundle.correction(), Some(&correction()));
    let error = bundle.take_correction(&shared.path.join("none.json"), &left).unwrap_err().to_string();
    assert!(error.contains("none.json"), "{error}");
    let mut moved = left.clone();
    moved.taxels[0].position[0] += 0.001;
    let error = bundle.take_correction(&file, &moved).unwrap_err().to_string();
    assert!(error.contains("was learned on skin `pad`"), "{error}");
}

#[test]
fn an_edited_manifest_is_refused() {
    let edited = |from: &str, to: &str| {
        let disk = OnDisk::new();
        disk.edit(from, to);
        disk.refusal(&pad())
    };
    insta::assert_snapshot!(edited("\"a\", \"b\"", "\"b\", \"a\""), @"bundle file /pad-mlp/bundle.toml: field `skin.channels`: the channels are in another order: channel 0 is `b` in the bundle and `a` in the skin, though `skin.hash` is that of skin `pad`; restore the file");
    insta::assert_snapshot!(edited("unit = \"Pa\"", "unit = \"T\""), @r#"bundle file /pad-mlp/bundle.toml: field `skin.unit`: the bundle's unit is "T" and the skin's is "Pa", though `skin.hash` is that of skin `pad`; restore the file"#);
    insta::assert_snapshot!(edited("dermis-bundle/1", "dermis-bundle/2"), @r#"bundle file /pad-mlp/bundle.toml: field `schema`: is "dermis-bundle/2", newer than "dermis-bundle/1"; update dermis or train the model again with this version"#);
    insta::assert_snapshot!(edited("dermis-bundle/1", "dermis-skin/1"), @r#"bundle file /pad-mlp/bundle.toml: field `schema`: is "dermis-skin/1" where this program reads "dermis-bundle/1""#);
    insta::assert_snapshot!(edited("schema = \"dermis-bundle/1\"\n", ""), @r#"bundle file /pad-mlp/bundle.toml: field `schema`: is missing; this program reads "dermis-bundle/1", so the file is no bundle of it"#);
    insta::assert_snapshot!(edited("max_gap", "max_gab"), @"bundle file /pad-mlp/bundle.toml: unknown key `input.max_gab`; remove it or correct its spelling");
    insta::assert_snapshot!(edited("seed = 7", "seed = \"seven\""), @r#"bundle file /pad-mlp/bundle.toml: field `training.seed`: invalid type: string "seven", expected u64"#);
    insta::assert_snapshot!(edited("scale = [50.0", "scale = [0.0"), @"bundle file /pad-mlp/bundle.toml: field `input.scale[0]`: is 0 and must be positive");
    insta::assert_snapshot!(edited("scale = [50.0, ", "scale = ["), @"bundle file /pad-mlp/bundle.toml: field `input.scale`: has 4 entries where `mean` has 5");
    insta::assert_snapshot!(edited("input_shape = [1, 5]", "input_shape = [1, 6]"), @"bundle file /pad-mlp/bundle.toml: field `model.interface.input_shape`: is [1, 6] where [input] takes batch 1 and 5 numbers");
    insta::assert_snapshot!(edited("baseline = \"tared\"", "baseline = \"zeroed\""), @"bundle file /pad-mlp/bundle.toml: field `baseline`: unknown variant `zeroed`, expected `raw` or `tared`");
    insta::assert_snapshot!(edited("name = \"pad-mlp\"", "name = "), @"bundle file /pad-mlp/bundle.toml: field `line 2, column 8`: string values must be quoted, expected literal string");
}

#[test]
fn what_contradicts_itself_is_not_written() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("b");
    let refused = |writer: BundleWriter, graph: &[u8]| {
        writer.write(&path, graph).unwrap_err().to_string().replace(folder.path().to_str().unwrap(), "")
    };
    let mut metric = writer();
    metric.manifest.metrics.insert("force_rmse_n".into(), f64::NAN);
    insta::assert_snapshot!(refused(metric, &graphs::mlp().bytes), @"bundle file /b/bundle.toml: field `metrics.force_rmse_n`: must be a finite number");
    insta::assert_snapshot!(refused(writer(), &graphs::all()[2].bytes), @"model file /b/model.onnx: has input `input` [1, 3] where `input` [1, 5] is declared; export it again with that input");
    assert!(!path.exists());

    std::fs::create_dir(&path).unwrap();
    std::fs::write(path.join("thesis.tex"), "years of work").unwrap();
    insta::assert_snapshot!(refused(writer(), &graphs::mlp().bytes), @"model bundle /b: the folder exists and is no bundle; choose another one");
    assert!(path.join("thesis.tex").exists());
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, failure_persistence: None, ..Default::default() })]

    #[test]
    fn no_manifest_bytes_panic(changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6)) {
        let disk = OnDisk::new();
        let path = disk.path.join("bundle.toml");
        let mut bytes = std::fs::read(&path).unwrap();
        for (at, value) in changes {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        std::fs::write(path, bytes).unwrap();
        if let Ok(bundle) = Bundle::load(&disk.path, &pad()) {
            let _ = bundle.features().push(0, &[0.0; 5]);
        }
    }

    /// A graph that is garbage, but whose hash the manifest names, is refused or runs; the process goes on.
    #[test]
    fn no_graph_bytes_panic(changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..4)) {
        let disk = OnDisk::new();
        let mut bytes = graphs::mlp().bytes;
        for (at, value) in changes {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        disk.replace_graph(&bytes);
        if let Ok(Some(mut model)) = Bundle::load(&disk.path, &pad()).and_then(|bundle| bundle.session(embedded())) {
            let _ = model.run(&[0.5; 5], &mut Vec::new());
        }
    }
}

/// A correction of nothing for five channels.
fn correction() -> Correction {
    let text = r#"{"centres":[[0.0,0.0,0.0]],"length":0.01,"force":2.0,"powers":1,"gains":[1.0,1.1,1.0,0.9,1.0],"weights":[0.5,0.25,0.0,-1.5,2.0]}"#;
    serde_json::from_str(text).unwrap()
}

impl OnDisk {
    /// With a correction.
    fn corrected() -> Self {
        let disk = Self::new();
        let mut bundle = Bundle::load(&disk.path, &pad()).unwrap();
        let mut manifest = bundle.manifest().clone();
        manifest.inversion = Some(Settings::new(0.004, 8.0));
        let section = CorrectionSection {
            data_hash: "sha256:1".into(),
            presses: 40,
            left: [12.5, 1.25],
            ..CorrectionSection::default()
        };
        manifest.correction = Some(section);
        bundle.amend(manifest, Some(correction())).unwrap();
        assert_eq!(bundle.correction(), Some(&correction()));
        disk
    }

    /// Changes the correction's file, and makes the manifest agree with it.
    fn edit_correction(&self, from: &str, to: &str) {
        let path = self.path.join("correction.json");
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(text.contains(from), "{from} is not in\n{text}");
        let text = text.replacen(from, to, 1);
        std::fs::write(&path, &text).unwrap();
        let manifest = self.path.join("bundle.toml");
        let mut table: toml::Table = std::fs::read_to_string(&manifest).unwrap().parse().unwrap();
        let section = table["correction"].as_table_mut().unwrap();
        let hex: String = Sha256::digest(text.as_bytes()).iter().map(|b| format!("{b:02x}")).collect();
        section.insert("bytes".into(), (text.len() as i64).into());
        section.insert("hash".into(), format!("sha256:{hex}").into());
        std::fs::write(manifest, table.to_string()).unwrap();
    }
}

#[test]
fn a_correction_is_part_of_a_bundle() {
    let disk = OnDisk::corrected();
    let mut bundle = Bundle::load(&disk.path, &pad()).unwrap();
    assert_eq!(bundle.correction(), Some(&correction()));
    let section = bundle.manifest().correction.clone().unwrap();
    assert_eq!((section.presses, section.left), (40, [12.5, 1.25]));
    // Again, with another one; then without.
    let manifest = bundle.manifest().clone();
    bundle.amend(manifest.clone(), Some(correction())).unwrap();
    assert_eq!(Bundle::load(&disk.path, &pad()).unwrap().manifest(), &manifest);
    bundle.amend(manifest, None).unwrap();
    let bare = Bundle::load(&disk.path, &pad()).unwrap();
    assert!(bare.correction().is_none() && bare.manifest().correction.is_none());
    assert!(!disk.path.join("correction.json").exists());
}

#[test]
fn a_correction_that_cannot_be_is_refused() {
    let disk = OnDisk::corrected();
    std::fs::remove_file(disk.path.join("correction.json")).unwrap();
    insta::assert_snapshot!(disk.refusal(&pad()), @"model bundle /pad-mlp: holds no `correction.json`, so it is not a whole bundle; copy it again or train it anew");
    let refused = |from: &str, to: &str| {
        let disk = OnDisk::corrected();
        disk.edit_correction(from, to);
        disk.refusal(&pad())
    };
    insta::assert_snapshot!(refused("[0.5,0.25", "[NaN,0.25"), @"model bundle file /pad-mlp/correction.json: cannot be read as a correction: expected value at line 1 column 299; copy the bundle again, or learn the correction anew with `dermis refine --correct`");
    insta::assert_snapshot!(refused("[0.5,0.25", "[1e300,0.25"), @"model bundle file /pad-mlp/correction.json: cannot be read as a correction: number out of range at line 1 column 303; copy the bundle again, or learn the correction anew with `dermis refine --correct`");
    insta::assert_snapshot!(refused("\"gains\":[1.0,", "\"gains\":["), @"model bundle file /pad-mlp/correction.json: a correction of 4 channels for a model of 5; fit it anew");
    insta::assert_snapshot!(refused("dermis-correction/1", "dermis-correction/2"), @r#"model bundle file /pad-mlp/correction.json: field `schema` is "dermis-correction/2" where this program reads "dermis-correction/1"; copy the bundle again, or learn the correction anew with `dermis refine --correct`"#);
    let disk = OnDisk::corrected();
    disk.edit_correction("\"name\":\"pad\",\"hash\":\"sha256:", "\"name\":\"other\",\"hash\":\"sha256:0");
    let error = disk.refusal(&pad());
    assert!(
        error.contains("was learned on skin `other`") && error.contains("not on the bundle's `pad`"),
        "{error}"
    );
    let disk = OnDisk::corrected();
    disk.edit("[inversion]", "[unknown]");
    assert!(Bundle::load(&disk.path, &pad()).is_err());
}

#[test]
fn mean_and_scale_of_many_channels_have_a_file_of_their_own() {
    use dermis_inference::onnx::GraphBuilder;
    let names: Vec<String> = (0..80).map(|i| format!("c{i}")).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let wide = skin("wide", "Pa", &names);
    let mean: Vec<f32> = (0..80).map(|i| 100.0 + i as f32 / 3.0).collect();
    let scale: Vec<f32> = (0..80).map(|i| 1.0 + i as f32).collect();
    let mut g = GraphBuilder::new("wide");
    let x = g.input("input", &[1, 80]);
    let y = g.reduce_sum(&x, 1);
    g.output("output", &y, &[1, 1]);
    let graph = g.finish().unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("wide");
    let output = OutputConfig { values: vec![OutputSpec::new("force.normal", "N", 0.0, 1.0)] };
    let input = FeatureConfig::newest(mean.clone(), scale.clone());
    let manifest = Manifest::new("wide", &wide, Baseline::Raw, input, output, TrainingSection::default());
    BundleWriter::new(manifest).write(&path, &graph).unwrap();
    let text = std::fs::read_to_string(path.join("bundle.toml")).unwrap();
    assert!(!text.contains("mean = [") && text.contains("[normalisation]"), "{text}");
    let mut bundle = Bundle::load(&path, &wide).unwrap();
    assert_eq!((&bundle.manifest().input.mean, &bundle.manifest().input.scale), (&mean, &scale));

    // What is amended keeps the file.
    let mut manifest = bundle.manifest().clone();
    manifest.description = "amended".into();
    bundle.amend(manifest, None).unwrap();
    let again = Bundle::load(&path, &wide).unwrap();
    assert_eq!((again.manifest().description.as_str(), &again.manifest().input.mean), ("amended", &mean));

    let file = path.join("normalisation.npy");
    let mut bytes = std::fs::read(&file).unwrap();
    let last = bytes.len() - 1;
    bytes[last] ^= 1;
    std::fs::write(&file, &bytes).unwrap();
    let said = Bundle::load(&path, &wide).unwrap_err().to_string();
    assert!(said.contains("normalisation.npy") && said.contains("damaged or replaced"), "{said}");
    std::fs::remove_file(&file).unwrap();
    let said = Bundle::load(&path, &wide).unwrap_err().to_string();
    assert!(said.contains("holds no `normalisation.npy`"), "{said}");
}

#[test]
fn a_bundle_of_several_tensors_takes_and_gives_them_by_name() {
    use dermis_inference::onnx::GraphBuilder;
    use dermis_inference::{Interface, TensorPort};
    let port = |name: &str, shape: &[usize]| TensorPort { name: name.into(), shape: shape.to_vec() };
    let mut g = GraphBuilder::new("two");
    // In the graph they stand in another order than in the interface.
    let image = g.input("image", &[1, 1, 2, 2]);
    let channels = g.input("channels", &[1, 5]);
    let flat = g.reshape(&image, &[1, 4]);
    let map = g.add(&flat, &flat);
    let sum = g.reduce_sum(&channels, 1);
    g.output("map", &map, &[1, 4]);
    g.output("force", &sum, &[1, 1]);
    let graph = g.finish().unwrap();
    let interface = Interface::of(
        &[port("channels", &[1, 5]), port("image", &[1, 1, 2, 2])],
        &[port("force", &[1, 1]), port("map", &[1, 4])],
    );
    let mut writer = writer().with_interface(interface.clone());
    let mut map = OutputSpec::new("map.normal", "N", 0.0, 2.0);
    map.count = 4;
    writer.manifest.output.values = vec![OutputSpec::new("force.normal", "N", 0.0, 1.0), map];
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("two");
    writer.write(&path, &graph).unwrap();
    let bundle = Bundle::load(&path, &pad()).unwrap();
    assert_eq!(bundle.manifest().model.as_ref().unwrap().interface, interface);
    let mut model = bundle.session(embedded()).unwrap().unwrap();
    let mut raw = Vec::new();
    model.run(&[1.0, 2.0, 3.0, 4.0, 5.0, 0.1, 0.2, 0.3, 0.4], &mut raw).unwrap();
    assert_eq!(raw, [15.0, 0.2, 0.4, 0.6, 0.8]);
    let mut outputs = bundle.outputs();
    outputs.decode(&raw).unwrap();
    assert_eq!(outputs.get("force.normal"), Some(15.0));
    approx_eq(outputs.values("map.normal").unwrap(), &[0.4, 0.8, 1.2, 1.6]);

    // A tensor too few, and one that is declared twice.
    let one = Interface::of(&[port("channels", &[1, 5])], &[port("force", &[1, 1]), port("map", &[1, 4])]);
    let said = dermis_inference::Model::load(embedded(), &graph, &one).unwrap_err().to_string();
    assert!(said.contains("has input `image` [1, 1, 2, 2] and `channels` [1, 5]"), "{said}");
}

fn approx_eq(found: &[f64], expected: &[f64]) {
    assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6), "{found:?}");
}

/// A bundle without a network for [`pad`].
fn inverting() -> BundleWriter {
    let training = TrainingSection { data_hash: "sha256:0".into(), ..TrainingSection::default() };
    let mut settings = Settings::new(0.004, 2.0);
    settings.model_error = 0.003;
    BundleWriter::new(Manifest::of_inversion("pad-inverted", &pad(), settings, training))
}

#[test]
fn a_bundle_may_be_nothing_but_settings_of_an_inversion() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("inverted");
    inverting().write(&path, &[]).unwrap();
    assert!(!path.join("model.onnx").exists());
    let text = std::fs::read_to_string(path.join("bundle.toml")).unwrap();
    assert!(!text.contains("[model]") && !text.contains("[input]") && !text.contains("[output]"), "{text}");
    let mut bundle = Bundle::load(&path, &pad()).unwrap();
    assert_eq!(bundle.manifest().inversion.as_ref().unwrap().model_error, 0.003);
    assert!(bundle.session(embedded()).unwrap().is_none());
    // Its input is the newest frame as it is.
    let mut features = bundle.features();
    features.push(0, &[1.0, 2.0, 3.0, 4.0, 5.0]).unwrap();
    assert_eq!(features.input().unwrap(), [1.0, 2.0, 3.0, 4.0, 5.0]);
    assert!(bundle.outputs().config().is_empty());
    let mut manifest = bundle.manifest().clone();
    manifest.metrics.insert("position_rmse_m".into(), 1e-4);
    bundle.amend(manifest.clone(), None).unwrap();
    assert_eq!(Bundle::load(&path, &pad()).unwrap().manifest(), &manifest);
}

#[test]
fn without_a_network_there_are_settings_and_nothing_of_a_network() {
    let folder = tempfile::tempdir().unwrap();
    let refusal = |change: &dyn Fn(&mut Manifest)| {
        let mut writer = inverting();
        change(&mut writer.manifest);
        let text = writer.write(folder.path().join("b"), &[]).unwrap_err().to_string();
        text.replace(folder.path().to_str().unwrap(), "")
    };
    insta::assert_snapshot!(refusal(&|m| m.inversion = None), @"bundle file /b/bundle.toml: field `model`: is missing, and so is `inversion`: a bundle has at least one of the two to find contacts with");
    let with = writer().manifest;
    insta::assert_snapshot!(refusal(&|m| m.input = with.input.clone()), @"bundle file /b/bundle.toml: field `input`: speaks of a graph, and there is no `[model]`; remove one or add the other");
    insta::assert_snapshot!(refusal(&|m| m.output = with.output.clone()), @"bundle file /b/bundle.toml: field `output`: speaks of a graph, and there is no `[model]`; remove one or add the other");
    // And one that speaks of a graph has to have one.
    let disk = OnDisk::new();
    disk.edit(
        "[input]\nmean = [100.0, 100.0, 100.0, 100.0, 100.0]\nscale = [50.0, 50.0, 50.0, 50.0, 50.0]\n",
        "[input]\n",
    );
    insta::assert_snapshot!(disk.refusal(&pad()), @"bundle file /pad-mlp/bundle.toml: field `input.mean`: is empty: a skin has at least one channel");
}
