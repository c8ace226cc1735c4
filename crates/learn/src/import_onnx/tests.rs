use dermis_inference::onnx::GraphBuilder;
use dermis_inference::{Bundle, RuntimeChoice, RuntimeConfig};

use super::*;
use crate::dataset::tests::{presses, skin};

fn runtime() -> &'static Runtime {
    Runtime::load(&RuntimeConfig { choice: RuntimeChoice::Embedded, library: None }).unwrap()
}

/// Readings of the made-up skin are 10⁴ x and 20 F over their zero; this is 0.2 % off in force.
fn inverse(dir: &Path) -> std::path::PathBuf {
    let mut g = GraphBuilder::new("theirs");
    let x = g.input("taxels", &[1, 2]);
    let weight = g.constant("w", &[2, 3], &[1e-1, 0.0, 0.0, 0.0, 0.0, 0.0501]);
    let y = g.gemm(&x, &weight, None);
    g.output("contact", &y, &[1, 3]);
    let path = dir.join("theirs.onnx");
    std::fs::write(&path, g.finish().unwrap()).unwrap();
    path
}

fn wiring() -> Wiring {
    let text = "[outputs.\"position.x\"]\nscale = 1e-3\n[outputs.\"position.y\"]\nscale = 1e-3\n";
    toml::from_str(text).unwrap()
}

fn names(names: &str) -> Vec<String> {
    names.split(',').map(str::to_owned).collect()
}

#[test]
fn a_graph_of_someone_else_becomes_a_bundle_that_is_measured() {
    let dir = tempfile::tempdir().unwrap();
    let (onnx, out, skin, data) = (inverse(dir.path()), dir.path().join("bundle"), skin(), presses(40, 2));
    let outputs = names("position.x,position.y,force.normal");
    let request = ImportRequest {
        skin: &skin,
        onnx: &onnx,
        outputs: &outputs,
        wiring: &wiring(),
        data: Some((&data, Some(SplitConfig::default()))),
        out: &out,
        runtime: runtime(),
    };
    let adopted = import_onnx(&request).unwrap();
    assert_eq!(adopted.runtimes, ["embedded"]);
    let figures = adopted.measured.unwrap().figures();
    assert!(figures["position_rms"] < 1e-6 && figures["force_normal_rms"] < 0.01, "{figures:?}");
    let bundle = Bundle::load(&out, &skin).unwrap();
    assert_eq!(bundle.manifest().model.as_ref().unwrap().interface.input, "taxels");
    assert!(bundle.manifest().output.values[2].sigma.unwrap() < 0.01);
    assert_eq!(bundle.manifest().force_range, Some([1.0, 5.0]));
    bundle.session(runtime()).unwrap();
    let card: serde_json::Value =
        serde_json::from_slice(&std::fs::read(out.join("card.json")).unwrap()).unwrap();
    assert_eq!(
        (card["origin"]["opsets"][0]["version"].as_u64(), card["locations"].as_u64()),
        (Some(17), Some(40))
    );
    assert!(out.join("report.html").is_file());
}

#[test]
fn outputs_of_a_graph_with_several_are_taken_in_its_order() {
    let dir = tempfile::tempdir().unwrap();
    let (onnx, out, skin, data) =
        (dir.path().join("heads.onnx"), dir.path().join("bundle"), skin(), presses(40, 2));
    // A head for the force and one for the place.
    let mut g = GraphBuilder::new("heads");
    let x = g.input("taxels", &[1, 2]);
    let newton = g.constant("newton", &[2, 1], &[0.0, 0.0501]);
    let metre = g.constant("metre", &[2, 2], &[1e-1, 0.0, 0.0, 0.0]);
    let force = g.matmul(&x, &newton);
    let place = g.matmul(&x, &metre);
    g.output("force", &force, &[1, 1]);
    g.output("place", &place, &[1, 2]);
    std::fs::write(&onnx, g.finish().unwrap()).unwrap();
    let outputs = names("force.normal,position.x,position.y");
    let request = ImportRequest {
        skin: &skin,
        onnx: &onnx,
        outputs: &outputs,
        wiring: &wiring(),
        data: Some((&data, None)),
        out: &out,
        runtime: runtime(),
    };
    let figures = import_onnx(&request).unwrap().measured.unwrap().figures();
    assert!(figures["position_rms"] < 1e-6 && figures["force_normal_rms"] < 0.01, "{figures:?}");
    let bundle = Bundle::load(&out, &skin).unwrap();
    let interface = &bundle.manifest().model.as_ref().unwrap().interface;
    assert_eq!((interface.output.as_str(), interface.more_outputs[0].name.as_str()), ("force", "place"));
    bundle.session(runtime()).unwrap();
}

#[test]
fn what_does_not_fit_is_said_at_once() {
    let dir = tempfile::tempdir().unwrap();
    let (onnx, out, skin) = (inverse(dir.path()), dir.path().join("bundle"), skin());
    let message = |outputs: &str, wiring: &Wiring, onnx: &Path| {
        let outputs = names(outputs);
        let request = ImportRequest {
            skin: &skin,
            onnx,
            outputs: &outputs,
            wiring,
            data: None,
            out: &out,
            runtime: runtime(),
        };
        import_onnx(&request).unwrap_err().to_string().replace(&dir.path().display().to_string(), "DIR")
    };
    let two = Wiring { taps: Taps::Frames(vec![0, 1]), ..Wiring::default() };
    insta::assert_snapshot!(message("position.x,force.normal", &two, &onnx), @r"
    2 things are in the way
      1. model file DIR/theirs.onnx: input `taxels` [1, 2] has 2 numbers where there are 4 numbers for the 2 channels of skin `pad`: train it on those channels, or say in a file of `--input` which taps, low_pass and difference it takes
      2. model file DIR/theirs.onnx: output `contact` [1, 3] has 3 numbers where there are 2 numbers for position.x, force.normal: name each number that comes out, in order, in `--outputs`
    ");
    let three =
        Wiring { mean: PerChannel::Each(vec![0.0; 3]), scale: PerChannel::Each(vec![1.0; 3]), ..wiring() };
    insta::assert_snapshot!(message("position.x,position.y,torque", &three, &onnx), @r"
    3 things are in the way
      1. the model's outputs: `torque` is none of position.x, position.y, position.z, force.x, force.y, force.z, force.normal, contact: name each number that comes out, in order
      2. the model's input: `mean` has 3 entries where skin `pad` has 2 channels: give one number for all, or one each
      3. model file DIR/theirs.onnx: input `taxels` [1, 2] has 2 numbers where there are 3 numbers for the 2 channels of skin `pad`: train it on those channels, or say in a file of `--input` which taps, low_pass and difference it takes
    ");
    let other = dir.path().join("other.onnx");
    let mut g = GraphBuilder::new("two");
    let x = g.input("a", &[1, 2]);
    let y = g.add(&x, &x);
    g.output("b", &y, &[1, 2]);
    g.output("c", &x, &[1, 2]);
    std::fs::write(&other, g.finish().unwrap()).unwrap();
    insta::assert_snapshot!(message("force.normal,contact", &Wiring::default(), &other), @"model file DIR/other.onnx: outputs `b` [1, 2] and `c` [1, 2] have 4 numbers together where there are 2 numbers for force.normal, contact: name each number that comes out, in order, in `--outputs`");
    std::fs::write(&other, "PK").unwrap();
    insta::assert_snapshot!(message("force.normal", &Wiring::default(), &other), @"model file DIR/other.onnx: is not an ONNX model: it holds no graph; export it again");
    assert!(!out.exists());
}
