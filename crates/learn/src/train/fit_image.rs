//! From a data set to a network that draws a picture of forces.
//!
//! Problem: a network of transposed convolutions gives pixels, a node gives forces on the points of a surface. Method: the network
//! is fitted to pictures of the true contacts ([`Pictures`]) on the mean squared error of all pixels; in the graph that is
//! written, the pixels are mixed into forces on the points ([`Mixing`]), so that bundle, node and evaluation know a map and no picture.
//! Pixels are divided by their root mean square over the touched samples, which the mixing undoes. Inputs may get noise of each channel's
//! own standard deviation, such as a transfer network leaves ([`ChannelNoise`](super::ChannelNoise), thesis section 4.3.3). Cost: see
//! [`conv`](super::conv); pictures are drawn anew in every epoch where they are too many to be held ([`held`](super::held)).

use std::path::Path;
use std::sync::atomic::AtomicBool;

use dermis_inference::{Interface, TensorPort};
use serde_json::Value;

use super::ImageConfig;
use super::config::ChannelNoise;
use super::network::Progress;
use super::run::{Job, Trained, no_rows};
use super::run_conv::fit_spec;
use crate::LearnError;
use crate::dataset::Truth;
use crate::picture::{Mixing, Pictures};
use crate::target::{MAP_NORMAL, SIGNAL};

/// Fits a network that draws.
pub(super) fn fit_image(
    job: &Job<'_>,
    image: &ImageConfig,
    stop: &AtomicBool,
    progress: &(dyn Fn(Progress) + Sync),
) -> Result<Trained, LearnError> {
    let config = job.request.config;
    let surface = job.request.data.skin().surface();
    let (picture, inputs) = (image.picture(), job.features.input_len());
    let pictures = Pictures::new(picture, &surface)?;
    let mixing = Mixing::new(&picture, &surface)?;
    let scale = pixel_scale(job, &pictures)?;
    let unit = job.decoder.config().values.iter().find(|v| v.name == MAP_NORMAL).map_or(1.0, |v| v.scale);
    let noise = match &config.training.channel_noise {
        Some(noise) => channel_noise(job, noise)?,
        None => Vec::new(),
    };
    let targets = |truth: &Truth| {
        let mut pixels = Vec::with_capacity(picture.len());
        pictures.append(truth, &mut pixels);
        let known = !pixels.iter().any(|v| v.is_nan());
        let targets = pixels.into_iter().map(|v| (v / scale) as f32).collect();
        Ok(known.then(|| [vec![targets], Vec::new()]))
    };
    let spec = image.spec(MAP_NORMAL, inputs);
    let (network, samples) = fit_spec(job, &spec, (image.patience, noise), &targets, stop, progress)?;
    let graph = network.to_onnx_mixed("dermis", &mixing.clone().scaled(scale / unit))?;
    let port = |name: &str, shape: &[usize]| TensorPort { name: name.into(), shape: shape.to_vec() };
    let output = port(MAP_NORMAL, &[1, mixing.rows()]);
    let interface = Interface::of(&[port("input", &[1, inputs, 1, 1])], &[output]);
    Ok(Trained { graph, interface, samples, every: 1, choice: None })
}

/// \[N\] root mean square of the pixels of touched training samples.
fn pixel_scale(job: &Job<'_>, pictures: &Pictures) -> Result<f64, LearnError> {
    let data = job.request.data;
    let (mut squares, mut count, mut pixels) = (0.0, 0.0, Vec::new());
    for truth in job.split.train.iter().filter_map(|id| data.sample(*id)?.truth.as_ref()) {
        if !truth.touched() {
            continue;
        }
        pixels.clear();
        pictures.append(truth, &mut pixels);
        if pixels.iter().all(|v| v.is_finite()) {
            squares += pixels.iter().map(|v| v * v).sum::<f64>();
            count += pixels.len() as f64;
        }
    }
    Some(f64::sqrt(squares / count)).filter(|scale| scale.is_normal()).ok_or_else(no_rows)
}

/// Standard deviations of the noise of every input, in normalised units.
fn channel_noise(job: &Job<'_>, noise: &ChannelNoise) -> Result<Vec<f32>, LearnError> {
    let features = job.features;
    let (channels, inputs) = (features.scale.len(), features.input_len());
    let sigma = residual(&noise.bundle)?;
    if sigma.len() != channels || inputs != channels {
        return Err(LearnError::Training {
            reason: format!(
                "`training.channel_noise`: {} names {} channels where {channels} make {inputs} inputs: take a bundle of the same \
                 skin, and the newest frame only",
                noise.bundle.display(),
                sigma.len()
            ),
        });
    }
    let normalised = |(sigma, scale): (&f64, &f32)| (sigma * noise.share) as f32 / scale;
    Ok(sigma.iter().zip(&features.scale).map(normalised).collect())
}

/// What a transfer network leaves of each channel, as the card of its bundle says it, in the unit of the skin.
fn residual(bundle: &Path) -> Result<Vec<f64>, LearnError> {
    let path = bundle.join("card.json");
    let text = dermis_io::read_text(&path, dermis_io::REPORT).map_err(LearnError::io(&path, "read"))?;
    let wrong = |what: &str| LearnError::Training {
        reason: format!(
            "`training.channel_noise`: {} {what}: name the folder of a bundle with the target `{SIGNAL}`",
            path.display()
        ),
    };
    let card: Value = serde_json::from_str(&text).map_err(|_| wrong("is not JSON"))?;
    let deviation = card["held_out"]["maps"][SIGNAL]["channels"]["deviation"].as_array();
    let deviation = deviation.ok_or_else(|| wrong("holds no errors by channel"))?;
    let numbers: Option<Vec<f64>> =
        deviation.iter().map(|v| v.as_f64().filter(|v| v.is_finite() && *v >= 0.0)).collect();
    numbers.ok_or_else(|| wrong("holds errors by channel that are no numbers"))
}
