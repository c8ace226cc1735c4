//! Data sets, training, evaluation and ONNX export.
