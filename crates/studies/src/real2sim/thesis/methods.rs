//! Ways to contacts that stand beside each other in Fig. 3.8 and Table 3.2.
//!
//! | method | in the thesis |
//! |---|---|
//! | support vectors | chapter 2 |
//! | network on readings | FNN: five layers of 500 ReLU, readings → place and force |
//! | network on maps | the framework without k-Max: the same layers, map → place and force |
//! | peaks of maps | HapDefX: k-Max and the sensitivity network |

use std::sync::Arc;

use anyhow::Result;
use dermis_estimate::finder::{FindError, RegressionFinder};
use dermis_estimate::{ConditionedFrame, ContactFinder};
use dermis_inference::{MapContacts, Runtime};
use dermis_learn::real2sim::{MapRegressor, NetMap, Pipeline};
use dermis_learn::train::{Activation, NetworkConfig};
use dermis_regress::Method;
use dermis_skin::Contact;

use super::Known;
use crate::Progress;
use crate::regressions::{self, Learned as Presses, Most};

/// Hidden layers of networks that give one contact: section 3.3.1.
const DIRECT: [usize; 5] = [500; 5];

/// Peaks of the maps of a pipeline.
struct Peaks {
    pipeline: Arc<Pipeline>,
    reader: MapContacts,
}

impl ContactFinder for Peaks {
    fn find(&mut self, frame: &ConditionedFrame<'_>) -> Result<Vec<Contact>, FindError> {
        let signal: Vec<f32> = frame.signal.iter().map(|v| if v.is_finite() { *v } else { 0.0 }).collect();
        let map = self.pipeline.map(&signal).map_err(|e| FindError::Model(e.to_string()))?;
        self.reader.contacts(&map).map_err(|e| FindError::Model(e.to_string()))
    }
}

/// All methods, with their names.
pub(super) fn all(
    known: &Known,
    pipeline: &Arc<Pipeline>,
    vectors: usize,
    runtime: &Runtime,
    progress: &dyn Progress,
) -> Result<Vec<(String, Box<dyn ContactFinder>)>> {
    progress.begin("support vectors");
    let presses = Presses::of(&known.skin, &known.recorded);
    let most = Most { all: known.recorded.len(), vectors };
    let (support, _) = regressions::tuned(Method::Vectors, &known.skin, &presses, most)?;
    let reader = pipeline.contacts(known.model.surface(), runtime)?;
    let peaks = Peaks { pipeline: Arc::clone(pipeline), reader };
    Ok(vec![
        ("support vectors".into(), Box::new(support)),
        ("network on readings".into(), Box::new(on_readings(known, progress)?)),
        ("network on maps".into(), Box::new(on_maps(known, pipeline, progress)?)),
        ("peaks of maps".into(), Box::new(peaks)),
    ])
}

fn on_readings(known: &Known, progress: &dyn Progress) -> Result<RegressionFinder> {
    let noise: Vec<f32> = known.skin.channel_noise().iter().map(|n| *n as f32).collect();
    let whitened = known.recorded.iter().flat_map(|r| r.signal.iter().zip(&noise).map(|(v, n)| v / n));
    let direct = Direct::fit(known, "direct", &whitened.collect::<Vec<f32>>(), progress)?;
    let regress = move |row: &[f64]| {
        let row: Vec<f32> = row.iter().map(|v| *v as f32).collect();
        direct.predict(&row)
    };
    Ok(RegressionFinder::new(&known.skin, Box::new(regress)))
}

fn on_maps(known: &Known, pipeline: &Arc<Pipeline>, progress: &dyn Progress) -> Result<RegressionFinder> {
    let mut maps = Vec::new();
    for press in &known.recorded {
        maps.extend(pipeline.map(&press.signal)?.into_iter().map(|d| d as f32));
    }
    let direct = Direct::fit(known, "direct-on-maps", &maps, progress)?;
    drop(maps);
    let (noise, pipeline) = (known.skin.channel_noise(), Arc::clone(pipeline));
    let regress = move |row: &[f64]| {
        let signal: Vec<f32> = row.iter().zip(&noise).map(|(v, n)| (v * n) as f32).collect();
        let map = pipeline.map(&signal).map_err(|e| e.to_string())?;
        direct.predict(&map.iter().map(|d| *d as f32).collect::<Vec<f32>>())
    };
    Ok(RegressionFinder::new(&known.skin, Box::new(regress)))
}

/// A network that gives place and force of one contact.
struct Direct {
    net: NetMap,
    /// \[m\] and \[N\] that its outputs are in units of.
    scales: [f64; 2],
}

impl Direct {
    /// Fits rows of inputs, one for each recorded contact, for as many epochs as the transfer.
    fn fit(known: &Known, name: &str, inputs: &[f32], progress: &dyn Progress) -> Result<Self> {
        let recorded = &known.recorded;
        let largest = |of: &mut dyn Iterator<Item = f64>| of.fold(1e-9, f64::max);
        let scales = [
            largest(&mut recorded.iter().map(|r| r.contact.position.coords.amax())),
            largest(&mut recorded.iter().map(|r| r.contact.force.norm())),
        ];
        let row = |r: &dermis_learn::Recorded| {
            let p = r.contact.position / scales[0];
            [p.x, p.y, p.z, r.contact.force.norm() / scales[1]].map(|v| v as f32)
        };
        let targets: Vec<f32> = recorded.iter().flat_map(row).collect();
        let network = NetworkConfig {
            hidden: DIRECT.to_vec(),
            activation: Activation::Relu,
            ..NetworkConfig::default()
        };
        let training = &known.settings.pipeline.transfer_training;
        let states = known.states.of(&serde_json::to_string(&known.settings.pipeline)?);
        let width = inputs.len() / recorded.len().max(1);
        progress.begin(name);
        let report = &mut |p: dermis_learn::train::Progress| {
            progress.at(f64::from(p.epoch) / f64::from(p.epochs));
        };
        let keep = Some((&states, name));
        let net = NetMap::fit_kept((inputs, &targets), width, (&network, training), keep, report)?;
        Ok(Self { net, scales })
    }

    fn predict(&self, row: &[f32]) -> Result<Vec<f64>, String> {
        let answer = self.net.predict(row).map_err(|e| e.to_string())?;
        let scale = |(i, v): (usize, &f32)| f64::from(*v) * self.scales[usize::from(i == 3)];
        Ok(answer.iter().enumerate().map(scale).collect())
    }
}
