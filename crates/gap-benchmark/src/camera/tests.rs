use dermis_skin::{ModelError, Surface};

use super::*;
use crate::Climate;

/// A camera below a flat skin, 8 x 6 blocks of five numbers.
const EYE: &str = r#"
schema = "dermis-skin/1"
name = "eye"
sensor = "made-up"
kind = "simulated"
frame_id = "eye_link"
unit = "1"
rate = 40.0
noise = 4e-4
range = [0.0, 1.0]
surface = { type = "rectangle", size = [0.04, 0.03], spacing = 0.002 }
TAXELS
[medium]
blocks = [8, 6]
[medium.camera]
size = [160, 120]
focal = 795.0
height = -0.02
gamma = 2.2
[medium.lamps]
colours = "RGBRGB"
azimuth = 0.3
radius = 0.011
height = -0.02
tilt = 0.1
beam = 0.008
spread = 0.3
"#;

fn skin() -> SkinDescription {
    let mut taxels = String::from("taxels = [\n");
    for block in 0..48 {
        for (k, number) in ["r", "g", "b", "u", "v"].into_iter().enumerate() {
            // No two elements may lie at one place; nothing here reads where they lie.
            let at = 1e-4 * (5 * block + k) as f64;
            taxels += &format!("    {{ name = \"{block}{number}\", position = [{at:?}, 0.0, 0.0] }},\n");
        }
    }
    taxels.push(']');
    SkinDescription::from_toml(&EYE.replace("TAXELS", &taxels), "eye").unwrap()
}

/// Blocks turn darker around a touch in one colour and brighter in another, in proportion to the force, and ridges move away from
/// it.
struct Toy {
    surface: Surface,
    noise: Vec<f64>,
}

impl ForwardModel for Toy {
    fn channels(&self) -> usize {
        self.noise.len()
    }

    fn surface(&self) -> &Surface {
        &self.surface
    }

    fn response(&self, stimulus: &Stimulus, out: &mut [f64]) -> Result<(), ModelError> {
        for (block, numbers) in out.chunks_mut(5).enumerate() {
            let at = [((block % 8) as f64 - 3.5) * 0.005, ((block / 8) as f64 - 2.5) * 0.005];
            numbers.copy_from_slice(&[0.4, 0.35 + 2.0 * at[0], 0.45, 0.5, 0.5]);
            // Gravity lets the whole skin sag a little.
            numbers[0] += 1e-3 * stimulus.gravity.x;
            numbers[1] += 1e-3 * stimulus.gravity.y;
            for contact in &stimulus.contacts {
                let off = [at[0] - contact.position.x, at[1] - contact.position.y];
                let wide = contact.diameter() + 0.003;
                let near = contact.force.norm() * (-0.5 * (off[0].hypot(off[1]) / wide).powi(2)).exp();
                let aside = contact.force.x * near;
                let changes = [-0.03 * near, 0.02 * near + 0.02 * aside, -0.01 * near];
                numbers.iter_mut().zip(changes).for_each(|(v, c)| *v += c);
                numbers[3] += 4.0 * off[0] * near;
                numbers[4] += 4.0 * off[1] * near;
            }
        }
        Ok(())
    }

    fn noise(&self) -> &[f64] {
        &self.noise
    }
}

fn toy(skin: &SkinDescription) -> Result<Arc<dyn ForwardModel>, String> {
    Ok(Arc::new(Toy { surface: skin.surface(), noise: skin.channel_noise() }))
}

fn device(skin: &SkinDescription, causes: &[Cause]) -> CameraDevice {
    CameraDevice::new(skin, causes, &Designs::new(&toy)).unwrap()
}

#[test]
fn every_cause_moves_the_readings() {
    let skin = skin();
    assert!(CameraDevice::is_like(&skin));
    let nominal = device(&skin, &[]);
    let script = Script::draw(&nominal.model(), &rig(&skin, 0.2), Climate::Varied, 3).unwrap();
    let clean = nominal.readings(&script, None).unwrap();
    for info in CAUSES {
        let cause = Cause { id: info.id.to_owned(), strength: 1.0, seed: 5 };
        let other = device(&skin, &[cause]).readings(&script, None).unwrap();
        let moved = crate::unexplained(&clean, &other, &script, skin.channels().len());
        assert!(other.iter().all(|v| (0.0..=1.0).contains(v)), "{}", info.id);
        assert!(moved > 1e-4, "{} moves {moved} of the variance", info.id);
    }
}

#[test]
fn a_weak_lamp_darkens_its_own_colour_where_it_shines() {
    let skin = skin();
    let cause = Cause { id: "weak-lamp".to_owned(), strength: 1.0, seed: 2 };
    let device = device(&skin, &[cause]);
    let mut row = device.zero.clone();
    let instant = crate::Instant { time: 0.0, session: 0, moment: dermis_testbed::GroundTruth::default() };
    let script = Script { step: 0.05, instants: vec![instant], quiet: 1 };
    device.light(&script, &mut row);
    let darker = |colour: usize| -> Vec<f64> {
        let at = |block: usize| 5 * block + colour;
        (0..48).map(|block| 1.0 - row[at(block)] / device.zero[at(block)]).collect()
    };
    let lost: Vec<f64> = (0..3).map(|c| darker(c).iter().sum::<f64>() / 48.0).collect();
    assert_eq!(lost.iter().filter(|l| **l > 0.01).count(), 1, "one colour: {lost:?}");
    let own = (0..3).max_by(|a, b| lost[*a].total_cmp(&lost[*b])).unwrap();
    let (most, least) = darker(own).iter().fold((0.0f64, 1.0f64), |(m, l), d| (m.max(*d), l.min(*d)));
    assert!(most > least + 0.05, "not everywhere alike: {least} to {most}");
}

#[test]
fn a_scratch_shows_where_it_is_and_glare_on_some_presses() {
    let skin = skin();
    let scratch = Cause { id: "scratched-inside".to_owned(), strength: 1.0, seed: 2 };
    let Some(Region::Place { at, .. }) = place(&skin, &scratch) else { panic!("no place") };
    let scratched = device(&skin, &[scratch]);
    let seen = scratched.seeing.iter().copied().fold(0.0, f64::max);
    approx::assert_relative_eq!(seen, 1.0);
    let most = (0..48).max_by(|a, b| scratched.seeing[*a].total_cmp(&scratched.seeing[*b])).unwrap();
    let middle = [((most % 8) as f64 - 3.5) * 0.005, ((most / 8) as f64 - 2.5) * 0.005];
    assert!((middle[0] - at[0]).hypot(middle[1] - at[1]) < 0.006, "{middle:?} for {at:?}");

    let nominal = device(&skin, &[]);
    let script = Script::draw(&nominal.model(), &rig(&skin, 0.2), Climate::Varied, 3).unwrap();
    let clean = nominal.readings(&script, None).unwrap();
    let glare = Cause { id: "passing-glare".to_owned(), strength: 1.0, seed: 2 };
    let lit = device(&skin, &[glare]).readings(&script, None).unwrap();
    let channels = skin.channels().len();
    let mut presses = std::collections::BTreeMap::new();
    for ((a, b), instant) in clean.chunks(channels).zip(lit.chunks(channels)).zip(&script.instants) {
        if !instant.moment.stimulus.contacts.is_empty() {
            let bright = a.iter().zip(b).any(|(a, b)| b - a > 0.01);
            *presses.entry(instant.moment.press).or_insert(false) |= bright;
        }
    }
    let bright = presses.values().filter(|b| **b).count();
    assert!(bright > 0 && 2 * bright < presses.len(), "{bright} of {}", presses.len());
}
