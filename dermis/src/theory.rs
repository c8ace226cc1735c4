//! `dermis theory`: how well a skin can know a contact at best, from its forward model alone.

use std::fmt::Write as _;
use std::path::PathBuf;

use anyhow::{Context, Result, anyhow, bail};
use clap::Args;
use dermis_skin::{ForwardModel, SkinDescription};
use dermis_theory::{SurfaceBound, TwoContacts, Unknowns, over_surface, two_contacts};
use nalgebra::Point3;
use serde_json::json;

/// \[m\] distances of two contacts that are bounded.
const DISTANCES: std::ops::RangeInclusive<u32> = 1..=40;

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
    /// Folder for `bound.html` and `bound.json`.
    #[arg(short, long)]
    out: Option<PathBuf>,
    /// One JSON object in place of the table.
    #[arg(long)]
    json: bool,
}

/// Bounds one contact all over the skin, and two contacts across its middle.
pub fn run(options: &Options) -> Result<()> {
    let skin = SkinDescription::load(&options.skin)?;
    let model = (crate::registry::family(&skin)?.model)(&skin)?;
    let unknowns = match (options.line, options.shear) {
        (true, _) => Unknowns::Line,
        (false, true) => Unknowns::Full,
        (false, false) => Unknowns::Normal,
    };
    let maps = options
        .force
        .iter()
        .map(|&force| Ok(over_surface(model.as_ref(), force, options.diameter, unknowns)?))
        .collect::<Result<Vec<_>>>()?;
    let pairs = pairs(model.as_ref(), options, unknowns)?;
    let summary = json!({
        "skin": skin.name,
        "channels": model.channels(),
        "diameter_m": options.diameter,
        "unknowns": unknowns,
        "one_contact": maps.iter().map(|m| json!({
            "force_n": m.force, "position_m": m.position, "normal_force_n": m.normal_force,
        })).collect::<Vec<_>>(),
        "two_contacts": pairs,
    });
    let text = table(&skin, options, &maps, &pairs);
    if let Some(folder) = &options.out {
        std::fs::create_dir_all(folder)
            .with_context(|| format!("folder {} cannot be made", folder.display()))?;
        let save = |name: &str, text: String| {
            let path = folder.join(name);
            std::fs::write(&path, text).with_context(|| format!("{} cannot be written", path.display()))
        };
        let full = json!({ "summary": summary, "points": model.surface().points, "maps": maps });
        save("bound.json", serde_json::to_string(&full)? + "\n")?;
        save("bound.html", html(&skin, &text, model.as_ref(), &maps, &pairs)?)?;
    }
    if options.json {
        println!("{summary}");
    } else {
        print!("{text}");
    }
    Ok(())
}

/// Two contacts of the middle one of the forces, as far apart as the surface allows.
fn pairs(model: &dyn ForwardModel, options: &Options, unknowns: Unknowns) -> Result<Vec<TwoContacts>> {
    let Some(&force) = options.force.get(options.force.len() / 2) else { bail!("no force is given") };
    let points = &model.surface().points;
    let count = points.len().max(1) as f64;
    let middle = Point3::from(points.iter().map(|p| p.coords).sum::<nalgebra::Vector3<f64>>() / count);
    let width = points.iter().map(|p| (p.x - middle.x).abs()).fold(0.0, f64::max) * 2.0;
    let distances: Vec<f64> = DISTANCES.map(|mm| f64::from(mm) * 1e-3).filter(|d| *d < width).collect();
    Ok(two_contacts(model, &middle, &distances, force, options.diameter, unknowns)?)
}

/// Millimetres, as few digits as say something.
fn mm(metres: f64) -> String {
    if metres.is_finite() { format!("{:.3}", metres * 1e3) } else { "-".into() }
}

fn newtons(value: f64) -> String {
    if value.is_finite() { format!("{value:.4}") } else { "-".into() }
}

fn table(skin: &SkinDescription, options: &Options, maps: &[SurfaceBound], pairs: &[TwoContacts]) -> String {
    let mut out = format!(
        "{}: least error of one contact from one frame (Cramér–Rao), tip of {} mm, over the surface\n\n",
        skin.name,
        options.diameter * 1e3
    );
    let _ = writeln!(
        out,
        "{:>9} | {:>9}{:>9}{:>9}{:>9} | {:>9}{:>9}{:>9}{:>9}",
        "force [N]", "pos. RMS", "median", "95 %", "worst", "F RMS", "median", "95 %", "worst"
    );
    for map in maps {
        let (p, f) = (map.position, map.normal_force);
        let _ = writeln!(
            out,
            "{:>9} | {:>9}{:>9}{:>9}{:>9} | {:>9}{:>9}{:>9}{:>9}",
            map.force,
            mm(p.rms),
            mm(p.median),
            mm(p.p95),
            mm(p.max),
            newtons(f.rms),
            newtons(f.median),
            newtons(f.p95),
            newtons(f.max)
        );
    }
    out.push_str("\npositions in mm, forces in N; `-`: the channels do not tell it\n");
    let force = options.force.get(options.force.len() / 2).copied().unwrap_or(f64::NAN);
    // From where on all wider ones can be told apart.
    let from = pairs.iter().rev().take_while(|p| p.resolved).last();
    match from {
        Some(pair) => {
            let _ = writeln!(
                out,
                "two contacts of {force} N across the middle can be told apart from {} mm on (to {} mm each)",
                pair.distance * 1e3,
                mm(pair.position)
            );
        }
        None => {
            let _ = writeln!(out, "two contacts of {force} N across the middle cannot be told apart");
        }
    }
    out
}

fn html(
    skin: &SkinDescription,
    table: &str,
    model: &dyn ForwardModel,
    maps: &[SurfaceBound],
    pairs: &[TwoContacts],
) -> Result<String> {
    let mut body = String::new();
    for map in maps {
        let _ = write!(body, "<h2>{} N</h2>\n{}", map.force, heat_map(model, map)?);
    }
    let _ = write!(body, "<h2>Two contacts</h2>\n{}", curve(pairs)?);
    Ok(format!(
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>{name}</title>\n\
         <style>body{{font:15px/1.5 system-ui,sans-serif;max-width:62rem;margin:2rem auto;padding:0 1rem;color:#222;\
         background:#fff}}pre{{background:#f4f4f2;padding:1rem;overflow-x:auto;font-size:12px}}svg{{max-width:100%}}\
         </style></head>\n<body><h1>{name}: what it can know at best</h1>\n<pre>{table}</pre>\n{body}</body></html>\n",
        name = skin.name,
    ))
}

/// The bound of the position at every point, seen from above.
fn heat_map(model: &dyn ForwardModel, map: &SurfaceBound) -> Result<String> {
    use plotters::prelude::*;
    let points = &model.surface().points;
    let span = points.iter().flat_map(|p| [p.x.abs(), p.y.abs()]).fold(1e-4, f64::max) * 1.05e3;
    let known = || map.bounds.iter().map(|b| b.position).filter(|p| p.is_finite());
    let (low, high) = (known().fold(f64::INFINITY, f64::min), known().fold(0.0, f64::max));
    let mut svg = String::new();
    let mut draw = || -> Result<(), Box<dyn std::error::Error>> {
        let root = SVGBackend::with_string(&mut svg, (480, 480)).into_drawing_area();
        root.fill(&WHITE)?;
        let caption = format!("position: {} (blue) to {} mm (red)", mm(low), mm(high));
        let mut chart = ChartBuilder::on(&root)
            .caption(caption, ("sans-serif", 15))
            .margin(12)
            .x_label_area_size(32)
            .y_label_area_size(44)
            .build_cartesian_2d(-span..span, -span..span)?;
        chart.configure_mesh().x_desc("x [mm]").y_desc("y [mm]").disable_mesh().draw()?;
        let shown = points.iter().zip(&map.bounds).filter(|(_, b)| b.position.is_finite());
        chart.draw_series(shown.map(|(p, b)| {
            let share = ((b.position / low).ln() / (high / low).ln()).clamp(0.0, 1.0);
            let colour = HSLColor(0.62 * (1.0 - if share.is_nan() { 0.0 } else { share }), 0.75, 0.55);
            Circle::new((p.x * 1e3, p.y * 1e3), 5, colour.filled())
        }))?;
        root.present()?;
        Ok(())
    };
    draw().map_err(|e| anyhow!("the map cannot be drawn: {e}"))?;
    Ok(svg)
}

/// The bound of the position of two contacts over their distance.
fn curve(pairs: &[TwoContacts]) -> Result<String> {
    use plotters::prelude::*;
    let shown = || pairs.iter().filter(|p| p.position.is_finite() && p.position < p.distance);
    let width = pairs.last().map_or(1.0, |p| p.distance * 1e3);
    let height = shown().map(|p| p.position * 1e3).fold(0.1, f64::max) * 1.05;
    let mut svg = String::new();
    let mut draw = || -> Result<(), Box<dyn std::error::Error>> {
        let root = SVGBackend::with_string(&mut svg, (640, 360)).into_drawing_area();
        root.fill(&WHITE)?;
        let mut chart = ChartBuilder::on(&root)
            .margin(12)
            .x_label_area_size(36)
            .y_label_area_size(48)
            .build_cartesian_2d(0.0..width, 0.0..height)?;
        chart
            .configure_mesh()
            .x_desc("distance of the contacts [mm]")
            .y_desc("bound of the position [mm]")
            .light_line_style(WHITE)
            .draw()?;
        chart.draw_series(LineSeries::new(
            shown().map(|p| (p.distance * 1e3, p.position * 1e3)),
            BLUE.stroke_width(2),
        ))?;
        root.present()?;
        Ok(())
    };
    draw().map_err(|e| anyhow!("the curve cannot be drawn: {e}"))?;
    Ok(svg)
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    #[test]
    fn the_grid_is_bounded_and_drawn() {
        let folder = tempfile::tempdir().unwrap();
        let skin = Path::new(env!("CARGO_MANIFEST_DIR")).join("../launch/skins/baro-grid.toml");
        let options = Options {
            skin,
            force: vec![0.2, 1.0],
            diameter: 0.004,
            shear: false,
            line: false,
            out: Some(folder.path().to_owned()),
            json: true,
        };
        run(&options).unwrap();
        let html = std::fs::read_to_string(folder.path().join("bound.html")).unwrap();
        let json = std::fs::read_to_string(folder.path().join("bound.json")).unwrap();
        let value: serde_json::Value = serde_json::from_str(&json).unwrap();
        assert_eq!(html.matches("<svg").count(), 3);
        assert_eq!(
            value["maps"][0]["bounds"].as_array().unwrap().len(),
            value["points"].as_array().unwrap().len()
        );
        let at = |i: usize| value["summary"]["one_contact"][i]["position_m"]["median"].as_f64().unwrap();
        // Five times the force, on a skin that is nearly linear in it; a bound of micrometres would be a mistake.
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
}
