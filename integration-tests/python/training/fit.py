"""Trains on exported tables with NumPy only, and writes an ONNX graph: python fit.py DIR STEM OUT.onnx

DIR/STEM.npz and DIR/STEM.parquet must hold the same; the graph is a linear fit of position and force to raw readings
in kPa, with a free batch. Prints the errors on the held-out rows as JSON.
"""

import json
import sys

import duckdb
import numpy as np
from onnx import TensorProto, checker, helper, numpy_helper, save

folder, stem, out = sys.argv[1:4]
npz = np.load(f"{folder}/{stem}.npz")
path = f"{folder}/{stem}.parquet"
table = duckdb.sql(f"select * from '{path}'").fetchnumpy()
(stored,) = [v for k, v in duckdb.sql(f"select key, value from parquet_kv_metadata('{path}')").fetchall() if k == b"dermis"]
schema = json.loads(stored)
assert schema == json.loads(npz["schema.json"]), "the two files describe themselves differently"
columns = {c["name"]: c for c in schema["columns"]}
assert schema["skin"]["unit"] == columns["values"]["unit"] == "Pa" and columns["force_normal"]["unit"] == "N"

channels = columns["values"]["parts"]
for i, name in enumerate(channels):
    assert np.array_equal(np.asarray(table[f"channel.{name}"]), npz["values"][:, i], equal_nan=True), name
    assert np.array_equal(np.asarray(table[f"tared.{name}"]), npz["tared"][:, i], equal_nan=True), name
    assert np.array_equal(np.asarray(table[f"flags.{name}"]), npz["flags"][:, i]), name
for name in ("position", "normal", "force"):
    for i, axis in enumerate("xyz"):
        assert np.array_equal(np.asarray(table[f"{name}.{axis}"]), npz[name][:, i], equal_nan=True), name
for name in ("stamp", "sequence", "contacts", "press", "location", "idle", "force_normal"):
    assert np.array_equal(np.asarray(table[name]), npz[name], equal_nan=True), name
split = np.char.decode(npz["split"], "ascii")
assert list(table["split"]) == list(split)
assert np.all(np.diff(npz["stamp"]) > 0)
touched = npz["contacts"] == 1
assert np.allclose(npz["force_normal"][touched], -(npz["force"] * npz["normal"]).sum(1)[touched])
held_out, train = touched & (split == "held_out"), touched & (split == "train")
assert not set(npz["location"][held_out]) & set(npz["location"][train]), "a location is in both parts"

inputs = npz["values"] / np.float32(1000.0)
targets = np.column_stack([npz["position"][:, :2] * 1e3, npz["force_normal"]])
rows = np.column_stack([inputs[train], np.ones(train.sum())])
weights, *_ = np.linalg.lstsq(rows, targets[train], rcond=None)
matrix, bias = weights[:-1].astype(np.float32), weights[-1].astype(np.float32)
graph = helper.make_graph(
    [helper.make_node("Gemm", ["taxels", "matrix", "bias"], ["contact"])],
    "linear",
    [helper.make_tensor_value_info("taxels", TensorProto.FLOAT, ["N", len(channels)])],
    [helper.make_tensor_value_info("contact", TensorProto.FLOAT, ["N", 3])],
    [numpy_helper.from_array(matrix, "matrix"), numpy_helper.from_array(bias, "bias")],
)
model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
checker.check_model(model)
save(model, out)
np.savez(f"{folder}/fit.npz", matrix=matrix, bias=bias)

errors = (inputs[held_out] @ matrix + bias) - targets[held_out]
rms = np.sqrt((errors.astype(float) ** 2).mean(0))
print("FIT", json.dumps({"position.x": rms[0] * 1e-3, "position.y": rms[1] * 1e-3, "force.normal": rms[2], "rows": int(held_out.sum())}))
