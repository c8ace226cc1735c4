use dermis_model::Stimulus;
use dermis_skin::{ModelError, Surface};

use super::*;
use crate::Climate;

/// Four electrodes of a small panel.
const PANEL: &str = r#"
schema = "dermis-skin/1"
name = "four"
sensor = "made-up"
kind = "simulated"
frame_id = "panel_link"
unit = "V"
rate = 100.0
noise = 5e-3
range = [0.0, 3.3]
surface = { type = "rectangle", size = [0.24, 0.24], spacing = 0.02 }
taxels = [
    { name = "e0", position = [-0.08, -0.08, -0.011] },
    { name = "e1", position = [0.08, -0.08, -0.011] },
    { name = "e2", position = [-0.08, 0.08, -0.011] },
    { name = "e3", position = [0.08, 0.08, -0.011] },
]
CHANNELS
[medium]
cells = [40, 40]
[medium.electrodes]
radius = 0.005
[medium.sheet]
bottom = 1e4
[medium.foam]
thickness = 0.008
surface_resistance = 1e11
conductance = 2.25e-3
reference_pressure = 50e3
exponent = 1.5
[medium.top]
thickness = 0.0032
[medium.drive]
source_voltage = 3.0
source_resistance = 100.0
full_scale = 3.3
bits = 12
"#;

fn skin() -> SkinDescription {
    let mut channels = String::from("channels = [\n");
    for fed in 0..4 {
        for read in 0..4 {
            channels += &format!("    {{ name = \"e{fed}-e{read}\", taxel = \"e{read}\" }},\n");
        }
    }
    SkinDescription::from_toml(&PANEL.replace("CHANNELS", &(channels + "]")), "four").unwrap()
}

/// A family's model as this test has it: another sheet of the numbers of the description.
struct Toy {
    sheet: Sheet,
    surface: Surface,
    noise: Vec<f64>,
    source: (f64, f64),
}

impl ForwardModel for Toy {
    fn channels(&self) -> usize {
        self.noise.len()
    }

    fn surface(&self) -> &Surface {
        &self.surface
    }

    fn response(&self, stimulus: &Stimulus, out: &mut [f64]) -> Result<(), ModelError> {
        let pressed = stimulus.contacts.first().and_then(|c| {
            self.sheet.between([c.position.x, c.position.y], 0.5 * c.diameter(), c.force.norm())
        });
        let z = pressed.as_ref().unwrap_or(self.sheet.untouched());
        out.copy_from_slice(sheet::voltages(z, self.source).as_slice());
        Ok(())
    }

    fn noise(&self) -> &[f64] {
        &self.noise
    }
}

fn toy(skin: &SkinDescription) -> Result<Arc<dyn ForwardModel>, String> {
    let of = |key: &str| number(skin, key).map_err(|e| e.to_string());
    let electrodes: Vec<[f64; 2]> = skin.taxels.iter().map(|t| [t.position[0], t.position[1]]).collect();
    let thickness = of("foam.thickness")?;
    let foam = Foam {
        leak: 1.0 / (of("foam.surface_resistance")? * thickness * thickness),
        conductance: of("foam.conductance")?,
        reference: of("foam.reference_pressure")?,
        exponent: of("foam.exponent")?,
        cover: of("top.thickness")?,
    };
    let weave = Weave {
        size: [0.24; 2],
        resistance: [of("sheet.bottom")?; 2],
        factor: &|_| 1.0,
        electrodes: &electrodes,
        radius: of("electrodes.radius")?,
        foam,
    };
    let sheet = Sheet::new(&weave).ok_or("cannot be solved")?;
    let source = (of("drive.source_voltage")?, of("drive.source_resistance")?);
    Ok(Arc::new(Toy { sheet, surface: skin.surface(), noise: skin.channel_noise(), source }))
}

#[test]
fn every_cause_moves_the_readings() {
    let skin = skin();
    assert!(FabricDevice::is_like(&skin));
    let designs = Designs::new(&toy);
    let device = |causes: &[Cause]| FabricDevice::new(&skin, &Numerics::default(), causes, &designs).unwrap();
    let nominal = device(&[]);
    let script = Script::draw(&nominal.model(), &rig(&skin, 0.2), Climate::Varied, 3).unwrap();
    let clean = nominal.readings(&script, None).unwrap();
    let lowest = clean.iter().copied().fold(f64::INFINITY, f64::min);
    assert!((1.0..2.999).contains(&lowest), "presses pull voltages down to {lowest}");
    for info in CAUSES {
        let cause = Cause { id: info.id.to_owned(), strength: 1.0, seed: 5 };
        let other = device(&[cause]).readings(&script, None).unwrap();
        let moved = crate::unexplained(&clean, &other, &script, skin.channels().len());
        assert!(other.iter().all(|v| (0.0..=3.3).contains(v)), "{}", info.id);
        assert!(moved > 1e-4, "{} moves {moved} of the variance", info.id);
    }
}

#[test]
fn a_sheet_without_causes_changes_nothing_and_noise_ends_in_counts() {
    let skin = skin();
    let designs = Designs::new(&toy);
    let device = |causes: &[Cause]| FabricDevice::new(&skin, &Numerics::default(), causes, &designs).unwrap();
    let nominal = device(&[]);
    let script = Script::draw(&nominal.model(), &rig(&skin, 0.05), Climate::Varied, 3).unwrap();
    let clean = nominal.readings(&script, None).unwrap();
    let weak = Cause { id: "warp-and-weft".to_owned(), strength: 0.0, seed: 5 };
    let same = device(&[weak]).readings(&script, None).unwrap();
    clean.iter().zip(&same).for_each(|(a, b)| approx::assert_abs_diff_eq!(a, b, epsilon = 1e-9));
    let noise = Noise { seed: 1, factor: 1.0, heavy: false };
    let counts = nominal.readings(&script, Some(noise)).unwrap();
    let count = 3.3 / 4096.0;
    assert!(counts.iter().all(|v| (v / count - (v / count).round()).abs() < 1e-6));
}

#[test]
fn a_panel_without_a_model_is_refused_with_what_is_missing() {
    let refused = FabricDevice::new(&skin(), &Numerics::default(), &[], &Designs::default()).unwrap_err();
    assert!(refused.to_string().contains("no forward model was given"), "{refused}");
}

#[test]
fn where_a_cause_sits_is_said() {
    let skin = skin();
    let cause = |id: &str| Cause { id: id.to_owned(), strength: 1.0, seed: 8 };
    let Some(Region::Channels { names }) = place(&skin, &cause("open-wire")) else { panic!("no channels") };
    // Of four electrodes: a row and a column of the frame.
    assert_eq!(names.len(), 7, "{names:?}");
    assert!(matches!(place(&skin, &cause("torn-patch")), Some(Region::Place { .. })));
    assert_eq!(place(&skin, &cause("long-ground")), None);
}
