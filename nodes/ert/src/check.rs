//! Electrodes that are open, shorted or wired wrongly, found from single frames.
//!
//! Problem: an electrode that fails takes its injection and all of its readings along, 55 of 784 voltages, and what is left looks like
//! touches. Method: what no touch can read. With electrode k fed, V_kk = V_s (Z_kk + z_k) / (Z_kk + z_k + R_s), and no point of a sheet
//! without sources of its own has more potential than the electrode that is fed (maximum principle). So
//!
//! * one whose own injection reads nothing, and that reads nothing of the others, is open; with one of the two, the multiplexer does
//!   not feed it, or not read it;
//! * a reading above V_s comes from elsewhere: a supply, or an input that floats;
//! * a reading above that of the electrode that is fed is not of that injection: frames or wires are in another order;
//! * with a short of r to ground at electrode e and nothing else, V_ek / V_kk = r / (r + R_ke), where R_ke = Z_kk + Z_ee − 2 Z_ke of the
//!   untouched sheet; that gives r as a median over all k. Touches elsewhere make it look smaller, by as much as they conduct. A short is
//!   believed below [`BELOW`] of what [`TIPS`] tips at the largest force that the skin is rated for make together, so that a press is
//!   no short. Weaker ones are not distinguished from something that leans on the panel.
//!
//! Of several shorts the strongest is found, and those about as strong ([`ALIKE`]); the others once that is mended. Wires that were
//! exchanged at both ends of the multiplexer give a sheet that can be: only the diagnosis of the gap finds them.
//!
//! Assumptions: the nominal sheet. Cost: 28² divisions and 28 medians a frame, some tens of microseconds.

use dermis_model::{Indentation, Stimulus, Tip, TipShape};
use dermis_sensor::{ElementFault, FrameCheck};
use dermis_skin::{Frame, ModelError, SkinDescription};

use crate::model::FabricModel;

/// Tips that may press a panel at once.
const TIPS: f64 = 6.0;
/// Share of their resistance below which a short is believed.
const BELOW: f64 = 0.5;
/// Factor of the strongest short's resistance up to which another electrode is shorted, too: beside a short, electrodes that are whole
/// seem to have 1.3 times its resistance or more.
const ALIKE: f64 = 1.15;
/// Share of the source's voltage below which nothing is read.
const SILENT: f64 = 0.1;
/// Share of the source's voltage that electrodes read in the middle where all current goes to an electrode that is shorted hard: about a
/// half; where six tips press, nine tenths.
const DRAINED: f64 = 0.75;
/// Deviations of the noise above which a difference of two readings is none of it.
const SURE: f64 = 8.0;
/// Share of the source's voltage by which it may be above what the skin file says.
const SOURCE: f64 = 0.02;
/// Frames in a row that must show what noise and a change during a scan could, for once.
const LASTING: u32 = 20;

/// What is wrong with an electrode.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Fault {
    Open,
    NotFed,
    NotRead,
    Above,
    /// Another electrode reads more while this one is fed.
    Order(usize),
    /// \[Ω\]
    Short(f64),
}

/// Looks at the frames of a panel.
#[derive(Debug)]
pub struct ElectrodeCheck {
    names: Vec<String>,
    /// \[V\].
    source: f64,
    /// \[V\] by which readings must differ.
    margin: f64,
    /// \[Ω\] between every two electrodes of the untouched sheet.
    between: Vec<f64>,
    /// \[Ω\] below which an electrode is shorted.
    shorted: f64,
    /// Frames in a row that showed another order, and a short.
    lasting: Vec<[u32; 2]>,
    ratios: Vec<f64>,
}

impl ElectrodeCheck {
    /// Of a panel as its description says, whatever effects that switches on.
    ///
    /// # Errors
    ///
    /// [`ModelError::Description`] where the panel cannot be.
    pub fn new(skin: &SkinDescription) -> Result<Self, ModelError> {
        let mut design = skin.clone();
        design.effects.clear();
        let model = FabricModel::new(&design)?;
        let rated = skin.rated_press();
        let surface = &model.parameters().surface;
        let (position, normal) = surface.project(&nalgebra::Point3::from(
            surface.points.iter().map(|p| p.coords).sum::<nalgebra::Vector3<f64>>()
                / surface.points.len().max(1) as f64,
        ));
        let shape = TipShape::of_kind(rated.tip, rated.diameter);
        let press =
            Indentation { position, force: -normal * rated.force[1], tip: Tip::standing(shape, &normal) };
        let loads = model.loads(&Stimulus { contacts: vec![press], ..Stimulus::default() })?;
        let pressed: f64 = loads.iter().map(|load| load.conductance).sum();
        let n = model.sheet().electrodes();
        let z = model.sheet().transfer();
        let between = (0..n * n)
            .map(|i| {
                let (k, e) = (i / n, i % n);
                z[k * n + k] + z[e * n + e] - 2.0 * z[k * n + e]
            })
            .collect();
        Ok(Self {
            names: skin.taxels.iter().map(|taxel| taxel.name.clone()).collect(),
            source: model.parameters().drive.source,
            margin: SURE * skin.channel_noise().into_iter().fold(0.0, f64::max),
            between,
            shorted: if pressed > 0.0 { BELOW / (TIPS * pressed) } else { 0.0 },
            lasting: vec![[0; 2]; n],
            ratios: Vec::with_capacity(n * n),
        })
    }

    fn electrodes(&self) -> usize {
        self.names.len()
    }

    /// Median of what was put into the ratios.
    fn median(&mut self) -> Option<f64> {
        let middle = self.ratios.len() / 2;
        (!self.ratios.is_empty()).then(|| *self.ratios.select_nth_unstable_by(middle, f64::total_cmp).1)
    }

    /// What is seen at once: electrodes that are not fed or not read, and those that read what no sheet gives.
    fn silent(&self, v: &[f32]) -> Vec<Option<Fault>> {
        let n = self.electrodes();
        let at = |fed: usize, read: usize| f64::from(v[fed * n + read]);
        let others = |e: usize| (0..n).filter(move |j| *j != e);
        // Channels that have no number say nothing.
        let most = |values: &mut dyn Iterator<Item = f64>| values.filter(|v| v.is_finite()).reduce(f64::max);
        let above = self.source * (1.0 + SOURCE) + self.margin;
        let quiet = |most: Option<f64>| most.is_some_and(|most| most < SILENT * self.source);
        (0..n)
            .map(|e| {
                let fed = quiet(most(&mut (0..n).map(|j| at(e, j))));
                let read = quiet(most(&mut others(e).map(|k| at(k, e)))) && at(e, e) < SILENT * self.source;
                let high = others(e).filter(|k| at(*k, e) > above).count();
                match (fed, read) {
                    (true, true) => Some(Fault::Open),
                    (true, false) => Some(Fault::NotFed),
                    (false, true) => Some(Fault::NotRead),
                    (false, false) => (2 * high > n - 1).then_some(Fault::Above),
                }
            })
            .collect()
    }

    /// Whether all of the current of whole electrodes goes to one.
    fn drained(&mut self, v: &[f32], faults: &[Option<Fault>]) -> bool {
        let n = self.electrodes();
        self.ratios.clear();
        for k in (0..n).filter(|k| faults[*k].is_none()) {
            let row = &v[k * n..(k + 1) * n];
            let read =
                row.iter().enumerate().filter(|(j, v)| *j != k && faults[*j].is_none() && v.is_finite());
            self.ratios.extend(read.map(|(_, v)| f64::from(*v) / self.source));
        }
        self.median().is_some_and(|share| share < DRAINED)
    }

    /// \[Ω\] to ground that each electrode seems to have.
    fn resistances(&mut self, v: &[f32], faults: &[Option<Fault>]) -> Vec<f64> {
        let n = self.electrodes();
        let mut found = vec![f64::INFINITY; n];
        for e in (0..n).filter(|e| faults[*e].is_none()) {
            self.ratios.clear();
            for k in (0..n).filter(|k| *k != e && faults[*k].is_none()) {
                let share = f64::from(v[k * n + e]) / f64::from(v[k * n + k]);
                if share.is_finite() {
                    let left = (1.0 - share).max(f64::EPSILON);
                    self.ratios.push(self.between[k * n + e] * share.max(0.0) / left);
                }
            }
            found[e] = self.median().unwrap_or(f64::INFINITY);
        }
        found
    }

    /// The electrode that reads most while `fed` is fed, where that is not `fed` itself.
    fn out_of_order(&self, v: &[f32], fed: usize, faults: &[Option<Fault>]) -> Option<usize> {
        let n = self.electrodes();
        let row = &v[fed * n..(fed + 1) * n];
        let read = (0..n).filter(|j| *j != fed && faults[*j].is_none() && row[*j].is_finite());
        let most = read.max_by(|a, b| row[*a].total_cmp(&row[*b]))?;
        (f64::from(row[most]) > f64::from(row[fed]) + self.margin).then_some(most)
    }

    /// What is wrong with each electrode.
    fn evaluate(&mut self, v: &[f32]) -> Vec<Option<Fault>> {
        let n = self.electrodes();
        let mut faults = self.silent(v);
        let resistances = self.resistances(v, &faults);
        let least = resistances.iter().copied().fold(f64::INFINITY, f64::min);
        // An electrode that is shorted hard is as silent as an open one, but drains the panel.
        if faults.contains(&Some(Fault::Open)) && self.drained(v, &faults) {
            for fault in faults.iter_mut().filter(|fault| **fault == Some(Fault::Open)) {
                *fault = Some(Fault::Short(0.0));
            }
        }
        for e in 0..n {
            let order = if faults[e].is_none() { self.out_of_order(v, e, &faults) } else { None };
            let short = resistances[e] < self.shorted && resistances[e] <= ALIKE * least;
            let [ordered, lasted] = &mut self.lasting[e];
            *ordered = if order.is_some() { ordered.saturating_add(1) } else { 0 };
            *lasted = if short { lasted.saturating_add(1) } else { 0 };
            if faults[e].is_none() && *lasted >= LASTING {
                faults[e] = Some(Fault::Short(resistances[e]));
            } else if let Some(other) = order.filter(|_| *ordered >= LASTING) {
                faults[e] = Some(Fault::Order(other));
            }
        }
        faults
    }

    /// In words, and which channels say nothing by it.
    fn explain(&self, e: usize, fault: Fault) -> ElementFault {
        let n = self.electrodes();
        let row = e * n..(e + 1) * n;
        let column = (0..n).map(|k| k * n + e);
        let both = || row.clone().chain(column.clone().filter(|c| !row.contains(c))).collect();
        let (sentence, channels) = match fault {
            Fault::Open => {
                ("is open, nothing is fed and nothing is read: check its wire and its seam".into(), both())
            }
            Fault::NotFed => {
                ("is not fed but read: check the multiplexer of the source".into(), row.collect())
            }
            Fault::NotRead => {
                ("is fed but not read: check the multiplexer of the converter".into(), column.collect())
            }
            Fault::Above => (
                format!(
                    "reads more than the {} V of the source: its input floats or touches a supply; check its wire, and \
                     `medium.drive.source_voltage`",
                    self.source
                ),
                column.collect(),
            ),
            Fault::Order(other) => (
                format!(
                    "reads less than electrode {} while it is fed, which no touch does: check that injections come in the order of \
                     the skin file, and that its wires are not exchanged",
                    self.names[other]
                ),
                row.collect(),
            ),
            Fault::Short(resistance) => (
                format!(
                    "is shorted to the top layer by about {:.1} kohm, which takes current from every reading: find the thread that \
                     touches it; contacts are uncertain until then",
                    resistance * 1e-3
                ),
                both(),
            ),
        };
        ElementFault { element: format!("electrode {}", self.names[e]), sentence, channels }
    }
}

impl FrameCheck for ElectrodeCheck {
    fn check(&mut self, frame: &Frame, faults: &mut Vec<ElementFault>) {
        let n = self.electrodes();
        if frame.values.len() != n * n {
            return;
        }
        let found = self.evaluate(&frame.values);
        faults.extend(found.into_iter().enumerate().filter_map(|(e, fault)| Some(self.explain(e, fault?))));
    }

    fn reset(&mut self) {
        self.lasting.fill([0; 2]);
    }
}

#[cfg(test)]
mod tests;
