//! A script and its readings become a labelled bag of the kind that `dermis collect` writes.

use std::path::Path;

use dermis_bag::{BagQos, BagWriter};
use dermis_model::ForwardModel;
use dermis_msgs::TypeSupport;
use dermis_msgs::msg::{Contact, Indentation, SkinGeometry, TaxelFrame};
use dermis_skin::{ChannelFlags, Frame, SkinDescription, Stamp};
use nalgebra::Vector3;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use crate::{BenchmarkError, Script};

/// Stamp of the first frame of every recording \[ns\].
const START: Stamp = 1_790_000_000_000_000_000;
/// \[N\] and \[m\] standard deviations of the rig's own instruments: the thesis' force sensor and stage.
const FORCE_NOISE: f64 = 0.004;
const STAGE_NOISE: f64 = 7.5e-6;

/// Writes the bag `dir`: topics `taxels`, `ground_truth` and `skin_geometry`. `readings` has one row an instant of `script`. The
/// rig's force cell measures across the surface only; its instruments' errors are drawn by `seed`, and there are none without it.
///
/// # Errors
///
/// [`BenchmarkError::Bag`] where it cannot be written.
pub fn record(
    skin: &SkinDescription,
    model: &dyn ForwardModel,
    script: &Script,
    readings: &[f64],
    dir: &Path,
    seed: Option<u64>,
) -> Result<(), BenchmarkError> {
    let surface = model.surface();
    let mut rng = ChaCha8Rng::seed_from_u64(seed.unwrap_or_default());
    let [force_noise, stage_noise] = if seed.is_some() { [FORCE_NOISE, STAGE_NOISE] } else { [0.0; 2] };
    let mut writer = BagWriter::create(dir)?;
    writer.set_custom("skin_hash", skin.hash());
    writer.set_custom("force_noise", force_noise.to_string());
    writer.set_custom("stage_noise", stage_noise.to_string());
    writer.add_topic("skin_geometry", TypeSupport::of::<SkinGeometry>(), BagQos::latched())?;
    writer.add_topic("taxels", TypeSupport::of::<TaxelFrame>(), BagQos::sensor_data())?;
    writer.add_topic("ground_truth", TypeSupport::of::<Indentation>(), BagQos::sensor_data())?;
    writer.write("skin_geometry", &skin.geometry_message(surface, START), START)?;
    let ranges: Vec<Option<[f64; 2]>> = skin.channels().iter().map(|c| c.range).collect();
    let (mut press, mut offset) = (0, Vector3::zeros());
    for (index, (row, instant)) in readings.chunks(ranges.len()).zip(&script.instants).enumerate() {
        let mut frame = Frame {
            stamp: START + (instant.time * 1e9).round() as Stamp,
            sequence: index as u64,
            device_time_us: 1 + (instant.time * 1e6).round() as u64,
            temperature: instant.moment.stimulus.temperature as f32,
            ..Frame::default()
        };
        for (value, range) in row.iter().zip(&ranges) {
            let saturated = range.is_some_and(|[low, high]| *value <= low || *value >= high);
            frame.values.push(*value as f32);
            frame.flags.push(if saturated { ChannelFlags::SATURATED } else { ChannelFlags::OK });
        }
        writer.write("taxels", &skin.frame_message(&frame), frame.stamp)?;
        let mut moment = instant.moment.clone();
        if moment.press != press {
            press = moment.press;
            offset = Vector3::from_fn(|_, _| stage_noise * rng.sample::<f64, _>(StandardNormal));
        }
        for contact in &mut moment.stimulus.contacts {
            let (_, normal) = surface.project(&contact.position);
            contact.position += offset - normal * offset.dot(&normal);
            contact.position = surface.project(&contact.position).0;
            let pressing = -contact.force.dot(&normal) + force_noise * rng.sample::<f64, _>(StandardNormal);
            contact.force = -normal * pressing;
        }
        let session = format!("rig/{}", instant.session + 1);
        let mut label = moment.message(skin, surface, &session, frame.stamp);
        for contact in &mut label.contacts {
            contact.force_components = Contact::FORCE_NORMAL;
        }
        writer.write("ground_truth", &label, frame.stamp)?;
    }
    writer.finish()?;
    Ok(())
}
