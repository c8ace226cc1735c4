use super::*;

#[test]
fn a_bad_override_is_named() {
    let config = HirozConfig {
        overrides: vec![("scouting/nonsense".to_owned(), "1".to_owned())],
        ..HirozConfig::default()
    };
    let error = config.zenoh(&Network::default()).unwrap_err();
    assert!(error.contains("scouting/nonsense=1"), "{error}");
}
