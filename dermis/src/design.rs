//! `dermis design`: what a skin would gain from being built otherwise, before anything is moulded.

use std::fmt::Write as _;
use std::path::PathBuf;
use std::sync::Arc;

use anyhow::{Context, Result, bail};
use clap::{Args, ValueEnum as _};
use dermis_model::{ForwardModel, Unknowns, WithNoise};
use dermis_skin::{SkinDescription, SurfaceSpec};
use dermis_theory::resolution::{along_line, on_surface};
use dermis_theory::{Responses, Summary, force_ladder, over_surface};
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;
use serde_json::json;

use crate::figures::{Axes, Curve, Pen, curves, escape, figure, page, short};
use crate::variation::{Parameter, in_parallel};

/// Values of each parameter, relative to the one that the skin has.
const FACTORS: [f64; 9] = [0.5, 0.65, 0.8, 0.9, 1.0, 1.1, 1.25, 1.5, 2.0];
/// Poisson's ratio is below one half, and elastomers are near it.
const POISSON: [f64; 6] = [0.5, 0.7, 0.85, 0.95, 1.0, 1.015];
/// Points of the surface that are bounded at most.
const POINTS: f64 = 260.0;

/// What to vary.
#[derive(Args)]
pub struct Options {
    /// Skin description.
    skin: PathBuf,
    /// Numbers to vary, one at a time; all that the skin has where absent.
    #[arg(long, value_delimiter = ',', value_enum)]
    vary: Vec<Parameter>,
    /// Pressing force [N].
    #[arg(long, default_value_t = 0.3)]
    force: f64,
    /// Diameter of the tip [m].
    #[arg(long, default_value_t = 0.004)]
    diameter: f64,
    /// Only x is unknown of the place: for taxels in a row.
    #[arg(long)]
    line: bool,
    /// Folder for `design.html` and `design.json`.
    #[arg(short, long)]
    out: Option<PathBuf>,
    /// One JSON object in place of the text.
    #[arg(long)]
    json: bool,
}

/// What a skin can do.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
struct Figures {
    /// \[m\] Cramér–Rao bound of the position, over the surface.
    position: Summary,
    /// \[N\] of the pressing force.
    force: Summary,
    /// F_S \[N\] over the surface.
    minimum_force: Summary,
    /// Super-resolution factor, by the bound.
    factor: f64,
}

/// A skin with one number changed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
struct Variant {
    /// The number, in SI units.
    value: f64,
    /// Relative to the skin as it is.
    relative: f64,
    figures: Figures,
}

/// All variants of one number.
#[derive(Debug, Serialize)]
struct Sweep {
    parameter: Parameter,
    variants: Vec<Variant>,
    /// Per cent that a figure changes for one per cent of the parameter, at the skin as it is.
    elasticity: Elasticity,
    /// What could not be built, and why.
    refused: Vec<String>,
}

#[derive(Debug, Clone, Copy, Serialize)]
struct Elasticity {
    position: f64,
    position_median: f64,
    force: f64,
    minimum_force: f64,
    factor: f64,
}

/// Varies, and says what helps.
pub fn run(options: &Options) -> Result<()> {
    let mut skin = SkinDescription::load(&options.skin)?;
    if !(options.force.is_finite() && options.force > 0.0) {
        bail!("option `--force` is {} N and must be positive", options.force);
    }
    coarsen(&mut skin);
    let parameters: Vec<Parameter> = if options.vary.is_empty() {
        Parameter::value_variants().iter().copied().filter(|p| p.value(&skin).is_ok()).collect()
    } else {
        // What was asked for must be there.
        options.vary.iter().map(|p| p.value(&skin).map(|_| *p)).collect::<Result<_>>()?
    };
    let progress = ProgressBar::new(parameters.iter().map(|p| factors(*p).len() as u64).sum::<u64>() + 1)
        .with_style(ProgressStyle::with_template("{msg} {wide_bar} {pos}/{len} skins, {eta} left")?);
    progress.set_message(skin.name.clone());
    let model = crate::registry::forward(&options.skin, &skin)?;
    let nominal = figures(&skin, model.as_ref(), options)?;
    progress.inc(1);
    let sweeps = sweep(&parameters, &skin, (&model, nominal), options, &progress)?;
    progress.finish_and_clear();
    let value = json!({
        "skin": skin.name,
        "force_n": options.force,
        "diameter_m": options.diameter,
        "as_it_is": nominal,
        "sweeps": sweeps,
    });
    let text = text(&skin, nominal, &sweeps, options);
    if let Some(folder) = &options.out {
        std::fs::create_dir_all(folder)
            .with_context(|| format!("folder {} cannot be made", folder.display()))?;
        let html = html(&skin, &text, &sweeps)?;
        for (name, text) in [("design.html", html), ("design.json", value.to_string() + "\n")] {
            let path = folder.join(name);
            std::fs::write(&path, text).with_context(|| format!("{} cannot be written", path.display()))?;
        }
    }
    if options.json {
        println!("{value}");
    } else {
        print!("{text}");
    }
    Ok(())
}

/// Few enough points that dozens of skins are bounded in seconds.
fn coarsen(skin: &mut SkinDescription) {
    let area: f64 = skin.surface().areas.iter().sum();
    let least = (area / POINTS).sqrt();
    match &mut skin.surface {
        // A strip is as fine along it as it was: it has few points anyway.
        SurfaceSpec::Rectangle { size, spacing } if size[0].min(size[1]) > least => {
            *spacing = spacing.max(least);
        }
        SurfaceSpec::Dome { spacing, .. } => *spacing = spacing.max(least),
        // The mesh of a shell is its model, too.
        SurfaceSpec::Rectangle { .. } | SurfaceSpec::Panel { .. } | SurfaceSpec::Mesh { .. } => {}
    }
}

fn factors(parameter: Parameter) -> &'static [f64] {
    if parameter == Parameter::Poisson { &POISSON } else { &FACTORS }
}

/// What the skin can do with one number scaled.
fn varied(
    parameter: Parameter,
    relative: f64,
    skin: &SkinDescription,
    nominal: &Arc<dyn ForwardModel>,
    options: &Options,
) -> Result<Figures> {
    let scaled = parameter.scaled(skin, relative)?;
    // A model can take seconds to make, and noise is no part of it.
    if parameter == Parameter::Noise {
        let noisy = WithNoise::new(nominal.as_ref(), scaled.channel_noise());
        return figures(&scaled, &noisy, options);
    }
    let model = (crate::registry::family(skin)?.model)(&scaled)?;
    figures(&scaled, model.as_ref(), options)
}

/// What a skin can do under the force in question.
fn figures(skin: &SkinDescription, model: &dyn ForwardModel, options: &Options) -> Result<Figures> {
    let surface = model.surface();
    let unknowns = if options.line { Unknowns::Line } else { Unknowns::Normal };
    let map = over_surface(model, options.force, options.diameter, unknowns)?;
    let noise = model.noise().iter().copied().fold(0.0, f64::max);
    let least = skin.condition.contact_threshold * noise;
    let needed = if options.line { 2 } else { 3 };
    let responses = Responses::of_model(model, &surface.points, &force_ladder(1.5, 20), options.diameter)?;
    let minimum_force =
        (0..surface.points.len()).map(|p| responses.minimum_force(p, least, needed).unwrap_or(f64::INFINITY));
    let rms = |k: usize| {
        let squares = map.bounds.iter().zip(&surface.areas).map(|(b, a)| b.along[k].powi(2) * a);
        (squares.sum::<f64>() / surface.areas.iter().sum::<f64>()).sqrt()
    };
    let factor = if options.line {
        let x = |of: fn(f64, f64) -> f64, from| surface.points.iter().map(|p| p.x).fold(from, of);
        along_line(x(f64::max, f64::NEG_INFINITY) - x(f64::min, f64::INFINITY), model.channels(), rms(0))
    } else {
        on_surface(surface.areas.iter().sum(), model.channels(), [rms(0), rms(1)])
    };
    Ok(Figures {
        position: map.position,
        force: map.normal_force,
        minimum_force: Summary::of(minimum_force, &surface.areas),
        factor,
    })
}

/// Varies each of the parameters alone.
fn sweep(
    parameters: &[Parameter],
    skin: &SkinDescription,
    (model, nominal): (&Arc<dyn ForwardModel>, Figures),
    options: &Options,
    progress: &ProgressBar,
) -> Result<Vec<Sweep>> {
    let work: Vec<(Parameter, f64)> =
        parameters.iter().flat_map(|p| factors(*p).iter().map(move |f| (*p, *f))).collect();
    let found = in_parallel(&work, |&(parameter, relative)| {
        let figures =
            if relative == 1.0 { Ok(nominal) } else { varied(parameter, relative, skin, model, options) };
        progress.inc(1);
        figures
    });
    let mut found = work.iter().zip(found).peekable();
    let mut sweeps = Vec::new();
    for &parameter in parameters {
        let value = parameter.value(skin)?;
        let (mut variants, mut refused) = (Vec::new(), Vec::new());
        while let Some(((_, relative), figures)) = found.next_if(|((p, _), _)| *p == parameter) {
            match figures {
                Ok(figures) => {
                    variants.push(Variant { value: value * relative, relative: *relative, figures });
                }
                // A taxel below its medium, an incompressible layer.
                Err(error) => {
                    let shown = short(parameter.shown(value * relative));
                    refused.push(format!("{} of {shown}: {error}", parameter.name()));
                }
            }
        }
        sweeps.push(Sweep { parameter, elasticity: elasticity(&variants), variants, refused });
    }
    Ok(sweeps)
}

/// From the neighbours of the skin as it is, on logarithmic scales.
fn elasticity(variants: &[Variant]) -> Elasticity {
    let at = variants.iter().position(|v| v.relative == 1.0).unwrap_or_default();
    let (low, high) = (at.saturating_sub(1), (at + 1).min(variants.len().saturating_sub(1)));
    let of = |value: fn(&Figures) -> f64| match (variants.get(low), variants.get(high)) {
        (Some(a), Some(b)) if a.relative < b.relative => {
            (value(&b.figures) / value(&a.figures)).ln() / (b.relative / a.relative).ln()
        }
        _ => f64::NAN,
    };
    Elasticity {
        position: of(|f| f.position.rms),
        position_median: of(|f| f.position.median),
        force: of(|f| f.force.rms),
        minimum_force: of(|f| f.minimum_force.median),
        factor: of(|f| f.factor),
    }
}

fn text(skin: &SkinDescription, nominal: Figures, sweeps: &[Sweep], options: &Options) -> String {
    let mut out = format!(
        "{}: one contact of {} N, tip of {} mm: position {:.3} mm RMS ({:.3} median), force {:.4} N RMS, F_S {:.4} N \
         median, Ω {:.0}\n\n",
        skin.name,
        options.force,
        options.diameter * 1e3,
        nominal.position.rms * 1e3,
        nominal.position.median * 1e3,
        nominal.force.rms,
        nominal.minimum_force.median,
        nominal.factor
    );
    let _ = writeln!(
        out,
        "{:<16}{:>12} | {:>10}{:>10}{:>10}{:>10}{:>10}   least RMS in its range",
        "1 % more of", "from", "pos. RMS", "median", "F RMS", "F_S", "Ω"
    );
    let mut ranked: Vec<&Sweep> = sweeps.iter().collect();
    ranked.sort_by(|a, b| b.elasticity.position.abs().total_cmp(&a.elasticity.position.abs()));
    let percent = |v: f64| if v.is_finite() { format!("{v:+.2} %") } else { "-".to_owned() };
    for sweep in &ranked {
        let e = sweep.elasticity;
        let now = sweep.variants.iter().find(|v| v.relative == 1.0).map_or(f64::NAN, |v| v.value);
        let unit = match sweep.parameter {
            Parameter::Noise => skin.unit.as_str(),
            other => unit(other.label()),
        };
        let best = best(sweep).map_or_else(String::new, |best| {
            format!(
                "{:.3} mm at {}",
                best.figures.position.rms * 1e3,
                short(sweep.parameter.shown(best.value))
            )
        });
        let _ = writeln!(
            out,
            "{:<16}{:>12} | {:>10}{:>10}{:>10}{:>10}{:>10}   {best}",
            sweep.parameter.name(),
            format!("{} {unit}", short(sweep.parameter.shown(now))).trim_end(),
            percent(e.position),
            percent(e.position_median),
            percent(e.force),
            percent(e.minimum_force),
            percent(e.factor)
        );
    }
    out.push('\n');
    out.push_str(&advice(nominal, &ranked));
    for refused in sweeps.iter().flat_map(|s| &s.refused) {
        let _ = writeln!(out, "left out: {refused}");
    }
    out
}

/// `depth [mm]` → `mm`.
fn unit(label: &str) -> &str {
    label.split_once(" [").map_or("", |(_, unit)| unit.trim_end_matches(']'))
}

fn best(sweep: &Sweep) -> Option<&Variant> {
    sweep.variants.iter().min_by(|a, b| a.figures.position.rms.total_cmp(&b.figures.position.rms))
}

/// What helps most, in a few sentences.
fn advice(nominal: Figures, ranked: &[&Sweep]) -> String {
    let mut out = String::new();
    for sweep in ranked {
        let Some(best) = best(sweep) else { continue };
        let (name, e) = (sweep.parameter.name(), sweep.elasticity.position);
        let gain = 1.0 - best.figures.position.rms / nominal.position.rms;
        if !e.is_finite() || gain < 0.02 {
            let _ = writeln!(out, "{name}: hardly matters for the position, or is best as it is.");
            continue;
        }
        let direction = if best.relative < 1.0 { "less" } else { "more" };
        let at = short(sweep.parameter.shown(best.value));
        let cost = best.figures.minimum_force.median / nominal.minimum_force.median - 1.0;
        let price = if cost.abs() < 0.02 {
            "at the same sensitivity".to_owned()
        } else if cost > 0.0 {
            format!("but needs {:.0} % more force to be noticed by enough taxels", cost * 100.0)
        } else {
            format!("and needs {:.0} % less force to be noticed by enough taxels", -cost * 100.0)
        };
        let end = sweep.variants.first().is_some_and(|v| v.value == best.value)
            || sweep.variants.last().is_some_and(|v| v.value == best.value);
        let end = if end { ", the end of what was tried" } else { "" };
        let _ = writeln!(
            out,
            "{name}: {direction} helps: at {at}{end}, the position error falls by {:.0} %, {price}.",
            gain * 100.0
        );
    }
    out
}

fn html(skin: &SkinDescription, text: &str, sweeps: &[Sweep]) -> Result<String> {
    let mut body = format!("<pre>{}</pre>\n", escape(text));
    for sweep in sweeps {
        let x = |v: &Variant| sweep.parameter.shown(v.value);
        let line = |name: &str, n: usize, of: &dyn Fn(&Figures) -> f64| {
            Curve::new(name, n, sweep.variants.iter().map(|v| (x(v), of(&v.figures))).collect())
        };
        let now = |curve: &Curve| {
            let at = sweep.variants.iter().position(|v| v.relative == 1.0);
            let point = at.and_then(|i| curve.points.get(i)).copied();
            Curve {
                points: point.into_iter().collect(),
                name: String::new(),
                colour: curve.colour,
                pen: Pen::Mark,
            }
        };
        let label = sweep.parameter.label();
        let chart = |title: &str, y: &str, lines: Vec<Curve>| {
            let axes = Axes { size: (400, 280), ..Axes::new(title, label, y) };
            let marked: Vec<Curve> = lines.iter().flat_map(|l| [l.clone(), now(l)]).collect();
            curves(&axes, &marked)
        };
        let pictures = [
            chart(
                "position",
                "bound [mm]",
                vec![
                    line("RMS", 0, &|f| f.position.rms * 1e3),
                    line("median", 1, &|f| f.position.median * 1e3),
                ],
            )?,
            chart(
                "force",
                "bound [N]",
                vec![line("RMS", 0, &|f| f.force.rms), line("median", 1, &|f| f.force.median)],
            )?,
            chart(
                "minimum force",
                "F_S [N]",
                vec![
                    line("median", 1, &|f| f.minimum_force.median),
                    line("95 % of the surface", 2, &|f| f.minimum_force.p95),
                ],
            )?,
            chart("super-resolution", "Ω", vec![line("by the bound", 0, &|f| f.factor)])?,
        ];
        let _ = writeln!(body, "<h2>{}</h2>", escape(label));
        let refused = if sweep.refused.is_empty() {
            String::new()
        } else {
            format!(" Left out: {}.", escape(&sweep.refused.join("; ")))
        };
        body.push_str(&figure(
            &pictures,
            &format!(
                "Everything else as it is; dots mark the skin as it is. One per cent more changes the position error by \
                 {:+.2} %, the force error by {:+.2} %, F<sub>S</sub> by {:+.2} %, Ω by {:+.2} %.{refused}",
                sweep.elasticity.position,
                sweep.elasticity.force,
                sweep.elasticity.minimum_force,
                sweep.elasticity.factor
            ),
        ));
    }
    body.push_str(
        "<p>Errors are Cramér–Rao bounds of one contact from one frame, over the surface; F<sub>S</sub> is the force from which \
         on three taxels (two along a row) read the node's threshold of a contact, which follows the noise. With the pitch \
         the surface grows: the same number of taxels serves a larger skin.</p>\n",
    );
    Ok(page(&format!("{}: what a change of its design does", skin.name), &body))
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    fn options(skin: &str, vary: &[Parameter]) -> Options {
        Options {
            skin: Path::new(env!("CARGO_MANIFEST_DIR")).join("../launch/skins").join(skin),
            vary: vary.to_vec(),
            force: 0.3,
            diameter: 0.004,
            line: false,
            out: None,
            json: false,
        }
    }

    fn sweeps(options: &Options) -> (Figures, Vec<Sweep>, SkinDescription) {
        let mut skin = SkinDescription::load(&options.skin).unwrap();
        coarsen(&mut skin);
        let model = (crate::registry::family(&skin).unwrap().model)(&skin).unwrap();
        let nominal = figures(&skin, model.as_ref(), options).unwrap();
        let progress = ProgressBar::hidden();
        let sweeps = sweep(&options.vary, &skin, (&model, nominal), options, &progress).unwrap();
        (nominal, sweeps, skin)
    }

    #[test]
    fn noise_and_modulus_do_what_a_formula_says() {
        let options =
            Options { line: true, ..options("baro-line.toml", &[Parameter::Noise, Parameter::Modulus]) };
        let (_, sweeps, _) = sweeps(&options);
        // Twice the noise, twice the error, and twice the reading that must be reached.
        let noise = sweeps[0].elasticity;
        approx_eq(noise.position, 1.0, 1e-3);
        approx_eq(noise.force, 1.0, 1e-3);
        approx_eq(noise.minimum_force, 1.0, 0.05);
        approx_eq(noise.factor, -1.0, 1e-3);
        // A given force makes the same stress in a stiffer medium, but for the smaller contact.
        let modulus = sweeps[1].elasticity;
        assert!(modulus.position.abs() < 0.1, "{modulus:?}");
    }

    #[test]
    fn depth_is_a_compromise_and_said_so() {
        let options =
            Options { line: true, ..options("baro-line.toml", &[Parameter::Depth, Parameter::Thickness]) };
        let (nominal, sweeps, skin) = sweeps(&options);
        let depth = &sweeps[0];
        // Below the base of the medium there is none.
        assert!(depth.variants.len() >= 7 && depth.variants.iter().all(|v| v.value <= 0.0101));
        let text = text(&skin, nominal, &sweeps, &options);
        assert!(text.contains("depth") && text.contains("thickness") && text.contains("helps"), "{text}");
        let html = html(&skin, &text, &sweeps).unwrap();
        assert_eq!(html.matches("<svg").count(), 8);
    }

    #[test]
    fn what_cannot_be_built_is_left_out_and_named() {
        let options = Options { line: true, ..options("baro-line.toml", &[Parameter::Depth]) };
        let mut skin = SkinDescription::load(&options.skin).unwrap();
        // Twice as deep, the taxels lie below a thinner medium.
        *skin.medium.get_mut("thickness").unwrap() = 0.008.into();
        let model = (crate::registry::family(&skin).unwrap().model)(&skin).unwrap();
        let nominal = figures(&skin, model.as_ref(), &options).unwrap();
        let progress = ProgressBar::hidden();
        let sweeps = sweep(&options.vary, &skin, (&model, nominal), &options, &progress).unwrap();
        assert_eq!(sweeps[0].variants.len(), FACTORS.len() - 1);
        insta::assert_snapshot!(sweeps[0].refused[0], @"depth of 10: skin `baro-line`: field `taxels[0].position`: z of `b0` is -0.01 m and must lie in the medium: below 0 and not below -0.008 m");
    }

    fn approx_eq(found: f64, expected: f64, within: f64) {
        assert!((found - expected).abs() < within, "{found}, not {expected}");
    }

    #[test]
    fn what_cannot_be_varied_is_refused() {
        let mut options = options("baro-line.toml", &[]);
        options.force = -1.0;
        insta::assert_snapshot!(run(&options).unwrap_err(), @"option `--force` is -1 N and must be positive");
    }
}
