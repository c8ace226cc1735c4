//! Presses to come as a plan file: what a testbed runs and a person with a rig can follow.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::sync::Arc;

use anyhow::{Context, Result};
use dermis_gap::protocol::{Block, BlockKind, PlannedPress, Range, locations::locations};
use dermis_model::{ForwardModel, Indentation, Stimulus};
use dermis_skin::{Rated, SkinDescription, TipKind};
use dermis_testbed::{Plan, Timeline};
use nalgebra::{Point3, Vector3};
use serde::Serialize;

/// \[s\] untouched at both ends, in which the zero is seen.
const QUIET: f64 = 5.0;
/// \[s\] between first contacts of two presses that a rig needs beside what the plan says: the way to the surface.
const APPROACH: f64 = 0.1;

/// One step of a protocol: the same presses at some locations, or nothing.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ProtocolStep {
    /// What it is.
    pub what: String,
    /// What it is for.
    pub why: String,
    /// \[m\] on the surface, in the frame of the skin's link; none where nothing is touched.
    pub at: Vec<[f64; 3]>,
    /// \[N\] one after another at each place.
    pub forces: Vec<f64>,
    /// How often these are gone through.
    pub repeats: u32,
    /// \[m\] diameter of the tip.
    pub tip: f64,
    /// \[s\] to full force, at full force, to none, and untouched afterwards; the last one is the whole of a step that touches nothing.
    pub seconds: [f64; 4],
}

impl ProtocolStep {
    /// Nothing is touched.
    fn idle(seconds: f64, why: &str) -> Self {
        Self {
            what: "nothing touches".to_owned(),
            why: why.to_owned(),
            at: Vec::new(),
            forces: Vec::new(),
            repeats: 1,
            tip: 0.0,
            seconds: [0.0, 0.0, 0.0, seconds],
        }
    }

    /// One press after another at each place.
    fn of(kind: BlockKind, press: &PlannedPress, forces: &[f64], repeats: u32, at: &[[f64; 3]]) -> Self {
        Self {
            what: kind.name().to_owned(),
            why: kind.why().to_owned(),
            at: at.to_vec(),
            forces: forces.iter().map(|f| round(*f)).collect(),
            repeats,
            tip: press.tip,
            seconds: [press.load, press.hold, press.unload, press.rest],
        }
    }

    /// Presses in it.
    #[must_use]
    pub fn presses(&self) -> usize {
        self.at.len() * self.forces.len() * self.repeats as usize
    }

    /// \[min\] that it lasts, without the ways of the rig.
    #[must_use]
    pub fn minutes(&self) -> f64 {
        let one: f64 = self.seconds.iter().sum();
        if self.at.is_empty() { one / 60.0 } else { self.presses() as f64 * (one + APPROACH) / 60.0 }
    }
}

/// Three significant digits, as people read and set them.
fn round(value: f64) -> f64 {
    if value == 0.0 || !value.is_finite() {
        return value;
    }
    let scale = 10f64.powi(2 - value.abs().log10().floor() as i32);
    (value * scale).round() / scale
}

/// Presses of blocks that are alike, and the locations of these blocks \[m\].
type Alike<'a> = (&'a [PlannedPress], Vec<[f64; 3]>);

/// Presses to come, in their order.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Protocol {
    /// What recordings of it are called.
    pub name: String,
    /// One sentence.
    pub description: String,
    /// Name of the skin.
    pub skin: String,
    /// End of the usual tip.
    pub tip: TipKind,
    /// Forces and tips.
    pub range: Range,
    /// \[m\] that contacts keep from the rim.
    pub margin: f64,
    /// Seed of what instruments add to the ground truth.
    pub seed: u64,
    /// What is done.
    pub steps: Vec<ProtocolStep>,
}

impl Protocol {
    /// An empty protocol of a skin that begins with untouched readings.
    pub(super) fn new(
        name: &str,
        description: String,
        skin: &SkinDescription,
        range: Range,
        seed: u64,
    ) -> Self {
        Self {
            name: name.to_owned(),
            description,
            skin: skin.name.clone(),
            tip: skin.rated_press().tip,
            range,
            margin: Plan::rated_touches(skin).margin,
            seed,
            steps: vec![ProtocolStep::idle(QUIET, "the zero of every channel, and its noise")],
        }
    }

    /// Adds blocks: those of one kind together, those with another tip last, so that it is changed once.
    pub(super) fn add(&mut self, blocks: &[Block]) {
        let mut kinds: BTreeMap<BlockKind, Vec<Alike<'_>>> = BTreeMap::new();
        for block in blocks {
            let same = kinds.entry(block.kind).or_default();
            let at: [f64; 3] = block.at.coords.map(|v| (v * 1e6).round() * 1e-6).into();
            match same.iter_mut().find(|(presses, _)| *presses == block.presses) {
                Some((_, locations)) => locations.push(at),
                None => same.push((&block.presses, vec![at])),
            }
        }
        let (mut usual, mut other) = (Vec::new(), Vec::new());
        for (kind, groups) in kinds {
            for (presses, at) in groups {
                // Presses that follow on each other with one timing and one tip are one step.
                for run in presses.chunk_by(|a, b| PlannedPress { force: b.force, ..*a } == *b) {
                    let forces: Vec<f64> = run.iter().map(|p| p.force).collect();
                    let alike = forces.iter().all(|f| *f == forces[0]);
                    let (forces, repeats) =
                        if alike { (&forces[..1], run.len() as u32) } else { (&forces[..], 1) };
                    let step = ProtocolStep::of(kind, &run[0], forces, repeats, &at);
                    let to = if run[0].tip == self.range.tip { &mut usual } else { &mut other };
                    to.push(step);
                }
            }
        }
        self.steps.extend(usual);
        self.steps.extend(other);
    }

    /// Adds presses that are done again and again, between everything else.
    pub(super) fn refer(&mut self, blocks: &[Block]) {
        let before = self.steps.len();
        self.add(blocks);
        for step in &mut self.steps[before..] {
            "reference press".clone_into(&mut step.what);
            "what changes while the skin is on: warm-up, drift, ageing".clone_into(&mut step.why);
        }
    }

    /// Adds untouched readings at the end.
    pub(super) fn end(&mut self) {
        self.steps.push(ProtocolStep::idle(QUIET, "what is left, and how far the zero has gone"));
    }

    /// Presses in it.
    #[must_use]
    pub fn presses(&self) -> usize {
        self.steps.iter().map(ProtocolStep::presses).sum()
    }

    /// \[min\] that the presses last, without the ways of the rig.
    #[must_use]
    pub fn minutes(&self) -> f64 {
        self.steps.iter().map(ProtocolStep::minutes).sum()
    }

    /// As a plan file that `dermis collect` and `dermis device simulate` run.
    #[must_use]
    pub fn plan_text(&self) -> String {
        let quoted = |text: &str| toml_string(text);
        let mut text = format!(
            "# {}: {} presses, {:.1} min.\nschema = \"dermis-plan/1\"\nname = {}\ndescription = {}\nseed = {}\n",
            self.name,
            self.presses(),
            self.minutes(),
            quoted(&self.name),
            quoted(&self.description),
            self.seed
        );
        match self.tip {
            TipKind::Sphere => {
                let _ = writeln!(text, "diameter = {:?}          # [m]", self.range.tip);
            }
            TipKind::FlatPunch => {
                let _ = writeln!(
                    text,
                    "tip = {{ shape = {{ shape = \"flat-punch\", diameter = {:?} }} }}   # [m]",
                    self.range.tip
                );
            }
        }
        let _ = writeln!(text, "margin = {:?}", self.margin);
        let _ = write!(text, "\n[timing]\napproach = [{APPROACH:?}, {APPROACH:?}]\n");
        for step in &self.steps {
            let _ = write!(text, "\n# {}: {}.\n[[steps]]\n", step.what, step.why);
            if step.at.is_empty() {
                let _ = write!(text, "kind = \"idle\"\nduration = {:?}   # [s]\n", step.seconds[3]);
                continue;
            }
            text.push_str("kind = \"locations\"\nat = [\n");
            for [x, y, z] in &step.at {
                let _ = writeln!(text, "    [{x:?}, {y:?}, {z:?}],");
            }
            let _ = write!(text, "]   # [m]\nforces = {:?}   # [N]\n", step.forces);
            if step.repeats > 1 {
                let _ = writeln!(text, "repeats = {}", step.repeats);
            }
            if self.tip == TipKind::Sphere && step.tip != self.range.tip {
                let _ = writeln!(text, "diameter = {:?}   # [m]", step.tip);
            }
            let [load, hold, unload, gap] = step.seconds;
            let _ = write!(
                text,
                "load = [{load:?}, {load:?}]\nhold = [{hold:?}, {hold:?}]\nunload = [{unload:?}, {unload:?}]\ngap = [{gap:?}, {gap:?}]   # [s]\n"
            );
        }
        text
    }

    /// The plan that its text is.
    ///
    /// # Errors
    ///
    /// Where a testbed would refuse it.
    pub fn plan(&self) -> Result<Plan> {
        Ok(Plan::from_toml(&self.plan_text(), &self.name)?)
    }
}

/// A basic string of TOML.
fn toml_string(text: &str) -> String {
    toml::Value::String(text.to_owned()).to_string()
}

/// Forces and tips that a skin is rated for, with a second tip of twice the size where its model knows it.
pub(super) fn range(skin: &SkinDescription, model: &dyn ForwardModel) -> Range {
    let Rated { force, diameter, tip } = skin.rated_press();
    let second = 2.0 * diameter;
    let knows = || {
        let point = model.surface().points.get(model.surface().points.len() / 2)?;
        let (at, normal) = model.surface().project(point);
        let contact = Indentation::sphere(at, Vector3::from(normal * -force[0]), second);
        let stimulus = Stimulus { contacts: vec![contact], ..Stimulus::default() };
        model.response(&stimulus, &mut vec![0.0; model.channels()]).ok()
    };
    let second_tip = (tip == TipKind::Sphere && knows().is_some()).then_some(second);
    Range { force, tip: diameter, second_tip }
}

/// Where a protocol presses: at most `count` locations, the one that the skin feels best first.
pub(super) fn spread(
    skin: &SkinDescription,
    model: &Arc<dyn ForwardModel>,
    range: &Range,
    count: usize,
) -> Result<Vec<Point3<f64>>> {
    // A testbed says where it presses: margins, rims and holes are its own.
    let mut probe = Protocol::new("probe", String::new(), skin, *range, 0);
    probe.steps.clear();
    let may = |at: &Point3<f64>| {
        let mut probe = probe.clone();
        probe.add(&[Block { kind: BlockKind::Single, at: *at, presses: vec![range.press(0.5)] }]);
        probe.plan().is_ok_and(|plan| Timeline::new(&plan, model, 0).is_ok())
    };
    let found = locations(model.as_ref(), (range.force(0.6), range.tip), count, may)?;
    (!found.is_empty()).then_some(found).with_context(|| {
        format!("skin `{}` has no place where its rated tip of {} m may press", skin.name, range.tip)
    })
}
