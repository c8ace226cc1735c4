//! The gap over the surface.

use std::collections::BTreeMap;

use dermis_skin::Surface;
use nalgebra::Point3;
use serde::{Deserialize, Serialize};

use super::View;
use crate::constants::location::{BEYOND, KERNEL, KERNEL_CONTACTS, KERNELS, KNOWN, MAPPED, POINTS};

/// The gap over the surface.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Map {
    /// \[m\] locations, in the frame of the skin's link.
    pub points: Vec<[f64; 3]>,
    /// Mean of readings minus model over channels and contacts near each place, in the unit of the skin; `None` below the noise.
    pub mean: Vec<Option<f64>>,
    /// Root mean square of the same; `None` below the noise.
    pub rms: Vec<Option<f64>>,
    /// Where the gap is largest \[m\].
    pub peak: Option<[f64; 3]>,
    /// How much larger it is there than in the median place.
    pub prominence: f64,
}

/// The gap over the surface: contacts near each place, weighted by their distance.
#[must_use]
pub fn map(view: &View<'_>, surface: &Surface) -> Map {
    let usable = view.usable();
    let single: Vec<usize> = (0..view.samples.list.len())
        .filter(|i| view.samples.list[*i].contacts == 1 && view.samples.list[*i].phase.touched())
        .collect();
    if single.len() < MAPPED {
        return Map::default();
    }
    let area: f64 = surface.areas.iter().sum();
    let mut locations: Vec<[i64; 3]> =
        single.iter().map(|i| view.samples.list[*i].position.map(|v| (v * 1e5).round() as i64)).collect();
    locations.sort_unstable();
    locations.dedup();
    let width = (area / locations.len() as f64 * KERNEL_CONTACTS).sqrt().max(extent(surface) / KERNELS);
    let each = surface.points.len().div_ceil(POINTS).max(1);
    let mut map = Map::default();
    let mut strongest: Option<(f64, usize)> = None;
    let mut levels = Vec::new();
    for point in surface.points.iter().step_by(each) {
        let (mut weight, mut mean, mut square, mut contacts, mut raw) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for &i in &single {
            let away = (Point3::from(view.samples.list[i].position) - point).norm() / width;
            if away > KERNEL {
                continue;
            }
            let w = (-away * away / 2.0).exp();
            weight += w;
            contacts += w * w;
            for &k in &usable {
                let v = f64::from(view.row(i)[k]);
                mean += w * v * view.sigma[k];
                square += w * (v * view.sigma[k]).powi(2);
                raw += w * v * v;
            }
        }
        let n = usable.len().max(1) as f64;
        let effective = if contacts > 0.0 { weight * weight / contacts } else { 0.0 };
        let known = weight > KNOWN[0] && effective > KNOWN[1];
        let excess = raw / (weight.max(1e-12) * n);
        // Twice the noise of a mean over that many contacts.
        let beyond = known && excess > view.noise * (1.0 + BEYOND / (effective * n).sqrt());
        let value = (square / (weight.max(1e-12) * n)).sqrt();
        map.points.push((*point).into());
        map.mean.push(beyond.then(|| mean / (weight * n)));
        map.rms.push(beyond.then_some(value));
        if known {
            levels.push(value);
        }
        if beyond && strongest.is_none_or(|s| value > s.0) {
            strongest = Some((value, map.points.len() - 1));
        }
    }
    levels.sort_by(f64::total_cmp);
    let median = levels.get(levels.len() / 2).copied().unwrap_or(0.0);
    if let Some((value, index)) = strongest {
        map.peak = Some(map.points[index]);
        map.prominence = value / median.max(1e-300);
    }
    map
}

/// \[m\] largest extent of a surface.
fn extent(surface: &Surface) -> f64 {
    let mut found = BTreeMap::new();
    for p in &surface.points {
        for a in 0..3 {
            let (low, high) = found.entry(a).or_insert((f64::INFINITY, f64::NEG_INFINITY));
            *low = f64::min(*low, p[a]);
            *high = f64::max(*high, p[a]);
        }
    }
    found.values().map(|(low, high)| high - low).fold(0.0, f64::max)
}
