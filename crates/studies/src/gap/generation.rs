//! Makes benchmark sets of the diagnosis: recordings with withheld causes, and the causes apart from them.

use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::Args;
use dermis_gap_benchmark::Designs;
use dermis_gap_benchmark::set::{self, Kind, Manifest, SetSpec};
use dermis_skin::SkinDescription;
use serde::{Deserialize, Serialize};

use crate::Families;

/// What to make.
#[derive(Debug, Clone, Args, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Request {
    /// What is withheld; where absent, all kinds in the proportions of a full set, mixed.
    #[arg(long, value_enum)]
    #[serde(default)]
    pub kind: Option<Kind>,
    /// Skin description.
    #[arg(long)]
    pub skin: PathBuf,
    /// Number of cases, of one kind.
    #[arg(long, requires = "kind")]
    #[serde(default)]
    pub count: Option<usize>,
    /// Cases of each cell of the scorecard (does not repeat; in the library with the same law, with another law; design number off;
    /// systematic and foreign; two causes; controls), mixed, in place of a share of a full set.
    #[arg(long, value_name = "N", conflicts_with_all = ["kind", "share"])]
    #[serde(default)]
    pub cells: Option<usize>,
    /// Share of a full set, which has 180 cases with one cause, 100 without, 60 with one that no library holds, 60 with two, 20
    /// with three and 20 with one that the recording cannot tell: `full`, `small` (0.15) or a number.
    #[arg(long, default_value = "full", value_parser = share)]
    #[serde(default = "whole")]
    pub share: f64,
    /// Of everything random. Who knows it can make the ground truths again: publish it after they are opened, not before.
    #[arg(long)]
    pub seed: u64,
    /// Presses of each case, compared to the usual 150.
    #[arg(long, default_value_t = 1.0, value_parser = size)]
    #[serde(default = "whole")]
    pub size: f64,
    /// Folder of the ground truths, apart from the set; must not hold any yet.
    #[arg(long, alias = "secret", value_name = "DIR")]
    #[serde(alias = "secret")]
    pub truth: PathBuf,
    /// Folder of the set; must not hold one yet.
    #[arg(short, long)]
    pub out: PathBuf,
}

fn whole() -> f64 {
    1.0
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

impl Request {
    /// How many cases of what.
    #[must_use]
    pub fn order(&self) -> SetSpec {
        if let Some(count) = self.cells {
            return SetSpec::cells(count, self.seed, self.size);
        }
        let mut order = SetSpec::mixed(self.share, self.seed, self.size);
        if let Some(kind) = self.kind {
            order.cases.retain(|(of, _)| *of == kind);
            // A full set does not hold the kinds of single cells.
            if order.cases.is_empty() {
                order.cases.push((kind, 1));
            }
            if let (Some(count), [(_, cases)]) = (self.count, &mut order.cases[..]) {
                *cases = count;
            }
        }
        order
    }
}

/// What was made.
#[derive(Debug, Clone, Serialize)]
pub struct Findings {
    /// Folder of the set.
    pub set: PathBuf,
    /// How many cases it has.
    pub cases: usize,
    /// Hash of the set.
    pub sha256: String,
    /// Folder of the ground truths.
    #[serde(skip)]
    pub truth: PathBuf,
    /// What is withheld in all of them; `all kinds` where they are mixed.
    #[serde(skip)]
    pub kind: &'static str,
    /// Name of the skin.
    #[serde(skip)]
    pub skin: String,
}

/// Makes a set. `done` is called with the number of finished cases and ends the work where it returns `false`; what is there by
/// then is a valid, smaller set.
///
/// # Errors
///
/// Where the skin file cannot be used, or a folder is not empty or cannot be written.
pub fn generate(request: &Request, families: &Families, done: impl FnMut(usize) -> bool) -> Result<Findings> {
    let text = dermis_io::read_text(&request.skin, dermis_io::TEXT)
        .with_context(|| format!("skin file {} cannot be read", request.skin.display()))?;
    SkinDescription::from_toml(&text, &request.skin.display().to_string())?;
    let make = |skin: &SkinDescription| families.model(skin).map_err(|e| format!("{e:#}"));
    let designs = Designs::new(&make);
    let manifest = set::generate(&text, &request.order(), &designs, &request.out, &request.truth, done)?;
    Ok(Findings {
        set: request.out.clone(),
        cases: manifest.cases.len(),
        sha256: Manifest::hash(&request.out)?,
        truth: request.truth.clone(),
        kind: manifest.kind.map_or("all kinds", Kind::name),
        skin: manifest.skin,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_kind_has_as_many_cases_as_were_asked_for() {
        let request = |kind, count| Request {
            kind,
            skin: PathBuf::new(),
            count,
            cells: None,
            share: 0.15,
            seed: 1,
            size: 1.0,
            truth: PathBuf::new(),
            out: PathBuf::new(),
        };
        assert_eq!(request(Some(Kind::Pairs), Some(7)).order().count(), 7);
        assert_eq!(request(Some(Kind::Foreign), Some(7)).order().count(), 7);
        let mixed = request(None, None).order();
        let pairs = request(Some(Kind::Pairs), None).order();
        assert!(mixed.cases.len() > 1 && pairs.cases.len() == 1, "{} kinds", mixed.cases.len());
        assert!(pairs.count() > 0 && pairs.count() < mixed.count());
    }
}
