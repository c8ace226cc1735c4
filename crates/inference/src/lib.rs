//! ONNX inference through ort, and model bundles.
