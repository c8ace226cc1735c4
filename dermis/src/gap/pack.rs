//! Packs of recordings with withheld causes, for the check of the diagnosis.

use std::path::PathBuf;
use std::sync::atomic::Ordering;

use anyhow::{Context, Result};
use clap::{Args, ValueEnum};
use dermis_gap_benchmark::set::{self, Manifest, SetSpec};
use dermis_skin::SkinDescription;
use indicatif::{ProgressBar, ProgressStyle};

/// What is withheld.
#[derive(Debug, Clone, Copy, ValueEnum)]
enum Kind {
    /// One cause that the literature lists.
    Singles,
    /// Two of them.
    Pairs,
    /// Three of them.
    Triples,
    /// None: another mesh and other laws only.
    Controls,
    /// A cause that no library holds.
    OutOfLibrary,
    /// A cause that the recording cannot tell from another.
    Confounded,
}

impl From<Kind> for set::Kind {
    fn from(kind: Kind) -> Self {
        match kind {
            Kind::Singles => Self::Singles,
            Kind::Pairs => Self::Pairs,
            Kind::Triples => Self::Triples,
            Kind::Controls => Self::Controls,
            Kind::OutOfLibrary => Self::OutOfLibrary,
            Kind::Confounded => Self::Confounded,
        }
    }
}

/// What to make.
#[derive(Args)]
pub struct Options {
    /// What is withheld; where absent, all kinds in the proportions of a full pack, mixed.
    #[arg(long, value_enum)]
    kind: Option<Kind>,
    /// Skin description.
    #[arg(long)]
    skin: PathBuf,
    /// Number of cases, of one kind.
    #[arg(long, requires = "kind")]
    count: Option<usize>,
    /// Share of a full pack, which has 180 cases with one cause, 100 without, 60 with one that no library holds, 60 with two, 20
    /// with three and 20 with one that the recording cannot tell: `full`, `small` (0.15) or a number.
    #[arg(long, default_value = "full", value_parser = share)]
    share: f64,
    /// Of everything random. Who knows it can make the secrets again: publish it after they are opened, not before.
    #[arg(long)]
    seed: u64,
    /// Presses of each case, compared to the usual 150.
    #[arg(long, default_value_t = 1.0, value_parser = size)]
    size: f64,
    /// Folder of the secrets, apart from the pack; must not hold any yet.
    #[arg(long, value_name = "DIR")]
    secret: PathBuf,
    /// Folder of the pack; must not hold one yet.
    #[arg(short, long)]
    out: PathBuf,
    /// One JSON object.
    #[arg(long)]
    json: bool,
}

fn share(text: &str) -> Result<f64, String> {
    match text {
        "full" => Ok(1.0),
        "small" => Ok(0.15),
        _ => match text.parse::<f64>() {
            Ok(share) if share > 0.0 && share <= 100.0 => Ok(share),
            _ => Err(format!("`{text}` is no share: write `full`, `small` or a number above 0, at most 100")),
        },
    }
}

fn size(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(size) if (0.05..=100.0).contains(&size) => Ok(size),
        _ => Err(format!("`{text}` is no size: write a number from 0.05 to 100")),
    }
}

/// Makes it. Ctrl-C ends early with a smaller, valid pack.
pub fn run(options: &Options) -> Result<()> {
    let text = dermis_io::read_text(&options.skin, dermis_io::TEXT)
        .with_context(|| format!("skin file {} cannot be read", options.skin.display()))?;
    SkinDescription::from_toml(&text, &options.skin.display().to_string())?;
    let mut order = SetSpec::mixed(options.share, options.seed, options.size);
    if let Some(kind) = options.kind.map(set::Kind::from) {
        order.cases.retain(|(of, _)| *of == kind);
        if let (Some(count), [(_, cases)]) = (options.count, &mut order.cases[..]) {
            *cases = count;
        }
    }
    let progress = ProgressBar::new(order.count() as u64)
        .with_style(ProgressStyle::with_template("cases {wide_bar} {human_pos}/{human_len}, {eta} left")?);
    progress.tick();
    let stop = crate::interrupt::stop_on_interrupt()?;
    let manifest = set::generate(&text, &order, &options.out, &options.secret, |done| {
        progress.set_position(done as u64);
        !stop.load(Ordering::Acquire)
    })?;
    progress.finish_and_clear();
    let hash = Manifest::hash(&options.out)?;
    if options.json {
        println!(
            "{}",
            serde_json::json!({ "pack": options.out, "cases": manifest.cases.len(), "sha256": hash })
        );
    } else {
        println!(
            "{}: {} cases of {} on {}, sha256 {hash}; secrets in {}",
            options.out.display(),
            manifest.cases.len(),
            manifest.kind.map_or("all kinds", set::Kind::name),
            manifest.skin,
            options.secret.display()
        );
    }
    Ok(())
}
