//! A skin file for the tests of this crate. Other crates have theirs from `dermis-fixtures`, which would bring another build of
//! this one.

/// Two taxels, `t0` and `t1`.
pub(crate) const PAD: &str = r#"
schema = "dermis-skin/1"
name = "pad"
sensor = "taxels"
frame_id = "pad_link"
unit = "Pa"
rate = 100.0
noise = 20.0
surface = { type = "rectangle", size = [0.02, 0.01], spacing = 0.005 }
taxels = [{ name = "t0", position = [0.0, 0.0, -0.005] }, { name = "t1", position = [0.005, 0.0, -0.005] }]
"#;
