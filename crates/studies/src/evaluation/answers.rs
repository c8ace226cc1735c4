//! Answers of a program that is not ours, measured as those of a bundle are.
//!
//! A line of the file is a JSON object that answers one frame: its `stamp_ns` \[ns since 1970\], and `contacts`, each with a
//! `position` \[m\] and the `force` \[N\] that the environment exerts on the skin, both in the link frame. Without contacts the skin is
//! untouched. A position beside the surface is that of the nearest point on it.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use dermis_skin::{Contact, Estimate, EstimateError, Estimator, ForceComponents, Frame, Stamp, Surface};
use nalgebra::{Point3, Vector3};
use serde::Deserialize;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Line {
    stamp_ns: Stamp,
    contacts: Vec<Touch>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Touch {
    position: [f64; 3],
    force: [f64; 3],
}

/// What somebody's program made of frames, by their stamps.
pub(super) struct Answers {
    file: PathBuf,
    all: HashMap<Stamp, Vec<Contact>>,
}

impl Answers {
    /// Reads a file.
    ///
    /// # Errors
    ///
    /// Where it cannot be read; those of a line name it, and what is wrong with it.
    pub(super) fn read(file: &Path, surface: &Surface) -> Result<Self> {
        let text = dermis_io::read_text(file, dermis_io::REPORT)
            .with_context(|| format!("{} cannot be read", file.display()))?;
        let mut all = HashMap::new();
        for (number, line) in text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()) {
            let at = || format!("{}, line {}", file.display(), number + 1);
            let line: Line = serde_json::from_str(line).with_context(at)?;
            let contacts = line.contacts.iter().map(|touch| contact(touch, surface)).collect();
            if all.insert(line.stamp_ns, contacts).is_some() {
                bail!("{}: there is an answer to the frame of {} ns already", at(), line.stamp_ns);
            }
        }
        Ok(Self { file: file.to_owned(), all })
    }
}

impl Estimator for Answers {
    fn estimate(&mut self, frame: &Frame) -> Result<Estimate, EstimateError> {
        let Some(contacts) = self.all.get(&frame.stamp) else {
            let (file, stamp) = (self.file.display(), frame.stamp);
            let reason = format!(
                "{file} has no answer to the frame of {stamp} ns; every frame of the bags needs a line, with an empty list of \
                 contacts where nothing touches"
            );
            return Err(EstimateError::Model { sequence: frame.sequence, reason });
        };
        Ok(Estimate { contacts: contacts.clone(), ..Estimate::default() })
    }

    fn reset(&mut self) {}
}

fn contact(touch: &Touch, surface: &Surface) -> Contact {
    let (position, normal) = surface.project(&Point3::from(touch.position));
    Contact {
        force: Vector3::from(touch.force),
        force_components: ForceComponents::Full,
        ..Contact::at(position, normal)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn surface() -> Surface {
        dermis_fixtures::SkinFile::four_barometers().read().surface()
    }

    fn read(text: &str) -> Result<Answers> {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("answers.jsonl");
        std::fs::write(&file, text).unwrap();
        Answers::read(&file, &surface())
    }

    #[test]
    fn a_frame_gets_the_answer_of_its_stamp() {
        let text = "{\"stamp_ns\":5,\"contacts\":[{\"position\":[0,0,0.5],\"force\":[0.1,0,-2]}]}\n\n{\"stamp_ns\":7,\"contacts\":[]}\n";
        let mut answers = read(text).unwrap();
        let found = answers.estimate(&Frame::new(5, 0, Vec::new())).unwrap();
        let [contact] = &found.contacts[..] else { panic!("{found:?}") };
        let (position, normal) = surface().project(&Point3::new(0.0, 0.0, 0.5));
        assert_eq!((contact.position, contact.normal), (position, normal));
        assert!((contact.normal_force() - 2.0).abs() < 1e-12);
        assert_eq!(answers.estimate(&Frame::new(7, 1, Vec::new())).unwrap(), Estimate::default());
        let refused = answers.estimate(&Frame::new(6, 2, Vec::new())).unwrap_err().to_string();
        assert!(refused.contains("no answer to the frame of 6 ns"), "{refused}");
    }

    #[test]
    fn a_line_that_is_no_answer_is_refused_by_its_number() {
        for (text, wanted) in [
            (
                "{\"stamp_ns\":5,\"contacts\":[]}\n{\"stamp_ns\":5,\"contacts\":[]}",
                "line 2: there is an answer",
            ),
            ("\n{\"stamp_ns\":5}", "line 2: missing field `contacts`"),
            (
                "{\"stamp_ns\":5,\"contacts\":[{\"position\":[0,0],\"force\":[0,0,0]}]}",
                "line 1: invalid length 2",
            ),
            (
                "{\"stamp_ns\":5,\"contacts\":[{\"position\":[0,0,1e999],\"force\":[0,0,0]}]}",
                "number out of range",
            ),
            ("{\"stamp_ns\":5,\"contacts\":[],\"frame\":3}", "unknown field `frame`"),
        ] {
            let Err(refused) = read(text) else { panic!("{text} is taken") };
            let refused = format!("{refused:#}");
            assert!(refused.contains(wanted), "{refused}");
        }
    }
}
