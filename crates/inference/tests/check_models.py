"""Checks graphs that dermis wrote: `onnx.checker`, and Python's onnxruntime against dermis' own outputs.

Usage: check_models.py FOLDER, with NAME.onnx, NAME.in and NAME.embedded (little-endian float32) for each graph.
Prints a line per graph; exits with 1 where one is wrong.
"""

import pathlib
import sys

import numpy
import onnx
import onnxruntime


def check(path: pathlib.Path) -> float:
    """Largest difference between Python's onnxruntime and dermis."""
    model = onnx.load(path)
    onnx.checker.check_model(model, full_check=True)
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    (port,) = session.get_inputs()
    inputs = numpy.fromfile(path.with_suffix(".in"), "<f4").reshape(-1, *port.shape)
    ours = numpy.fromfile(path.with_suffix(".embedded"), "<f4").reshape(len(inputs), -1)
    theirs = [session.run(["output"], {port.name: row})[0].ravel() for row in inputs]
    return float(numpy.abs(numpy.array(theirs) - ours).max())


def main() -> int:
    wrong = False
    for path in sorted(pathlib.Path(sys.argv[1]).glob("*.onnx")):
        difference = check(path)
        wrong |= not difference < 1e-5
        print(f"{path.stem}: {difference:.1e}")
    return int(wrong)


if __name__ == "__main__":
    sys.exit(main())
