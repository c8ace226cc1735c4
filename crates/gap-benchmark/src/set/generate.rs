//! Making a benchmark set: causes are dealt, their strengths searched, and the devices recorded.

use std::collections::BTreeMap;
use std::path::Path;

use dermis_skin::SkinDescription;
use rand::seq::SliceRandom;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::{
    Case, Disturbance, GROUND_TRUTH_SCHEMA, GroundTruth, Kind, MARGIN, Manifest, SET_SCHEMA, SetSpec,
    WithheldCause, bag_hash, folder, generator, json, sha256, write,
};
use crate::{
    BenchmarkError, Cause, CauseInfo, Cell, Climate, Designs, Noise, Numerics, ReferenceDevice, Script,
    parameters, unexplained,
};

/// Requested gaps, in multiples of the floor.
const GAPS: [f64; 3] = [3.0, 10.0, 1.0];
/// Noise, in multiples of the skin's.
const NOISES: [f64; 5] = [1.0, 3.0, 1.5, 5.0, 2.0];

/// Causes that a recording cannot tell apart by construction.
fn confusable(info: &CauseInfo) -> bool {
    [
        "common-gain",
        "shifted-rig",
        "air-pocket",
        "weather",
        "creeping",
        "stiffer-wall",
        "warm-zero",
        "walking-zero",
        "flowing-plastic",
        "stretching",
    ]
    .contains(&info.id)
}

/// The causes that count as this.
fn in_cell(known: &'static [CauseInfo], cell: Cell) -> Vec<&'static CauseInfo> {
    known.iter().filter(|k| k.cell == cell).collect()
}

/// What one case is to hold.
pub(super) struct Wanted {
    kind: Kind,
    pub(super) causes: Vec<&'static CauseInfo>,
    pub(super) gap: f64,
    pub(super) noise: f64,
    pub(super) disturbance: Disturbance,
}

impl Wanted {
    /// What the case counts as where so many of its causes reach the least gap.
    fn kind_with(&self, causes: usize) -> Kind {
        match causes {
            0 => Kind::Controls,
            n if n == self.causes.len() => self.kind,
            1 => Kind::Singles,
            _ => Kind::Pairs,
        }
    }
}

/// The cases of an order: every cause as often as any other, over all gaps and noise levels.
pub(super) fn wanted(order: &SetSpec, known: &'static [CauseInfo]) -> Vec<Wanted> {
    let mut rng = ChaCha8Rng::seed_from_u64(order.seed);
    let mut all = Vec::new();
    for &(kind, count) in &order.cases {
        let of: Vec<&'static CauseInfo> = match kind {
            Kind::Singles | Kind::Pairs | Kind::Triples => known.iter().filter(|k| k.listed).collect(),
            Kind::OutOfLibrary => known.iter().filter(|k| !k.listed).collect(),
            Kind::Confounded => known.iter().filter(|k| confusable(k)).collect(),
            Kind::Controls => Vec::new(),
            Kind::DoesNotRepeat => in_cell(known, Cell::DoesNotRepeat),
            Kind::SameLaw => in_cell(known, Cell::SameLaw),
            Kind::OtherLaw => in_cell(known, Cell::OtherLaw),
            Kind::DesignNumber => in_cell(known, Cell::DesignNumber),
            Kind::Foreign => in_cell(known, Cell::Foreign),
        };
        let at_once = match kind {
            Kind::Controls => 0,
            Kind::Pairs => 2,
            Kind::Triples => 3,
            _ => 1,
        };
        // No device of this skin has such a cause.
        if of.len() < at_once {
            continue;
        }
        let mut deck: Vec<&CauseInfo> = Vec::new();
        let mut dealt: BTreeMap<&str, usize> = BTreeMap::new();
        for i in 0..count {
            let mut causes: Vec<&'static CauseInfo> = Vec::new();
            while causes.len() < at_once && of.len() >= at_once {
                if deck.is_empty() {
                    deck.clone_from(&of);
                    deck.shuffle(&mut rng);
                }
                match deck.iter().position(|k| !causes.iter().any(|c| c.id == k.id)) {
                    Some(place) => causes.push(deck.swap_remove(place)),
                    None => deck.clear(),
                }
            }
            // Each cause goes through all pairs of gap and noise for itself: their numbers have no common divisor.
            let turn = causes.first().map_or(i, |first| {
                let count =
                    dealt.entry(first.id).or_insert_with(|| rng.random_range(0..GAPS.len() * NOISES.len()));
                *count += 1;
                *count
            });
            all.push(Wanted {
                kind,
                gap: match turn % GAPS.len() {
                    _ if causes.is_empty() => 0.0,
                    // A cell is of gaps that matter.
                    turn if order.cells => GAPS[turn % 2],
                    turn => GAPS[turn],
                },
                noise: NOISES[turn % NOISES.len()],
                disturbance: if kind == Kind::Controls && order.cells {
                    Disturbance::ALL[i % Disturbance::ALL.len()]
                } else {
                    Disturbance::Plain
                },
                causes,
            });
        }
    }
    if order.cases.len() > 1 {
        all.shuffle(&mut rng);
    }
    all
}

/// One case, not yet written.
struct Made {
    truth: GroundTruth,
    presses: usize,
    script: Script,
    readings: Vec<f64>,
    device: Box<dyn ReferenceDevice>,
    seed: u64,
}

/// The presses of a case.
struct Presses {
    climate: Climate,
    /// Cases of one number have the same.
    number: usize,
    seed: u64,
}

impl Presses {
    fn draw(order: &SetSpec, index: usize, kind: Kind, rng: &mut ChaCha8Rng) -> Self {
        let scripts = order.scripts();
        let (climate, number) = if kind == Kind::Confounded {
            (Climate::OnlyWarmer, scripts + index % 2)
        } else {
            (Climate::Varied, rng.random_range(0..scripts))
        };
        let mut rng = ChaCha8Rng::seed_from_u64(order.seed ^ 0x5c81);
        rng.set_stream(number as u64);
        Self { climate, number, seed: rng.random() }
    }
}

/// The nominal device of a case under its presses: what causes and noise are measured against.
struct Trial<'a> {
    skin: &'a SkinDescription,
    designs: &'a Designs<'a>,
    numerics: Numerics,
    script: Script,
    /// What it reads, noise-free.
    clean: Vec<f64>,
}

/// Causes of a case, as strong as its gap requires.
struct Scaled {
    causes: Vec<Cause>,
    /// Fraction of variance that each moves alone.
    alone: Vec<f64>,
    /// Gap that they have, in multiples of the floor; 0 where there is none.
    gap: f64,
}

impl Trial<'_> {
    /// Share of the variance that noise of the skin's channels makes up, `factor` times as strong.
    fn noise_share(&self, factor: f64) -> f64 {
        let sigma = self.skin.channel_noise();
        // Readings that are off by one deviation everywhere but at the start, whose mean is the zero.
        let mut off = self.clean.clone();
        for row in off.chunks_mut(sigma.len()).skip(self.script.quiet) {
            row.iter_mut().zip(&sigma).for_each(|(v, s)| *v += factor * s);
        }
        unexplained(&self.clean, &off, &self.script, sigma.len())
    }

    /// Fraction of the variance that causes move, noise-free.
    fn moved(&self, causes: &[Cause]) -> Result<f64, BenchmarkError> {
        let device = crate::reference_device(self.skin, &self.numerics, causes, self.designs)?;
        let other = device.readings(&self.script, None)?;
        Ok(unexplained(&self.clean, &other, &self.script, self.skin.channels().len()))
    }

    /// The cause at the strength at which it alone moves `target` of the variance, or as near to that as it comes, and what it moves then.
    fn moving(&self, target: f64, info: &CauseInfo, seed: u64) -> Result<(Cause, f64), BenchmarkError> {
        let mut cause = Cause { id: info.id.to_owned(), strength: 0.25, seed };
        let mut reached = self.moved(std::slice::from_ref(&cause))?;
        // The variance that a cause moves grows with its strength, about as its square: once there is one on either side of
        // the target, the search stays between them.
        let (mut weak, mut strong) = (None::<(f64, f64)>, None::<(f64, f64)>);
        for _ in 0..12 {
            if (reached / target - 1.0).abs() < 0.08 || (cause.strength >= 1.0 && reached < target) {
                break;
            }
            let side = if reached < target { &mut weak } else { &mut strong };
            *side = Some((cause.strength, reached));
            let next = match (weak, strong) {
                (Some((a, below)), Some((b, above))) => {
                    let part = (target / below.max(1e-12)).ln() / (above / below.max(1e-12)).ln();
                    a * (b / a).powf(part.clamp(0.1, 0.9))
                }
                _ => cause.strength * (target / reached.max(1e-9)).sqrt().clamp(0.2, 4.0),
            };
            cause.strength = next.clamp(1e-5, 1.0);
            reached = self.moved(std::slice::from_ref(&cause))?;
        }
        Ok((cause, reached))
    }

    /// The wanted causes at the largest gap up to the wanted one that each of them can have.
    fn scaled(&self, wanted: &Wanted, seeds: &[u64], floor: f64) -> Result<Scaled, BenchmarkError> {
        let (mut causes, mut alone, mut gap) = (Vec::new(), Vec::new(), wanted.gap);
        // A cause that cannot be as strong is taken at the next smaller gap.
        while gap > 0.0 {
            causes.clear();
            alone.clear();
            for (info, seed) in wanted.causes.iter().zip(seeds) {
                let (cause, reached) = self.moving(gap * floor, info, *seed)?;
                causes.push(cause);
                alone.push(reached);
            }
            if alone.iter().all(|a| (0.7 * gap * floor..1.5 * gap * floor).contains(a)) {
                break;
            }
            gap = match gap {
                g if g > 3.0 => 3.0,
                g if g > 1.0 => 1.0,
                _ => 0.0,
            };
        }
        if gap == 0.0 && !causes.is_empty() {
            // One that cannot be as weak counts at the largest gap that it surely has; one that cannot reach the least is left out.
            let all = causes.into_iter().zip(alone);
            (causes, alone) = all.filter(|(_, reached)| *reached >= 0.7 * floor).unzip();
            let least = alone.iter().copied().fold(f64::INFINITY, f64::min);
            let surely = |g: &&f64| **g <= wanted.gap && least >= 0.7 * **g * floor;
            gap =
                if causes.is_empty() { 0.0 } else { GAPS.iter().filter(surely).copied().fold(0.0, f64::max) };
        }
        Ok(Scaled { causes, alone, gap })
    }
}

/// Causes as a ground truth describes them.
fn withheld(skin: &SkinDescription, causes: Vec<Cause>) -> Result<Vec<WithheldCause>, BenchmarkError> {
    let known = crate::causes(skin)?;
    let described = causes.into_iter().map(|cause| WithheldCause {
        what: known.iter().find(|k| k.id == cause.id).map_or("", |k| k.what).to_owned(),
        parameters: parameters(known, &cause),
        region: crate::region(skin, &cause),
        cause,
    });
    Ok(described.collect())
}

/// Draws a case and records its device.
fn make(
    skin: &SkinDescription,
    order: &SetSpec,
    designs: &Designs<'_>,
    index: usize,
    wanted: &Wanted,
) -> Result<Made, BenchmarkError> {
    let mut rng = ChaCha8Rng::seed_from_u64(order.seed);
    rng.set_stream(1 + index as u64);
    let case = format!("case-{:04}", index + 1);
    let numerics =
        if wanted.kind == Kind::Controls { Numerics::varied(rng.random()) } else { Numerics::default() };
    let rig = crate::rig(skin, order.size)?;
    let noise_seed: u64 = rng.random();
    let presses = Presses::draw(order, index, wanted.kind, &mut rng);
    let nominal = crate::reference_device(skin, &numerics, &[], designs)?;
    let script = Script::draw(&nominal.model(), &rig, presses.climate, presses.seed)?;
    let clean = nominal.readings(&script, None)?;
    let trial = Trial { skin, designs, numerics, script, clean };

    let noise = match wanted.disturbance {
        Disturbance::Louder => rng.random_range(1.3..2.0),
        // As the skin's description says.
        _ if order.cells && wanted.kind == Kind::Controls => 1.0,
        _ => wanted.noise.min(rig.loudest),
    };
    let floor = trial.noise_share(noise) + MARGIN;
    let seeds: Vec<u64> = wanted.causes.iter().map(|_| rng.random()).collect();
    let Scaled { causes, alone, gap } = trial.scaled(wanted, &seeds, floor)?;

    let device = crate::reference_device(skin, &trial.numerics, &causes, designs)?;
    // How deep a tip sinks in is what the rig sees of this reference device.
    let mut script = Script::draw(&device.model(), &rig, presses.climate, presses.seed)?;
    let heavy = wanted.disturbance == Disturbance::HeavyTails;
    let mut readings = device.readings(&script, Some(Noise { seed: noise_seed, factor: noise, heavy }))?;
    if wanted.disturbance == Disturbance::LostFrames {
        lose(&mut script, &mut readings, skin.channels().len(), noise_seed);
    }
    let truth = GroundTruth {
        schema: GROUND_TRUTH_SCHEMA.to_owned(),
        generator: generator(),
        salt: sha256(format!("salt/{}/{case}/{}", order.seed, rng.random::<u128>()).as_bytes()),
        case,
        kind: wanted.kind_with(causes.len()),
        seed: order.seed,
        unexplained: if causes.is_empty() { 0.0 } else { trial.moved(&causes)? },
        causes: withheld(skin, causes)?,
        gap,
        noise,
        disturbance: wanted.disturbance,
        floor,
        alone,
        numerics: trial.numerics,
        only_warmer: presses.climate == Climate::OnlyWarmer,
        size: order.size,
    };
    Ok(Made { truth, presses: presses.number, script, readings, device, seed: presses.seed ^ 0x7a51 })
}

/// Share of frames that are lost, and frames of a burst at most.
const LOST: (f64, u32) = (0.1, 12);

/// Loses frames, single ones and bursts: what a full buffer drops.
fn lose(script: &mut Script, readings: &mut Vec<f64>, channels: usize, seed: u64) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x105e);
    let mean = f64::from(1 + LOST.1) / 2.0;
    let mut left = 0;
    let kept: Vec<bool> = (0..script.instants.len())
        .map(|i| {
            if left == 0 && i > script.quiet && rng.random::<f64>() < LOST.0 / mean {
                left = rng.random_range(1..=LOST.1);
            }
            let lost = left > 0;
            left = left.saturating_sub(1);
            !lost
        })
        .collect();
    let mut rows = kept.iter();
    script.instants.retain(|_| rows.next().copied().unwrap_or(true));
    let all = readings.chunks(channels).zip(&kept).filter(|(_, kept)| **kept);
    *readings = all.flat_map(|(row, _)| row.to_vec()).collect();
}

/// Records the reference device of a ground truth once more in the bag `dir`: with other presses, without noise, and with the exact ground truth, so
/// that what a tool claims of this reference device is measured on what it never saw.
///
/// # Errors
///
/// [`BenchmarkError`] where the ground truth is of another skin, or the bag cannot be written.
pub fn record_again(
    skin: &SkinDescription,
    truth: &GroundTruth,
    designs: &Designs<'_>,
    dir: &Path,
) -> Result<(), BenchmarkError> {
    let causes: Vec<Cause> = truth.causes.iter().map(|withheld| withheld.cause.clone()).collect();
    let device = crate::reference_device(skin, &truth.numerics, &causes, designs)?;
    let climate = if truth.only_warmer { Climate::OnlyWarmer } else { Climate::Varied };
    let rig = crate::rig(skin, truth.size)?;
    let seed = truth.salt.bytes().fold(0xa9a1u64, |seed, b| seed.rotate_left(7) ^ u64::from(b));
    let script = Script::draw(&device.model(), &rig, climate, seed)?;
    let readings = device.readings(&script, None)?;
    crate::record(skin, &*device.model(), &script, &readings, dir, None)
}

/// Presses the reference device of a ground truth as a plan says, with its noise, after it was switched on anew; the material is as it was
/// at first. The bag is `dir`.
///
/// # Errors
///
/// [`BenchmarkError`] where the ground truth is of another skin, the plan does not fit it, or the bag cannot be written.
pub fn press(
    skin: &SkinDescription,
    truth: &GroundTruth,
    designs: &Designs<'_>,
    plan: &str,
    seed: u64,
    dir: &Path,
) -> Result<(), BenchmarkError> {
    let causes: Vec<Cause> = truth.causes.iter().map(|withheld| withheld.cause.clone()).collect();
    let device = crate::reference_device(skin, &truth.numerics, &causes, designs)?;
    let rig = crate::rig(skin, truth.size)?;
    let seed = truth.salt.bytes().fold(seed ^ 0xf011, |seed, b| seed.rotate_left(7) ^ u64::from(b));
    let mut script = Script::of_plan(plan, &device.model(), rig.rate, seed)?;
    let heavy = truth.disturbance == Disturbance::HeavyTails;
    let mut readings = device.readings(&script, Some(Noise { seed, factor: truth.noise, heavy }))?;
    if truth.disturbance == Disturbance::LostFrames {
        lose(&mut script, &mut readings, skin.channels().len(), seed);
    }
    crate::record(skin, &*device.model(), &script, &readings, dir, Some(seed))
}

/// Makes a benchmark set in the folder `dir` and its ground truths in `ground_truths`, neither of which may hold one yet. `skin_text` is the skin file,
/// which goes into the benchmark set. `done` is called for every case that is finished, and ends the work where it returns `false`; what is
/// there by then is a valid, smaller set. `designs` makes the models of families whose design the benchmark does not compute.
///
/// # Errors
///
/// [`BenchmarkError`] where no reference device is like the skin, or a file cannot be written.
pub fn generate(
    skin_text: &str,
    order: &SetSpec,
    designs: &Designs<'_>,
    dir: &Path,
    ground_truths: &Path,
    mut done: impl FnMut(usize) -> bool,
) -> Result<Manifest, BenchmarkError> {
    let skin = SkinDescription::from_toml(skin_text, "skin")?;
    for path in [dir, ground_truths] {
        let taken = std::fs::read_dir(path).is_ok_and(|mut entries| entries.next().is_some());
        if taken {
            let reason = "is not empty: a benchmark set is made in a new folder".to_owned();
            return Err(BenchmarkError::File { path: path.to_owned(), reason });
        }
        folder(path)?;
    }
    folder(&dir.join("bags"))?;
    write(&dir.join("skin.toml"), skin_text.as_bytes())?;
    let mut manifest = Manifest {
        schema: SET_SCHEMA.to_owned(),
        generator: generator(),
        kind: order.kind(),
        skin: skin.name.clone(),
        skin_hash: skin.hash(),
        size: order.size,
        cases: Vec::new(),
    };
    for (index, wanted) in wanted(order, crate::causes(&skin)?).iter().enumerate() {
        let made = make(&skin, order, designs, index, wanted)?;
        let id = made.truth.case.clone();
        let bag = Path::new("bags").join(&id);
        crate::record(
            &skin,
            &*made.device.model(),
            &made.script,
            &made.readings,
            &dir.join(&bag),
            Some(made.seed),
        )?;
        let path = ground_truths.join(format!("{id}.json"));
        let bytes = json(&path, &made.truth)?;
        write(&path, &bytes)?;
        let bag_sha256 = bag_hash(&dir.join(&bag))?;
        manifest.cases.push(Case {
            id,
            bag,
            ground_truth_sha256: sha256(&bytes),
            bag_sha256,
            presses: made.presses,
        });
        if !done(index + 1) {
            break;
        }
    }
    let path = dir.join("manifest.json");
    write(&path, &json(&path, &manifest)?)?;
    Ok(manifest)
}
