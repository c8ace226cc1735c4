//! What a simulation would read.

use std::sync::Arc;

use dermis_model::{ForwardModel, Stimulus, Untouched};
use dermis_skin::SkinDescription;

use super::{MapBasis, ProgressFn};
use crate::LearnError;

/// Sensors that only the simulation has.
#[derive(Clone)]
pub enum VirtualSensors {
    /// Displacements of the points of the surface that lie nearest to each element of the skin: what the thesis uses.
    Displacements {
        /// Indices of points; those of one element follow one another.
        points: Vec<usize>,
        /// Points an element.
        each: usize,
    },
    /// Channels of a model, at best of the skin as it was designed: a device's readings then differ little from them, whatever
    /// touches it, and what single contacts teach of the difference holds for several.
    Channels {
        /// The model.
        model: Arc<dyn ForwardModel>,
        /// Its untouched readings.
        untouched: Untouched,
    },
}

impl std::fmt::Debug for VirtualSensors {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("VirtualSensors").field("count", &self.count()).finish_non_exhaustive()
    }
}

impl VirtualSensors {
    /// The `each` points of a model's surface that lie nearest to every element of a skin.
    #[must_use]
    pub fn displacements(model: &dyn ForwardModel, skin: &SkinDescription, each: usize) -> Self {
        let surface = model.surface();
        let mut points = Vec::new();
        for taxel in &skin.taxels {
            let foot = surface.project(&taxel.point()).0;
            let mut order: Vec<usize> = (0..surface.points.len()).collect();
            let distance = |i: &usize| (surface.points[*i] - foot).norm();
            order.sort_by(|a, b| distance(a).total_cmp(&distance(b)));
            points.extend(order.into_iter().take(each));
        }
        Self::Displacements { points, each }
    }

    /// The channels of a model.
    ///
    /// # Errors
    ///
    /// [`LearnError::Training`] where the model has no answer for the untouched skin.
    pub fn channels(model: Arc<dyn ForwardModel>) -> Result<Self, LearnError> {
        let untouched =
            Untouched::of(model.as_ref()).map_err(|e| LearnError::Training { reason: e.to_string() })?;
        Ok(Self::Channels { model, untouched })
    }

    /// Number of them.
    #[must_use]
    pub fn count(&self) -> usize {
        match self {
            Self::Displacements { points, .. } => points.len(),
            Self::Channels { untouched, .. } => untouched.readings().len(),
        }
    }

    /// In words.
    #[must_use]
    pub fn describe(&self) -> String {
        match self {
            Self::Displacements { points, each } => {
                format!("displacements of {} points, {each} near each element", points.len())
            }
            Self::Channels { .. } => format!("the {} channels of the skin as designed", self.count()),
        }
    }

    /// What they read of a stimulus whose map is `map`, appended to `out`.
    fn read(&self, stimulus: &Stimulus, map: &[f64], out: &mut Vec<f32>) -> Result<(), LearnError> {
        match self {
            Self::Displacements { points, .. } => out.extend(points.iter().map(|i| map[*i] as f32)),
            Self::Channels { model, untouched } => {
                let mut values = vec![0.0; self.count()];
                model
                    .response(stimulus, &mut values)
                    .map_err(|e| LearnError::Training { reason: e.to_string() })?;
                untouched.subtract(&mut values);
                out.extend(values.iter().map(|v| *v as f32));
            }
        }
        Ok(())
    }
}

/// Scenes as virtual sensors and maps see them.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Simulated {
    /// Row-major \[n, virtual sensors\]: \[m\], or the unit of the skin.
    pub sensors: Vec<f32>,
    /// Row-major \[n, points\] \[m\], or the amplitudes of a basis \[n, shapes\].
    pub maps: Vec<f32>,
}

impl Simulated {
    /// Adds what another holds.
    pub fn extend(&mut self, other: &Self) {
        self.sensors.extend_from_slice(&other.sensors);
        self.maps.extend_from_slice(&other.maps);
    }
}

/// Scenes of one block: as many maps as are in memory before they become amplitudes.
const BLOCK: usize = 256;

/// Simulates scenes; their maps become amplitudes where a basis is given, and are kept whole otherwise.
///
/// # Errors
///
/// [`LearnError::Training`] where the model has no answer, or knows no displacements.
pub fn simulate(
    model: &dyn ForwardModel,
    sensors: &VirtualSensors,
    scenes: &[Stimulus],
    basis: Option<&MapBasis>,
    progress: ProgressFn<'_>,
) -> Result<Simulated, LearnError> {
    let wrong = |reason: String| LearnError::Training { reason };
    let points = model.surface().points.len();
    let mut all = Simulated::default();
    let mut map = vec![0.0; points];
    let mut block: Vec<f32> = Vec::with_capacity(BLOCK * points);
    for (done, part) in scenes.chunks(BLOCK).enumerate() {
        progress("simulating contacts", (done * BLOCK) as f64 / scenes.len() as f64);
        block.clear();
        for scene in part {
            if !model.displacement(scene, &mut map).map_err(|e| wrong(e.to_string()))? {
                return Err(wrong("the forward model of this skin knows no displacements".into()));
            }
            sensors.read(scene, &map, &mut all.sensors)?;
            block.extend(map.iter().map(|v| *v as f32));
        }
        match basis {
            Some(basis) => all.maps.extend(basis.encode(&block)),
            None => all.maps.extend_from_slice(&block),
        }
    }
    Ok(all)
}
