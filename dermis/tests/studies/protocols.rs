//! The first protocol of skins that ship.

use dermis_report::gap::instructions;
use dermis_studies::gap::planning::{PlanRequest, plan};
use dermis_testbed::Timeline;

use crate::{FAMILIES, SENSORS, load, path};

#[test]
fn a_first_protocol_fits_its_skin_its_forces_and_its_minutes() {
    for name in ["baro-line", "baro-dome", "ert-panel"] {
        let file = format!("{name}.toml");
        let (minutes, seed) = (6.0, 1);
        let found = plan(&PlanRequest { skin: path(&file), minutes, seed }, &FAMILIES).unwrap();
        assert!((found.minutes / minutes - 1.0).abs() < 0.1, "{name}: {} min", found.minutes);
        let skin = load(&file);
        let [least, most] = skin.rated_press().force;
        let pressed = || found.protocol.steps.iter().filter(|s| !s.at.is_empty());
        assert!(pressed().flat_map(|s| &s.forces).all(|f| (0.99 * least..=1.01 * most).contains(f)));
        // What a diagnosis says is missing: repeats, holds, another speed, and a second tip where a ball presses.
        let has = |what: &str| pressed().any(|s| s.what == what);
        assert!(
            ["force ladder", "hold and rest", "the same press again", "reference press"].map(has)
                == [true; 4]
        );
        assert_eq!(has("two tips"), found.protocol.range.second_tip.is_some());
        let model = SENSORS.of(&skin).unwrap().model(&skin).unwrap();
        let timeline = Timeline::new(&found.protocol.plan().unwrap(), &model, 1).unwrap();
        assert_eq!(timeline.presses() as usize, found.presses);
        let text = instructions(&found, "plan.toml");
        assert!(
            text.contains("| place | x [mm] | y [mm] | z [mm] |") && text.contains("--and BAG2"),
            "{text}"
        );
    }
}
