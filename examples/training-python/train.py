"""Trains a small network with NumPy on an exported table, and writes an ONNX graph: python3 train.py TABLE.npz OUT.onnx

One hidden layer; readings in noise deviations go in, position [m] and normal force [N] come out. Scales are part of the graph, so
that it takes tared readings in the unit of the skin.
"""

import sys

import numpy as np
from onnx import TensorProto, checker, helper, numpy_helper, save

HIDDEN, EPOCHS, BATCH, RATE = 64, 60, 64, 3e-3

table = np.load(sys.argv[1])
split = np.char.decode(table["split"], "ascii")
good = (table["contacts"] == 1) & (table["flags"] == 0).all(axis=1) & np.isfinite(table["tared"]).all(axis=1)
x = table["tared"].astype(np.float32)
y = np.column_stack([table["position"][:, :2], table["force_normal"]]).astype(np.float32)
train, held_out = good & (split == "train"), good & (split == "held_out")

x_scale = x[train].std(axis=0) + 1e-9
y_mean, y_scale = y[train].mean(axis=0), y[train].std(axis=0)
inputs, targets = x[train] / x_scale, (y[train] - y_mean) / y_scale

random = np.random.default_rng(1)
shapes = [(x.shape[1], HIDDEN), (HIDDEN,), (HIDDEN, 3), (3,)]
weights = [random.normal(0.0, 1.0 / np.sqrt(s[0]), s) if len(s) == 2 else np.zeros(s) for s in shapes]
first, second = [np.zeros(s) for s in shapes], [np.zeros(s) for s in shapes]
step = 0
for epoch in range(EPOCHS):
    order = random.permutation(len(inputs))
    for batch in np.array_split(order, max(1, len(order) // BATCH)):
        a, t = inputs[batch], targets[batch]
        w1, b1, w2, b2 = weights
        hidden = np.tanh(a @ w1 + b1)
        error = (hidden @ w2 + b2 - t) / len(batch)
        back = (error @ w2.T) * (1.0 - hidden**2)
        step += 1
        for k, gradient in enumerate([a.T @ back, back.sum(0), hidden.T @ error, error.sum(0)]):
            # Adam (Kingma and Ba, 2015).
            first[k] = 0.9 * first[k] + 0.1 * gradient
            second[k] = 0.999 * second[k] + 0.001 * gradient**2
            m, v = first[k] / (1.0 - 0.9**step), second[k] / (1.0 - 0.999**step)
            weights[k] = weights[k] - RATE * m / (np.sqrt(v) + 1e-8)

# The scales go into the first and the last layer.
w1, b1, w2, b2 = weights
constants = {
    "w1": w1 / x_scale[:, None],
    "b1": b1,
    "w2": w2 * y_scale,
    "b2": b2 * y_scale + y_mean,
}
constants = {name: value.astype(np.float32) for name, value in constants.items()}
graph = helper.make_graph(
    [
        helper.make_node("Gemm", ["readings", "w1", "b1"], ["sum"]),
        helper.make_node("Tanh", ["sum"], ["hidden"]),
        helper.make_node("Gemm", ["hidden", "w2", "b2"], ["contact"]),
    ],
    "network",
    [helper.make_tensor_value_info("readings", TensorProto.FLOAT, ["N", x.shape[1]])],
    [helper.make_tensor_value_info("contact", TensorProto.FLOAT, ["N", 3])],
    [numpy_helper.from_array(value, name) for name, value in constants.items()],
)
model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
checker.check_model(model)
save(model, sys.argv[2])

answer = np.tanh(x[held_out] @ constants["w1"] + constants["b1"]) @ constants["w2"] + constants["b2"]
rms = np.sqrt(((answer - y[held_out]).astype(float) ** 2).mean(axis=0))
print(f"held out: {held_out.sum()} frames, RMS {rms[0] * 1e3:.2f} {rms[1] * 1e3:.2f} mm {rms[2]:.3f} N", flush=True)
