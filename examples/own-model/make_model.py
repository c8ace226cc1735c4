"""Writes an ONNX graph of the centre of pressure: python3 make_model.py SKIN.toml OUT.onnx

Position: readings as weights of the locations of the taxels. Force: their sum, times what one newton makes of it.
"""

import sys
import tomllib

import numpy as np
from onnx import TensorProto, checker, helper, numpy_helper, save

# [N/Pa] of the sum of all readings. A model that is in earnest would learn this.
FORCE = np.float32(1e-4)

skin = tomllib.load(open(sys.argv[1], "rb"))
locations = np.array([taxel["position"][:2] for taxel in skin["taxels"]], np.float32)
count = len(locations)

constants = {
    "zero": np.float32(0.0),
    "least": np.float32(1e-3),  # [Pa] so that nothing is divided by zero
    "locations": locations,
    "axes": np.array([1], np.int64),
    "force": FORCE,
}
nodes = [
    helper.make_node("Max", ["readings", "zero"], ["weights"]),
    helper.make_node("ReduceSum", ["weights", "axes"], ["sum"], keepdims=1),
    helper.make_node("Max", ["sum", "least"], ["total"]),
    helper.make_node("MatMul", ["weights", "locations"], ["moment"]),
    helper.make_node("Div", ["moment", "total"], ["position"]),
    helper.make_node("Mul", ["sum", "force"], ["pressing"]),
    helper.make_node("Concat", ["position", "pressing"], ["contact"], axis=1),
]
graph = helper.make_graph(
    nodes,
    "centre-of-pressure",
    [helper.make_tensor_value_info("readings", TensorProto.FLOAT, ["N", count])],
    [helper.make_tensor_value_info("contact", TensorProto.FLOAT, ["N", 3])],
    [numpy_helper.from_array(np.asarray(value), name) for name, value in constants.items()],
)
model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
checker.check_model(model)
save(model, sys.argv[2])
print("wrote", sys.argv[2], "for", count, "channels")
