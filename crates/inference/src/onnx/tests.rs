use super::*;

#[test]
fn mistakes_are_named() {
    let mut g = GraphBuilder::new("g");
    let x = g.input("x", &[1, 2]);
    g.constant("w", &[2, 2], &[1.0]);
    g.output("y", &x, &[1, 2]);
    insta::assert_snapshot!(g.finish().unwrap_err(), @"graph `g`: constant `w` has 1 values where its shape [2, 2] takes 4");

    let mut g = GraphBuilder::new("g");
    let x = g.input("x", &[1, 2]);
    g.output("x", &x, &[1, 2]);
    insta::assert_snapshot!(g.finish().unwrap_err(), @"graph `g`: the name `x` is used twice");

    let mut g = GraphBuilder::new("g");
    g.input("x", &[1, 2]);
    insta::assert_snapshot!(g.finish().unwrap_err(), @"graph `g` has no output");
}

#[test]
fn what_is_written_reads_back() {
    let mut g = GraphBuilder::new("g");
    let x = g.input("x", &[1, 2]);
    let (values, _) = g.top_k(&x, 1, 1, true);
    let y = g.tanh(&values);
    g.output("y", &y, &[1, 1]);
    let bytes = g.finish().unwrap();
    let model = onnx_rs::parse(&bytes).unwrap();
    assert_eq!(model.ir_version, 8);
    assert_eq!(model.opset_import[0].version, 17);
    let operators: Vec<_> = model.graph.unwrap().node.iter().map(|n| n.op_type.to_string()).collect();
    assert_eq!(operators, ["TopK", "Tanh", "Identity"]);
}
