//! Benchmark sets: recordings whose causes are withheld, sealed by the hash of what is withheld.
//!
//! A benchmark set's folder is public: `manifest.json`, `skin.toml` and one bag a case under `bags/`. Its ground truths lie in another folder, one
//! file a case. A ground truth holds a salt, so that nobody guesses it from its hash; the seed that would rebuild it is in the ground truths
//! only.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use dermis_skin::SkinDescription;
use rand::seq::SliceRandom;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::{
    BenchmarkError, Cause, CauseInfo, Climate, Numerics, ReferenceDevice, Region, Script, parameters,
    unexplained,
};

/// Schema of a manifest.
pub const SET_SCHEMA: &str = "gap-benchmark-set/1";
/// Schema that manifests had before; they are read as well.
const OLD_SCHEMA: &str = "gap-pack/1";
/// Schema of a ground truth.
pub const GROUND_TRUTH_SCHEMA: &str = "gap-ground-truth/1";
/// Fraction of variance that counts as practically explained: part of every floor, beside the noise.
pub const MARGIN: f64 = 0.005;
/// Cases of a full benchmark set, by what is withheld.
pub const FULL: [(Kind, usize); 6] = [
    (Kind::Singles, 180),
    (Kind::Controls, 100),
    (Kind::OutOfLibrary, 60),
    (Kind::Pairs, 60),
    (Kind::Triples, 20),
    (Kind::Confounded, 20),
];
/// Gaps that are asked for, in multiples of the floor.
const GAPS: [f64; 3] = [3.0, 10.0, 1.0];
/// Noise, in multiples of the skin's.
const NOISES: [f64; 5] = [1.0, 3.0, 1.5, 5.0, 2.0];

/// What is withheld in the cases of a benchmark set.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// One cause that the literature lists.
    Singles,
    /// Two of them.
    Pairs,
    /// Three of them.
    Triples,
    /// No cause: another mesh and other laws only.
    Controls,
    /// A cause that no list holds.
    OutOfLibrary,
    /// A cause that this recording cannot tell from another: the temperature only rises, or nothing else shows it.
    Confounded,
}

impl Kind {
    /// As a command line says it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Singles => "singles",
            Self::Pairs => "pairs",
            Self::Triples => "triples",
            Self::Controls => "controls",
            Self::OutOfLibrary => "out-of-library",
            Self::Confounded => "confounded",
        }
    }
}

/// A cause, told to whoever opens the ground truth.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct WithheldCause {
    /// The cause itself.
    #[serde(flatten)]
    pub cause: Cause,
    /// Physical description.
    pub what: String,
    /// Sizes in SI units.
    pub parameters: BTreeMap<String, f64>,
    /// Where it sits, if it does.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub region: Option<Region>,
}

/// What is withheld of one case.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct GroundTruth {
    schema: String,
    /// Program and version that made it.
    pub generator: String,
    /// Case that it belongs to.
    pub case: String,
    /// What the case counts as: by the causes that reach the least gap, so that it is a control where none does.
    pub kind: Kind,
    /// Random, so that the hash tells nothing.
    pub salt: String,
    /// Seed of the whole set.
    pub seed: u64,
    /// Causes at work.
    pub causes: Vec<WithheldCause>,
    /// Gap that was asked for, in multiples of `floor`; 0 for controls.
    pub gap: f64,
    /// Noise, in multiples of the skin's.
    pub noise: f64,
    /// Fraction of variance that noise and practical margin make up.
    pub floor: f64,
    /// Fraction of variance that the causes move, noise-free: validated, not asked for.
    pub unexplained: f64,
    /// The same of each cause alone, in their order.
    pub alone: Vec<f64>,
    /// How the reference device is computed.
    #[serde(alias = "form")]
    pub numerics: Numerics,
    /// How the temperature runs.
    pub only_warmer: bool,
    /// How many presses, compared to the usual 150.
    pub size: f64,
}

/// One case, as everybody may see it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Case {
    /// Name.
    pub id: String,
    /// Folder of the bag, below that of the benchmark set.
    pub bag: PathBuf,
    /// SHA-256 of the ground truth's file.
    #[serde(alias = "secret_sha256")]
    pub ground_truth_sha256: String,
    /// SHA-256 of the bag's files, one after another in the order of their names.
    pub bag_sha256: String,
    /// Which presses it has: cases of one number have the same ground truth.
    pub presses: usize,
}

/// What everybody may see of a benchmark set.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    schema: String,
    /// Program and version that made it.
    pub generator: String,
    /// What is withheld in every case; `None` where each case holds something else, and which is withheld, too.
    pub kind: Option<Kind>,
    /// Name of the skin.
    pub skin: String,
    /// Its hash.
    pub skin_hash: String,
    /// How many presses a case has, compared to the usual 150.
    pub size: f64,
    /// The cases.
    pub cases: Vec<Case>,
}

/// What a benchmark set is made of.
#[derive(Debug, Clone, PartialEq)]
pub struct SetSpec {
    /// How many cases of each kind, in the order of kinds where there is one only, else mixed.
    pub cases: Vec<(Kind, usize)>,
    /// Of everything.
    pub seed: u64,
    /// How many presses a case has, compared to the usual 150.
    pub size: f64,
}

impl SetSpec {
    /// The proportions of a full benchmark set, at `share` of its cases, at least one of each kind.
    #[must_use]
    pub fn mixed(share: f64, seed: u64, size: f64) -> Self {
        let scaled = |count: usize| (count as f64 * share).round().max(1.0) as usize;
        Self { cases: FULL.map(|(kind, count)| (kind, scaled(count))).to_vec(), seed, size }
    }

    /// Number of cases.
    #[must_use]
    pub fn count(&self) -> usize {
        self.cases.iter().map(|(_, count)| count).sum()
    }

    /// Kind of all cases, where there is one only.
    fn kind(&self) -> Option<Kind> {
        match self.cases[..] {
            [(kind, _)] => Some(kind),
            _ => None,
        }
    }

    /// How many scripts the cases share. What was done and how well the rig knows it is the same in all cases of a script, so that
    /// a tool simulates its signatures once for them.
    fn scripts(&self) -> usize {
        (self.count() / 24).clamp(2, 16)
    }
}

/// Hexadecimal SHA-256.
#[must_use]
pub fn sha256(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|b| format!("{b:02x}")).collect()
}

fn generator() -> String {
    format!("{} {}", env!("CARGO_PKG_NAME"), env!("CARGO_PKG_VERSION"))
}

fn read(path: &Path) -> Result<Vec<u8>, BenchmarkError> {
    dermis_io::read(path, dermis_io::TABLE).map_err(BenchmarkError::io(path, "read"))
}

fn write(path: &Path, bytes: &[u8]) -> Result<(), BenchmarkError> {
    std::fs::write(path, bytes).map_err(BenchmarkError::io(path, "written"))
}

fn folder(path: &Path) -> Result<(), BenchmarkError> {
    std::fs::create_dir_all(path).map_err(BenchmarkError::io(path, "made"))
}

fn parse<T: serde::de::DeserializeOwned>(path: &Path, bytes: &[u8]) -> Result<T, BenchmarkError> {
    serde_json::from_slice(bytes)
        .map_err(|e| BenchmarkError::File { path: path.to_owned(), reason: e.to_string() })
}

fn json<T: Serialize>(path: &Path, value: &T) -> Result<Vec<u8>, BenchmarkError> {
    let mut bytes = serde_json::to_vec_pretty(value)
        .map_err(|e| BenchmarkError::File { path: path.to_owned(), reason: e.to_string() })?;
    bytes.push(b'\n');
    Ok(bytes)
}

/// SHA-256 of the files of a bag, in the order of their names.
fn bag_hash(dir: &Path) -> Result<String, BenchmarkError> {
    let mut files: Vec<PathBuf> = std::fs::read_dir(dir)
        .map_err(BenchmarkError::io(dir, "read"))?
        .filter_map(|entry| entry.ok().map(|e| e.path()))
        .filter(|path| path.is_file())
        .collect();
    files.sort();
    let mut hash = Sha256::new();
    for file in files {
        hash.update(read(&file)?);
    }
    Ok(hash.finalize().iter().map(|b| format!("{b:02x}")).collect())
}

impl Manifest {
    /// Reads that of the benchmark set `dir`.
    ///
    /// # Errors
    ///
    /// [`BenchmarkError::File`] where it is none of ours.
    pub fn load(dir: &Path) -> Result<Self, BenchmarkError> {
        let path = dir.join("manifest.json");
        let manifest: Self = parse(&path, &read(&path)?)?;
        if ![SET_SCHEMA, OLD_SCHEMA].contains(&manifest.schema.as_str()) {
            let reason = format!("field `schema` is \"{}\" where \"{SET_SCHEMA}\" is read", manifest.schema);
            return Err(BenchmarkError::File { path, reason });
        }
        Ok(manifest)
    }

    /// SHA-256 of the manifest's file: with it everything of the benchmark set is said.
    ///
    /// # Errors
    ///
    /// [`BenchmarkError::Io`] where it cannot be read.
    pub fn hash(dir: &Path) -> Result<String, BenchmarkError> {
        Ok(sha256(&read(&dir.join("manifest.json"))?))
    }
}

/// Opens the ground truth of `case` in the folder `ground truths`.
///
/// # Errors
///
/// [`BenchmarkError::Seal`] where it is not the one whose hash was published.
pub fn open_ground_truth(ground_truths: &Path, case: &Case) -> Result<GroundTruth, BenchmarkError> {
    let path = ground_truths.join(format!("{}.json", case.id));
    let bytes = read(&path)?;
    let found = sha256(&bytes);
    if found != case.ground_truth_sha256 {
        return Err(BenchmarkError::Seal { path, found, published: case.ground_truth_sha256.clone() });
    }
    parse(&path, &bytes)
}

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

/// What one case is to hold.
struct Wanted {
    kind: Kind,
    causes: Vec<&'static CauseInfo>,
    gap: f64,
    noise: f64,
}

/// The cases of an order: every cause as often as any other, over all gaps and noise levels.
fn wanted(order: &SetSpec, known: &'static [CauseInfo]) -> Vec<Wanted> {
    let mut rng = ChaCha8Rng::seed_from_u64(order.seed);
    let mut all = Vec::new();
    for &(kind, count) in &order.cases {
        let of: Vec<&'static CauseInfo> = match kind {
            Kind::Singles | Kind::Pairs | Kind::Triples => known.iter().filter(|k| k.listed).collect(),
            Kind::OutOfLibrary => known.iter().filter(|k| !k.listed).collect(),
            Kind::Confounded => known.iter().filter(|k| confusable(k)).collect(),
            Kind::Controls => Vec::new(),
        };
        let at_once = match kind {
            Kind::Controls => 0,
            Kind::Pairs => 2,
            Kind::Triples => 3,
            _ => 1,
        };
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
            // Each cause walks through all pairs of gap and noise for itself: their numbers have no common divisor.
            let turn = causes.first().map_or(i, |first| {
                let count =
                    dealt.entry(first.id).or_insert_with(|| rng.random_range(0..GAPS.len() * NOISES.len()));
                *count += 1;
                *count
            });
            all.push(Wanted {
                kind,
                gap: if causes.is_empty() { 0.0 } else { GAPS[turn % GAPS.len()] },
                noise: NOISES[turn % NOISES.len()],
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

/// Share of the variance that noise of the skin's channels makes up, `factor` times as strong.
fn noise_share(clean: &[f64], skin: &SkinDescription, script: &Script, factor: f64) -> f64 {
    let sigma = skin.channel_noise();
    // Readings that are off by one deviation everywhere but at the start, whose mean is the zero.
    let mut off = clean.to_vec();
    for row in off.chunks_mut(sigma.len()).skip(script.quiet) {
        row.iter_mut().zip(&sigma).for_each(|(v, s)| *v += factor * s);
    }
    unexplained(clean, &off, script, sigma.len())
}

fn make(
    skin: &SkinDescription,
    order: &SetSpec,
    index: usize,
    wanted: &Wanted,
) -> Result<Made, BenchmarkError> {
    let mut rng = ChaCha8Rng::seed_from_u64(order.seed);
    rng.set_stream(1 + index as u64);
    let case = format!("case-{:04}", index + 1);
    let numerics =
        if wanted.kind == Kind::Controls { Numerics::varied(rng.random()) } else { Numerics::default() };
    let rig = crate::rig(skin, order.size)?;
    let channels = skin.channels().len();
    let noise_seed: u64 = rng.random();
    let scripts = order.scripts();
    let (climate, presses) = if wanted.kind == Kind::Confounded {
        (Climate::OnlyWarmer, scripts + index % 2)
    } else {
        (Climate::Varied, rng.random_range(0..scripts))
    };
    let script_seed = {
        let mut rng = ChaCha8Rng::seed_from_u64(order.seed ^ 0x5c81);
        rng.set_stream(presses as u64);
        rng.random()
    };
    let nominal = crate::reference_device(skin, &numerics, &[])?;
    let script = Script::draw(&nominal.model(), &rig, climate, script_seed)?;
    let clean = nominal.readings(&script, None)?;
    let floor = noise_share(&clean, skin, &script, wanted.noise) + MARGIN;

    let moved = |causes: &[Cause]| -> Result<f64, BenchmarkError> {
        let other = crate::reference_device(skin, &numerics, causes)?.readings(&script, None)?;
        Ok(unexplained(&clean, &other, &script, channels))
    };
    let mut causes = Vec::new();
    let mut alone = Vec::new();
    let mut gap = wanted.gap;
    let seeds: Vec<u64> = wanted.causes.iter().map(|_| rng.random()).collect();
    // A cause that cannot be as strong is taken at the next smaller gap.
    while gap > 0.0 {
        causes.clear();
        alone.clear();
        for (info, seed) in wanted.causes.iter().zip(&seeds) {
            let mut cause = Cause { id: info.id.to_owned(), strength: 0.25, seed: *seed };
            let target = gap * floor;
            let mut reached = moved(std::slice::from_ref(&cause))?;
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
                reached = moved(std::slice::from_ref(&cause))?;
            }
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
        gap = if causes.is_empty() { 0.0 } else { GAPS.iter().filter(surely).copied().fold(0.0, f64::max) };
    }
    let kind = match causes.len() {
        0 => Kind::Controls,
        n if n == wanted.causes.len() => wanted.kind,
        1 => Kind::Singles,
        _ => Kind::Pairs,
    };
    let device = crate::reference_device(skin, &numerics, &causes)?;
    // How deep a tip sinks in is what the rig sees of this reference device.
    let script = Script::draw(&device.model(), &rig, climate, script_seed)?;
    let readings = device.readings(&script, Some((noise_seed, wanted.noise)))?;
    let known = crate::causes(skin)?;
    let truth = GroundTruth {
        schema: GROUND_TRUTH_SCHEMA.to_owned(),
        generator: generator(),
        salt: sha256(format!("salt/{}/{case}/{}", order.seed, rng.random::<u128>()).as_bytes()),
        case,
        kind,
        seed: order.seed,
        unexplained: if causes.is_empty() { 0.0 } else { moved(&causes)? },
        causes: causes
            .into_iter()
            .map(|cause| WithheldCause {
                what: known.iter().find(|k| k.id == cause.id).map_or("", |k| k.what).to_owned(),
                parameters: parameters(known, &cause),
                region: crate::region(skin, &cause),
                cause,
            })
            .collect(),
        gap,
        noise: wanted.noise,
        floor,
        alone,
        numerics,
        only_warmer: climate == Climate::OnlyWarmer,
        size: order.size,
    };
    Ok(Made { truth, presses, script, readings, device, seed: script_seed ^ 0x7a51 })
}

/// Records the reference device of a ground truth once more in the bag `dir`: with other presses, without noise, and with the exact ground truth, so
/// that what a tool claims of this reference device is measured on what it never saw.
///
/// # Errors
///
/// [`BenchmarkError`] where the ground truth is of another skin, or the bag cannot be written.
pub fn record_again(skin: &SkinDescription, truth: &GroundTruth, dir: &Path) -> Result<(), BenchmarkError> {
    let causes: Vec<Cause> = truth.causes.iter().map(|withheld| withheld.cause.clone()).collect();
    let device = crate::reference_device(skin, &truth.numerics, &causes)?;
    let climate = if truth.only_warmer { Climate::OnlyWarmer } else { Climate::Varied };
    let rig = crate::rig(skin, truth.size)?;
    let seed = truth.salt.bytes().fold(0xa9a1u64, |seed, b| seed.rotate_left(7) ^ u64::from(b));
    let script = Script::draw(&device.model(), &rig, climate, seed)?;
    let readings = device.readings(&script, None)?;
    crate::record(skin, &*device.model(), &script, &readings, dir, None)
}

/// Makes a benchmark set in the folder `dir` and its ground truths in `ground truths`, neither of which may hold one yet. `skin_text` is the skin file,
/// which goes into the benchmark set. `done` is told of every case that is finished, and ends the work where it returns `false`; what is
/// there by then is a valid, smaller set.
///
/// # Errors
///
/// [`BenchmarkError`] where no reference device is like the skin, or a file cannot be written.
pub fn generate(
    skin_text: &str,
    order: &SetSpec,
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
        let made = make(&skin, order, index, wanted)?;
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

#[cfg(test)]
mod tests {
    use super::*;

    const LINE: &str = include_str!("../../../launch/skins/baro-line.toml");

    fn order(kind: Kind, count: usize) -> SetSpec {
        SetSpec { cases: vec![(kind, count)], seed: 11, size: 0.12 }
    }

    #[test]
    fn a_set_is_sealed_and_the_same_every_time() {
        let dir = tempfile::tempdir().unwrap();
        let (set, ground_truths) = (dir.path().join("pack"), dir.path().join("secrets"));
        let made = generate(LINE, &order(Kind::Singles, 3), &set, &ground_truths, |_| true).unwrap();
        assert_eq!(Manifest::load(&set).unwrap(), made);
        for case in &made.cases {
            let truth = open_ground_truth(&ground_truths, case).unwrap();
            if truth.kind == Kind::Singles {
                let [withheld] = &truth.causes[..] else { panic!("{truth:?}") };
                assert!(!withheld.what.is_empty() && !withheld.parameters.is_empty());
                let reached = truth.unexplained / (truth.gap * truth.floor);
                assert!((0.7..1.5).contains(&reached), "{reached}: {truth:?}");
            }
            // Nothing public names what is withheld.
            let public = std::fs::read_to_string(set.join("manifest.json")).unwrap();
            for withheld in &truth.causes {
                assert!(!public.contains(&withheld.cause.id));
            }
        }
        let (set2, ground_truths2) = (dir.path().join("pack2"), dir.path().join("secrets2"));
        let again = generate(LINE, &order(Kind::Singles, 3), &set2, &ground_truths2, |_| true).unwrap();
        let seals = |m: &Manifest| m.cases.iter().map(|c| c.ground_truth_sha256.clone()).collect::<Vec<_>>();
        assert_eq!(seals(&again), seals(&made));

        let case = &made.cases[0];
        let path = ground_truths.join(format!("{}.json", case.id));
        let text = std::fs::read_to_string(&path).unwrap();
        std::fs::write(&path, text.replace("\"seed\": 11", "\"seed\": 12")).unwrap();
        let refused = open_ground_truth(&ground_truths, case).unwrap_err().to_string();
        assert!(refused.contains("was changed after it was sealed"), "{refused}");
        let taken =
            generate(LINE, &order(Kind::Singles, 3), &set, &ground_truths, |_| true).unwrap_err().to_string();
        assert!(taken.contains("is not empty"), "{taken}");
    }

    #[test]
    fn every_cause_is_dealt_as_often_as_any_other() {
        let skin = SkinDescription::from_toml(LINE, "line").unwrap();
        let known = crate::causes(&skin).unwrap();
        let listed = known.iter().filter(|k| k.listed).count();
        assert!(listed >= 12 && known.len() - listed >= 8);
        let cases = wanted(&order(Kind::Singles, 15 * listed), known);
        let mut seen: BTreeMap<(&str, u8, u8), usize> = BTreeMap::new();
        for case in &cases {
            *seen.entry((case.causes[0].id, case.gap as u8, (2.0 * case.noise) as u8)).or_default() += 1;
        }
        assert_eq!(seen.len(), 15 * listed, "every cause at every gap and noise level, once");
        for case in wanted(&order(Kind::Triples, 3), known) {
            assert_eq!(case.causes.len(), 3);
        }
        assert!(wanted(&order(Kind::Controls, 3), known).iter().all(|c| c.causes.is_empty()));
    }
}
