use std::sync::Mutex;

use dermis_studies::Progress;
use dermis_studies::real2sim::thesis;

use crate::{FAMILIES, path};

/// What a person should know of the input.
#[derive(Default)]
struct Notes(Mutex<Vec<String>>);

impl Progress for Notes {
    fn begin(&self, _: &str) {}

    fn at(&self, _: f64) -> bool {
        true
    }

    fn note(&self, sentence: &str) {
        self.0.lock().unwrap().push(sentence.to_owned());
    }
}

#[test]
fn effects_that_the_simulation_leaves_out_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let text = std::fs::read_to_string(path("baro-line.toml")).unwrap();
    let notes_on = |text: &str| {
        let skin = folder.path().join("skin.toml");
        std::fs::write(&skin, text).unwrap();
        let none = folder.path().join("none");
        let request = thesis::Request {
            skin,
            train: vec![none.clone()],
            bags: vec![none],
            ..thesis::Request::default()
        };
        let notes = Notes::default();
        // The skin is read before the bags.
        let refused = thesis::measure(&request, &FAMILIES, &notes).err().unwrap();
        assert!(format!("{refused:#}").contains("none"), "{refused:#}");
        notes.0.into_inner().unwrap()
    };
    assert_eq!(notes_on(&text), Vec::<String>::new());
    let notes = notes_on(&format!(
        "{text}\n[[effects]]\nname = \"hysteresis\"\n\n[[effects]]\nname = \"crosstalk\"\n"
    ));
    let [note] = notes.as_slice() else { panic!("{notes:?}") };
    assert!(
        note.starts_with("the simulation is of the skin as it was designed; it leaves out the effects of ")
    );
    assert!(note.ends_with("skin.toml: hysteresis, crosstalk"), "{note}");
}
