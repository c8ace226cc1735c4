//! What the virtual testbed collected.

use dermis_operate::collect::Findings;

/// For people.
#[must_use]
pub fn text(found: &Findings) -> String {
    let resumed = match found.resumed {
        0 => String::new(),
        n if n == found.frames => "; all of it was there already".to_owned(),
        n => format!("; {n} frames were there already"),
    };
    format!(
        "{}: {} frames, {} presses, {:.0} s of {}, seed {}{resumed}{}\n",
        found.bag.display(),
        found.frames,
        found.presses,
        found.duration_s,
        found.skin,
        found.seed,
        if found.interrupted { "; ended early by Ctrl-C, --resume goes on" } else { "" }
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_there_already_and_what_is_missing_is_said() {
        let mut found = Findings {
            bag: "press".into(),
            frames: 400,
            resumed: 0,
            presses: 3,
            duration_s: 4.0,
            seed: 7,
            interrupted: false,
            skin: "pad".into(),
        };
        assert_eq!(text(&found), "press: 400 frames, 3 presses, 4 s of pad, seed 7\n");
        (found.resumed, found.interrupted) = (100, true);
        assert_eq!(
            text(&found),
            "press: 400 frames, 3 presses, 4 s of pad, seed 7; 100 frames were there already; ended early by Ctrl-C, --resume goes on\n"
        );
        found.resumed = 400;
        assert!(text(&found).contains("; all of it was there already"));
    }
}
