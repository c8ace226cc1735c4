//! The whole pipeline on the "real" device: Figs. 4.5 and 4.6 of the thesis.
//!
//! Problem: how noise in training and the map's resolution decide what a transfer network and a reconstruction network are worth together,
//! and whether they serve patterns that nothing was learned from better than a network that learned from the device alone. Method: maps 1, 6,
//! 11 and 12, each with inputs that have 0, 10 and 50 % of what the transfer network leaves of each channel; `dermis bundle join` makes one bundle
//! of both, and `dermis evaluate` reads contacts off its maps, on hexagonal patterns at other locations and on random ones. End to end is the same
//! network, learned from the device's readings. Physics is the inversion of the forward model, on the random patterns. The analysis of
//! variance is that of [`variance`](super::variance). Cost: sixteen reconstruction networks.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result};
use serde_json::{Map, Value, json};
use toml::{Table, Value as Toml};

use super::figures::{ERRORS, read};
use super::networks::{MAPS, THESIS, configuration};
use super::variance::{Cell, effects};
use super::{LIGHTEST, SKIN, TRANSFER, Work, evaluation, read_toml};
use crate::measure::at_once;
use crate::run::run as execute;

/// The plan of patterns that nothing is learned from.
pub(super) const UNSEEN: &str = "random";
/// Maps of Fig. 4.5, and their levels of pixel and diameter.
const LEVELS: [(usize, [usize; 2]); 4] = [(1, [0, 0]), (6, [0, 1]), (11, [1, 0]), (12, [1, 1])];
/// Shares of what the transfer network leaves of each channel that inputs get as noise.
const NOISES: [f64; 3] = [0.0, 0.1, 0.5];

/// What everything is learned from and measured on.
struct Bags {
    transfer: PathBuf,
    simulated: Vec<PathBuf>,
    real: Vec<PathBuf>,
    seen: PathBuf,
    unseen: PathBuf,
}

/// One network: its map, and what is added to its inputs; end to end without a transfer network where that is absent.
#[derive(Clone, Copy)]
struct Way {
    map: usize,
    noise: Option<f64>,
}

impl Work<'_> {
    /// Rows of both figures.
    pub(super) fn pipeline(&self) -> Result<Value> {
        let bags = self.pipeline_bags()?;
        let thesis = read_toml(&self.root.join(THESIS))?;
        let maps = LEVELS.map(|(map, _)| map).into_iter().filter(|map| {
            let chosen = &self.sizes.maps;
            chosen.is_empty() || chosen.contains(map)
        });
        let noises = NOISES.map(Some).into_iter().chain([None]);
        let ways: Vec<Way> =
            maps.flat_map(|map| noises.clone().map(move |noise| Way { map, noise })).collect();
        let mut rows = at_once(self.sizes.jobs, &ways, |way| {
            let name = match way.noise {
                Some(noise) => format!("pipeline-{}-noise-{:.0}", way.map, noise * 100.0),
                None => format!("pipeline-{}-end-to-end", way.map),
            };
            self.row(&name, || self.measured(&name, *way, &thesis, &bags))
        })?;
        rows.push(self.row("pipeline-physics", || {
            let found = self.evaluated(&["--invert".as_ref()], &bags.unseen, "pipeline-physics")?;
            Ok(json!({ "way": "physics", "unseen_figures": found["figures"] }))
        })?);
        Ok(Value::Array(rows))
    }

    /// Collects the bags, and trains the transfer network on all numbers of contacts, or takes that of Table 4.3.
    fn pipeline_bags(&self) -> Result<Bags> {
        let of = |plan| (1..=6).map(move |n| (plan, Some(n)));
        let parts = self.bags(&of("hex-train").chain(of("hex-evaluate")).collect::<Vec<_>>(), true)?;
        let (real, tests) = parts.split_at(6);
        let whole = self.bags(&[("hex-evaluate", None), (UNSEEN, None)], true)?;
        let simulated = self.bags(&[("random-train", None), ("hex-train", None)], false)?;
        let config = read_toml(&self.root.join(TRANSFER))?;
        let name = "transfer-up-to-6";
        self.row(name, || self.transferred(name, &config, real, tests))?;
        let [seen, unseen] = <[PathBuf; 2]>::try_from(whole).expect("a bag for each plan");
        Ok(Bags { transfer: self.dir.join(name), simulated, real: real.to_vec(), seen, unseen })
    }

    /// Trains one network, joins it, and measures it on both kinds of patterns.
    fn measured(&self, name: &str, way: Way, thesis: &Table, bags: &Bags) -> Result<Value> {
        let [pixel, diameter] = MAPS[way.map - 1];
        let mut config = configuration(thesis, MAPS[way.map - 1])?;
        if let Some(share) = way.noise.filter(|share| *share > 0.0) {
            with_noise(&mut config, &bags.transfer, share)?;
        }
        let trains = if way.noise.is_some() { &bags.simulated } else { &bags.real };
        let trained = self.train(name, &config, trains, &[])?;
        let mut bundle = self.dir.join(name);
        if way.noise.is_some() {
            let joined = self.dir.join(format!("{name}-joined"));
            let mut join = Command::new(&self.dermis);
            join.args(["bundle", "join", "--skin", SKIN, "--json", "--transfer"]).arg(&bags.transfer);
            join.arg("--reconstruction").arg(&bundle).arg("--out").arg(&joined);
            execute(join.current_dir(self.root))?;
            bundle = joined;
        }
        let on = |bag: &Path, of: &str| {
            let model = ["--model".as_ref(), bundle.as_os_str()];
            let found = self.evaluated(&model, bag, &format!("{name}-{of}"))?;
            anyhow::Ok(found["maps"]["map.normal"]["contacts"].clone())
        };
        Ok(json!({
            "way": if way.noise.is_some() { "hybrid" } else { "end to end" },
            "map": way.map,
            "pixel_mm": pixel,
            "diameter_mm": diameter,
            "noise": way.noise.unwrap_or(0.0),
            "samples": trained["samples"],
            "seconds": trained["seconds"],
            "seen": on(&bags.seen, "seen")?,
            "unseen": on(&bags.unseen, "unseen")?,
        }))
    }

    /// What `dermis evaluate` says of a bag; its page with examples of maps lies beside the networks.
    fn evaluated(&self, with: &[&std::ffi::OsStr], bag: &Path, page: &str) -> Result<Value> {
        let mut evaluate = Command::new(&self.dermis);
        evaluate.arg("evaluate").args(["--skin", SKIN, "--map-least-force", LIGHTEST, "--json", "--report"]);
        evaluate.arg(self.dir.join(format!("{page}.html"))).args(with).arg(bag);
        evaluation(evaluate.current_dir(self.root))
    }
}

/// Gives a network's inputs noise in training.
fn with_noise(config: &mut Table, transfer: &Path, share: f64) -> Result<()> {
    let training = config.get_mut("training").and_then(Toml::as_table_mut);
    let training = training.with_context(|| format!("{THESIS}: field `training` is missing"))?;
    let bundle = transfer.to_str().with_context(|| format!("{} is no text", transfer.display()))?;
    let noise = [("bundle".to_owned(), Toml::from(bundle)), ("share".to_owned(), Toml::Float(share))];
    training.insert("channel_noise".into(), Toml::Table(noise.into_iter().collect()));
    Ok(())
}

/// Analysis of variance of each error of the hybrid way on seen patterns; of an error with a missing combination, `null`.
pub(super) fn variances(rows: &Value) -> Value {
    let rows = rows.as_array().map_or(&[][..], Vec::as_slice);
    let mut all = Map::new();
    for (name, _, _) in ERRORS {
        let cell = |row: &Value| {
            let (_, [pixel, diameter]) = LEVELS.into_iter().find(|(map, _)| row["map"] == *map)?;
            let noise = NOISES.into_iter().position(|noise| row["noise"].as_f64() == Some(noise))?;
            let contacts = read(&row["seen"])?;
            let samples = match name {
                "number" => &contacts["frames"],
                "position_nearest" => &contacts["contacts"],
                _ => &contacts["found"],
            };
            Some(Cell {
                levels: [pixel, diameter, noise],
                mean: contacts[name]["mean"].as_f64()?,
                deviation: contacts[name]["deviation"].as_f64()?,
                samples: samples.as_f64()?,
            })
        };
        let cells: Vec<Cell> = rows.iter().filter(|row| row["way"] == "hybrid").filter_map(cell).collect();
        let found = effects(["pixel", "diameter", "noise"], [2, 2, NOISES.len()], &cells);
        all.insert(name.to_owned(), found.unwrap_or(Value::Null));
    }
    Value::Object(all)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_of_the_transfer_network_is_a_table_of_the_training() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
        let mut config = read_toml(&root.join(THESIS)).unwrap();
        with_noise(&mut config, Path::new("/somewhere/transfer"), 0.1).unwrap();
        let text = toml::to_string(&config).unwrap();
        let read: Table = text.parse().unwrap();
        let noise = &read["training"]["channel_noise"];
        assert_eq!(
            (noise["bundle"].as_str(), noise["share"].as_float()),
            (Some("/somewhere/transfer"), Some(0.1))
        );
        assert!(with_noise(&mut Table::new(), Path::new("x"), 0.1).is_err());
    }

    #[test]
    fn the_maps_have_two_pixels_and_two_diameters() {
        for (map, [pixel, diameter]) in LEVELS {
            assert_eq!(MAPS[map - 1], [[4, 20][pixel], [20, 60][diameter]]);
        }
    }

    #[test]
    fn variances_need_every_combination() {
        let spread = |mean: f64| json!({ "mean": mean, "deviation": 0.2 });
        let mut rows = Vec::new();
        for (map, [pixel, _]) in LEVELS {
            for noise in NOISES {
                let all = json!({ "frames": 50, "contacts": 100, "found": 80, "number": spread(pixel as f64),
                                  "position_nearest": spread(0.01), "force": spread(0.0), "diameter": spread(noise) });
                rows.push(json!({ "way": "hybrid", "map": map, "noise": noise,
                                  "seen": [{ "threshold": 5.0, "all": all }] }));
            }
        }
        rows.push(json!({ "way": "end to end", "map": 1, "noise": 0.0, "seen": [] }));
        let all = variances(&Value::Array(rows.clone()));
        let p = |error: &str, effect: &str| all[error][effect]["p"].as_f64().unwrap();
        assert!(p("number", "pixel") < 1e-4 && p("number", "noise") > 0.99, "{all}");
        assert!(p("diameter", "noise") < 1e-4 && p("force", "pixel x diameter") > 0.99, "{all}");
        // Of contacts that were found.
        assert_eq!(all["force"]["noise"]["freedom"][1], 12.0 * 79.0);
        rows.remove(0);
        assert_eq!(variances(&Value::Array(rows))["number"], Value::Null);
    }
}
