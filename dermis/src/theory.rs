//! `dermis theory`: how well a skin can know a contact at best, from its forward model or from a recording.

mod page;
mod sources;
mod text;
mod trends;

use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use clap::Args;
use dermis_learn::cli::Labels;
use dermis_model::{ForwardModel, Indentation, Stimulus, Unknowns};
use dermis_skin::{SkinDescription, Surface};
use dermis_theory::resolution::{Testbed, on_surface};
use dermis_theory::{
    Isoline, Line, LineStudy, Responses, StudyOptions, Summary, SurfaceBound, TwoContacts, force_ladder,
    longest_row, over_surface, strongest_bands, two_contacts,
};
use indicatif::{ProgressBar, ProgressStyle};
use nalgebra::Point3;
use serde::Serialize;
use serde_json::json;

pub use page::flat;
use sources::Source;

/// \[mm\] distances of two contacts that are bounded.
const DISTANCES: std::ops::RangeInclusive<u32> = 1..=40;
/// \[N\] range of forces that isolines and factors are computed for, and their step (thesis 5.7.1).
const FORCES: [f64; 2] = [0.02, 1.5];
const FORCE_STEP: f64 = 0.01;
/// Forces of the maps over place and force.
const MAP_FORCES: u32 = 28;
/// Isolines of a taxel.
const VALUES: i32 = 12;
/// \[N\] edges of the intervals in which σ_P is summarised: those of the thesis' Table 5.2.
const INTERVALS: [f64; 8] = [0.02, 0.14, 0.2, 0.4, 0.6, 0.9, 1.2, 1.5];

/// What to bound.
#[derive(Args)]
pub struct Options {
    /// Skin description.
    skin: PathBuf,
    /// Pressing force [N]; may be repeated.
    #[arg(long, default_values_t = [0.05, 0.1, 0.2, 0.5, 1.0])]
    force: Vec<f64>,
    /// Diameter of the tip [m].
    #[arg(long, default_value_t = 0.004)]
    diameter: f64,
    /// Shear is unknown, too; otherwise the contact is known to press along the normal.
    #[arg(long, conflicts_with = "line")]
    shear: bool,
    /// Only x is unknown of the place: for taxels in a row.
    #[arg(long)]
    line: bool,
    /// Labelled bag to take the isolines and the noise from, in place of the model; may be repeated.
    #[arg(long)]
    bag: Vec<PathBuf>,
    #[command(flatten)]
    labels: Labels,
    /// Smallest reading that counts, in the unit of the skin; the node's threshold of a contact where absent.
    #[arg(long)]
    least: Option<f64>,
    /// Folder for `theory.html` and `theory.json`.
    #[arg(short, long)]
    out: Option<PathBuf>,
    /// One JSON object in place of the text.
    #[arg(long)]
    json: bool,
}

/// What isolines say of a whole surface.
#[derive(Serialize)]
struct SurfaceStudy {
    /// F_S \[N\] at every point: from here on three taxels read S_min.
    minimum_force: Vec<Option<f64>>,
    minimum_force_summary: Summary,
    /// Isoline of a value of the channel nearest to the middle.
    channel: usize,
    isoline: Isoline,
    /// By force.
    factors: Vec<SurfaceFactor>,
}

/// Super-resolution under one force, over the part of the surface that lies between the outermost taxels.
#[derive(Serialize)]
struct SurfaceFactor {
    force: f64,
    /// \[m\] along both directions: root mean square of the bound.
    bound: [f64; 2],
    /// \[m\] median of the bound, and of the box around the bands of the three taxels that read most: where they run
    /// parallel there is no box, so that these have no mean.
    bound_median: [f64; 2],
    bands_median: [f64; 2],
    /// Ω (5.24) of each; the first also with the testbed's precision.
    factor: f64,
    factor_with_testbed: f64,
    bound_median_factor: f64,
    bands_median_factor: f64,
}

/// Everything that was found.
struct Findings {
    skin: SkinDescription,
    model: Option<std::sync::Arc<dyn ForwardModel>>,
    source: Source,
    least: f64,
    unknowns: Unknowns,
    maps: Vec<SurfaceBound>,
    pairs: Vec<TwoContacts>,
    line: Option<LineStudy>,
    /// Shares of pairs on the line that the isolines tell apart, at each of the distances of `pairs`.
    told_apart: Vec<f64>,
    surface: Option<SurfaceStudy>,
    trends: Vec<trends::Trend>,
    notes: Vec<String>,
}

/// Bounds one contact all over the skin and two contacts across its middle, and studies its isolines.
pub fn run(options: &Options) -> Result<()> {
    let findings = find(options)?;
    let summary = text::summary(&findings, options);
    let text = text::text(&findings, options);
    if let Some(folder) = &options.out {
        std::fs::create_dir_all(folder)
            .with_context(|| format!("folder {} cannot be made", folder.display()))?;
        let save = |name: &str, text: String| {
            let path = folder.join(name);
            std::fs::write(&path, text).with_context(|| format!("{} cannot be written", path.display()))
        };
        let full = json!({
            "summary": summary,
            "points": findings.skin.surface().points,
            "maps": findings.maps,
            "line": findings.line,
            "surface": findings.surface,
            "trends": findings.trends,
        });
        let html = page::html(&findings, &text)?;
        save("theory.json", serde_json::to_string(&full)? + "\n")?;
        save("theory.html", html)?;
    }
    if options.json {
        println!("{summary}");
    } else {
        print!("{text}");
    }
    Ok(())
}

fn find(options: &Options) -> Result<Findings> {
    let skin = SkinDescription::load(&options.skin)?;
    let model = crate::registry::forward(&options.skin, &skin);
    let (model, mut notes) = match (model, options.bag.is_empty()) {
        (Ok(model), _) => (Some(model), Vec::new()),
        (Err(error), true) => return Err(error),
        (Err(error), false) => {
            (None, vec![format!("there is no forward model, hence no bound of the surface: {error}")])
        }
    };
    let Some(&middle) = options.force.get(options.force.len() / 2) else { bail!("no force is given") };
    let source = Source::new(options, &skin, model.as_ref())?;
    let noise = source.noise().iter().copied().fold(0.0, f64::max);
    let least = options.least.unwrap_or(skin.condition.contact_threshold * noise);
    if !(least.is_finite() && least > 0.0) {
        bail!("option `--least` is {least} {} and must be positive", skin.unit);
    }
    let unknowns = match (options.line, options.shear) {
        (true, _) => Unknowns::Line,
        (false, true) => Unknowns::Full,
        (false, false) => Unknowns::Normal,
    };
    let progress = ProgressBar::new(1000)
        .with_style(ProgressStyle::with_template("{msg} {wide_bar} {percent} %, {eta} left")?);
    progress.set_message(skin.name.clone());
    let surface = skin.surface();
    let (mut maps, mut pairs) = (Vec::new(), Vec::new());
    if let Some(model) = &model {
        for (i, &force) in options.force.iter().enumerate() {
            maps.push(over_surface(model.as_ref(), force, options.diameter, unknowns)?);
            progress.set_position(300 * (i as u64 + 1) / options.force.len() as u64);
        }
        pairs = pairs_of(model.as_ref(), middle, options.diameter, unknowns)?;
    }
    let feet = feet(&skin, &surface);
    let mut told_apart = Vec::new();
    let line = match line(&source, &surface, &feet, options.diameter) {
        Ok(line) => {
            let study = line.study(&study_options(&line, least), |share| {
                progress.set_position(300 + (400.0 * share) as u64);
            });
            let distances: Vec<f64> = pairs.iter().map(|p| p.distance).collect();
            told_apart = line.told_apart_by_distance(middle, least, &distances);
            Some(study)
        }
        Err(error) => {
            notes.push(format!("there is no line of taxels to study: {error}"));
            None
        }
    };
    let on_surface = if options.line {
        None
    } else {
        Some(surface_study(&source, model.as_deref(), &surface, &feet, least, options, &maps)?)
    };
    progress.set_position(800);
    // A recording is of the skin as it is, and only the page shows how others would be.
    let trends = match &model {
        Some(model) if options.bag.is_empty() && options.out.is_some() => {
            trends::trends(&skin, model, &feet, options.diameter)?
        }
        _ => Vec::new(),
    };
    progress.finish_and_clear();
    Ok(Findings {
        skin,
        model,
        source,
        least,
        unknowns,
        maps,
        pairs,
        line,
        told_apart,
        surface: on_surface,
        trends,
        notes,
    })
}

/// Points of the surface above each channel's taxel.
fn feet(skin: &SkinDescription, surface: &Surface) -> Vec<Point3<f64>> {
    skin.channel_taxels().into_iter().map(|t| surface.project(&skin.taxels[t].point()).0).collect()
}

/// The row that most taxels lie on.
fn line(source: &Source, surface: &Surface, feet: &[Point3<f64>], diameter: f64) -> Result<Line> {
    let (_, tolerance) = longest_row(surface, feet, 1e-3)?;
    let (path, tolerance) = longest_row(surface, feet, tolerance * source.fineness())?;
    let forces = force_ladder(source.force_max(), 40);
    let responses = source.responses(surface, &path.points, &forces, diameter, tolerance)?;
    Ok(Line::new(responses, &path, surface, feet, tolerance)?)
}

/// What the thesis looks at, as far as the skin reaches.
fn study_options(line: &Line, least: f64) -> StudyOptions {
    let most = line.responses().forces().last().map_or(FORCES[1], |f| f.min(FORCES[1]));
    let steps = ((most - FORCES[0]) / FORCE_STEP).round().max(1.0) as u32;
    let forces = (0..=steps).map(|i| FORCES[0] + f64::from(i) * FORCE_STEP).collect();
    let ratio = (most / FORCES[0]).ln() / f64::from(MAP_FORCES - 1);
    let map_forces = (0..MAP_FORCES).map(|i| FORCES[0] * (f64::from(i) * ratio).exp()).collect();
    // From the smallest reading to what the weakest taxel reads under the largest force straight above it.
    let above =
        line.taxels().iter().map(|t| line.responses().reading(line.place(t.foot), t.channel, most * 0.999));
    let largest = above.filter(|v| v.is_finite()).fold(f64::INFINITY, f64::min).max(2.0 * least);
    let largest = if largest.is_finite() { largest } else { 10.0 * least };
    let values =
        (0..VALUES).map(|i| least * (largest / least).powf(f64::from(i) / f64::from(VALUES - 1))).collect();
    let pitch = line.span() / (line.taxels().len() - 1).max(1) as f64;
    StudyOptions { least, values, forces, map_forces, step: pitch / 13.0, testbed: Testbed::THESIS }
}

fn surface_study(
    source: &Source,
    model: Option<&dyn ForwardModel>,
    surface: &Surface,
    feet: &[Point3<f64>],
    least: f64,
    options: &Options,
    maps: &[SurfaceBound],
) -> Result<SurfaceStudy> {
    let forces = force_ladder(source.force_max(), 30);
    let spacing = (surface.areas.iter().sum::<f64>() / surface.points.len() as f64).sqrt();
    let responses: Responses =
        source.responses(surface, &surface.points, &forces, options.diameter, 1.5 * spacing)?;
    let minimum_force: Vec<Option<f64>> =
        (0..surface.points.len()).map(|p| responses.minimum_force(p, least, 3)).collect();
    let known = minimum_force.iter().map(|f| f.unwrap_or(f64::INFINITY));
    let middle = middle_of(surface);
    let near = |c: &usize| (feet[*c] - middle).norm();
    let channel = (0..feet.len()).min_by(|a, b| near(a).total_cmp(&near(b))).unwrap_or_default();
    let distances: Vec<f64> = surface.points.iter().map(|p| surface.geodesic(p, &feet[channel])).collect();
    let value = responses.reading(responses.peak(channel), channel, 0.1);
    let value = if value.is_finite() { value } else { least };
    let isoline = Isoline::of(&responses, &distances, channel, value);
    let inside = between(surface, feet);
    let areas: Vec<f64> = inside.iter().map(|i| surface.areas[*i]).collect();
    let area: f64 = areas.iter().sum();
    let mut factors = Vec::new();
    for map in maps {
        let Some(model) = model else { break };
        let boxes = inside
            .iter()
            .map(|i| {
                let force = -surface.normals[*i] * map.force;
                let contact = Indentation::sphere(surface.points[*i], force, map.diameter);
                let stimulus = Stimulus { contacts: vec![contact], ..Stimulus::default() };
                Ok(strongest_bands(model, &stimulus, Unknowns::Normal)?.along)
            })
            .collect::<Result<Vec<[f64; 2]>>>()?;
        let bound = [0, 1].map(|k| Summary::of(inside.iter().map(|i| map.bounds[*i].along[k]), &areas));
        let bands_median = [0, 1].map(|k| Summary::of(boxes.iter().map(|b| b[k]), &areas).median);
        let factor = |sigma| on_surface(area, feet.len(), sigma);
        let (rms, bound_median) = (bound.map(|b| b.rms), bound.map(|b| b.median));
        factors.push(SurfaceFactor {
            force: map.force,
            bound: rms,
            bound_median,
            bands_median,
            factor: factor(rms),
            factor_with_testbed: factor(rms.map(|s| Testbed::THESIS.position(s))),
            bound_median_factor: factor(bound_median),
            bands_median_factor: factor(bands_median),
        });
    }
    Ok(SurfaceStudy {
        minimum_force_summary: Summary::of(known, &surface.areas),
        minimum_force,
        channel,
        isoline,
        factors,
    })
}

/// Points of a flat surface within the rectangle around its taxels; all points of another one.
fn between(surface: &Surface, feet: &[Point3<f64>]) -> Vec<usize> {
    let level = surface.normals.iter().all(|n| n.z > 0.999);
    let span = |of: fn(&Point3<f64>) -> f64| {
        let ends =
            feet.iter().map(of).fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        move |p: &Point3<f64>| (ends.0 - 1e-9..=ends.1 + 1e-9).contains(&of(p))
    };
    let (x, y) = (span(|p| p.x), span(|p| p.y));
    let inside: Vec<usize> = (0..surface.points.len())
        .filter(|i| level && x(&surface.points[*i]) && y(&surface.points[*i]))
        .collect();
    if inside.is_empty() { (0..surface.points.len()).collect() } else { inside }
}

fn middle_of(surface: &Surface) -> Point3<f64> {
    let count = surface.points.len().max(1) as f64;
    Point3::from(surface.points.iter().map(|p| p.coords).sum::<nalgebra::Vector3<f64>>() / count)
}

/// Two contacts of one force, as far apart as the surface allows.
fn pairs_of(
    model: &dyn ForwardModel,
    force: f64,
    diameter: f64,
    unknowns: Unknowns,
) -> Result<Vec<TwoContacts>> {
    let middle = middle_of(model.surface());
    let width = model.surface().points.iter().map(|p| (p.x - middle.x).abs()).fold(0.0, f64::max) * 2.0;
    let distances: Vec<f64> = DISTANCES.map(|mm| f64::from(mm) * 1e-3).filter(|d| *d < width).collect();
    Ok(two_contacts(model, &middle, &distances, force, diameter, unknowns)?)
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    fn options(skin: &str, line: bool) -> Options {
        Options {
            skin: Path::new(env!("CARGO_MANIFEST_DIR")).join("../launch/skins").join(skin),
            force: vec![0.2, 1.0],
            diameter: 0.004,
            shear: false,
            line,
            bag: Vec::new(),
            labels: Labels::default(),
            least: None,
            out: None,
            json: false,
        }
    }

    #[test]
    fn the_grid_is_bounded_and_drawn() {
        let folder = tempfile::tempdir().unwrap();
        let mut options = options("baro-grid.toml", false);
        // A pad that goes on beyond its surface is solved in closed form, one that ends by finite elements.
        let text =
            std::fs::read_to_string(&options.skin).unwrap().replace("edge = \"free\"", "edge = \"wide\"");
        options.skin = folder.path().join("wide.toml");
        std::fs::write(&options.skin, text).unwrap();
        options.out = Some(folder.path().to_owned());
        run(&options).unwrap();
        let html = std::fs::read_to_string(folder.path().join("theory.html")).unwrap();
        let json = std::fs::read_to_string(folder.path().join("theory.json")).unwrap();
        let value: serde_json::Value = serde_json::from_str(&json).unwrap();
        assert!(html.matches("<svg").count() >= 15 && !html.contains("NaN"));
        assert_eq!(
            value["maps"][0]["bounds"].as_array().unwrap().len(),
            value["points"].as_array().unwrap().len()
        );
        let at = |i: usize| value["summary"]["one_contact"][i]["position_m"]["median"].as_f64().unwrap();
        // Five times the force, on a skin that is nearly linear in it; a bound of micrometres would be a mistake.
        let inside = &value["surface"]["factors"];
        assert!(inside[1]["factor"].as_f64().unwrap() > inside[0]["factor"].as_f64().unwrap());
        assert_eq!(value["line"]["taxels"].as_array().unwrap().len(), 5);
        assert!(at(0) > 2.0 * at(1) && at(1) > 1e-6 && at(0) < 1e-3, "{} {}", at(0), at(1));
    }

    /// RMS over the row and over the forces of each interval of the thesis' Table 5.2 \[mm\], against what a prototype with
    /// the same medium and noise gave.
    #[test]
    fn the_row_is_bounded_as_a_prototype_found() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../launch/skins/baro-line.toml");
        let skin = SkinDescription::load(path).unwrap();
        let model = (crate::registry::family(&skin).unwrap().model)(&skin).unwrap();
        let edges = [0.02, 0.14, 0.2, 0.4, 0.6, 0.9, 1.2, 1.5];
        let expected = [0.45, 0.119, 0.072, 0.041, 0.027, 0.019, 0.015];
        for (interval, expected) in edges.windows(2).zip(expected) {
            let forces: Vec<f64> = (0..8)
                .map(|i| interval[0] + (interval[1] - interval[0]) * (f64::from(i) + 0.5) / 8.0)
                .collect();
            let squares = forces.iter().map(|f| {
                over_surface(model.as_ref(), *f, 0.004, Unknowns::Line).unwrap().position.rms.powi(2)
            });
            let rms = (squares.sum::<f64>() / forces.len() as f64).sqrt() * 1e3;
            assert!((rms / expected - 1.0).abs() < 0.35, "{interval:?} N: {rms:.4} mm, not {expected}");
        }
    }

    #[test]
    fn the_row_is_told_in_one_screen() {
        let options = options("baro-line.toml", true);
        let findings = find(&options).unwrap();
        insta::assert_snapshot!(text::text(&findings, &options), @r#"
baro-line: least error of one contact from one frame (Cramér–Rao), tip of 4 mm, over the surface

force [N] |  pos. RMS   median     95 %    worst |     F RMS   median     95 %    worst
      0.2 |     0.101    0.092    0.138    0.198 |    0.0032   0.0033   0.0034   0.0034
        1 |     0.021    0.019    0.028    0.040 |    0.0033   0.0034   0.0034   0.0034

positions in mm, forces in N; `-`: the channels do not tell it
two contacts of 1 N across the middle can be told apart from 3 mm on (to 0.272 mm each)

isolines from the forward model; σ_S 20.0 Pa as the skin description says; S_min 80 Pa
row of 6 taxels, 32.500 mm: c(0) = 0.156 N/kPa, linear within 1 %; F_S from 0.0186 to 0.0468 N
  I(d) = g + λ|d|^α, median α: 2.3 at 80 Pa, at most 3.7 at 295 Pa, 2.1 at 9534 Pa
  σ_P [mm], RMS, by force [N]       0.02-0.14 0.14-0.2  0.2-0.4  0.4-0.6  0.6-0.9  0.9-1.2  1.2-1.5
  fitted isolines of two (5.18)         0.547    0.267    0.138    0.070    0.044    0.031    0.025
  exact corners of two (5.7-5.10)       0.493    0.175    0.103    0.060    0.040    0.029    0.022
  Cramér–Rao bound of all               0.436    0.125    0.073    0.042    0.028    0.020    0.016
  Ω (5.20), mean over force: 71 by fits, 72 by corners, 102 by the bound; with the testbed (5.21): 56, 58, 75
"#);
    }

    #[test]
    fn a_recording_says_what_the_model_does() {
        let folder = tempfile::tempdir().unwrap();
        let mut options = options("baro-line.toml", true);
        let skin = SkinDescription::load(&options.skin).unwrap();
        let model = (crate::registry::family(&skin).unwrap().model)(&skin).unwrap();
        let plan = dermis_testbed::Plan::from_toml(
            r#"
            schema = "dermis-plan/1"
            name = "row"
            diameter = 0.004
            seed = 3
            [timing]
            approach = [0.01, 0.01]
            load = [0.2, 0.2]
            hold = [0.05, 0.05]
            unload = [0.2, 0.2]
            gap = [0.05, 0.05]
            [[steps]]
            kind = "idle"
            duration = 5.0
            [[steps]]
            kind = "presses"
            count = 400
            force = [1.2, 1.5]
            "#,
            "row.toml",
        )
        .unwrap();
        let bag = folder.path().join("bag");
        dermis_testbed::collect(&model, &skin, &plan, &bag, &dermis_testbed::CollectOptions::default())
            .unwrap();
        let by_model = find(&options).unwrap();
        options.bag = vec![bag];
        let by_bag = find(&options).unwrap();
        let noise = by_bag.source.noise();
        assert!(noise.iter().all(|n| (n / 20.0 - 1.0).abs() < 0.15), "{noise:?}");
        let (exact, found) = (by_model.line.unwrap(), by_bag.line.unwrap());
        let c = |line: &LineStudy| text::median(line, |t| Some(t.c));
        assert!((c(&found) / c(&exact) - 1.0).abs() < 0.05, "{} {}", c(&found), c(&exact));
        let corners = |line: &LineStudy| text::by_interval(line, |f| f.corners);
        // Light presses are few, and the hardest ones saturate the taxel below them.
        for (interval, (exact, found)) in
            corners(&exact).iter().zip(corners(&found)).enumerate().skip(2).take(4)
        {
            let (exact, found) = (exact.unwrap(), found.unwrap());
            assert!((found / exact - 1.0).abs() < 0.3, "interval {interval}: {found} m, not {exact}");
        }
        let text = text::text(&Findings { line: None, ..by_bag }, &options);
        assert!(text.contains("recorded frames, tip of 4 mm; σ_S"), "{text}");
        // Another skin's bag is refused.
        options.skin = Path::new(env!("CARGO_MANIFEST_DIR")).join("../launch/skins/baro-grid.toml");
        let refusal = find(&options).err().unwrap().to_string();
        assert!(refusal.contains("bag"), "{refusal}");
    }

    #[test]
    fn what_cannot_be_is_refused() {
        let refused = |options: &Options| find(options).err().unwrap().to_string();
        let row = options("baro-line.toml", true);
        insta::assert_snapshot!(refused(&Options { least: Some(-1.0), ..row }), @"option `--least` is -1 Pa and must be positive");
        let row = options("baro-line.toml", true);
        insta::assert_snapshot!(refused(&Options { force: vec![], ..row }), @"no force is given");
    }
}
