//! The page: figures in the manner of the thesis' chapter 5, each with what one sees and by which equation.

use std::fmt::Write as _;

use anyhow::Result;
use dermis_figures::{Axes, COLOURS, Curve, Pen, curves, escape, figure, heat, page, short, surface};
use dermis_skin::Surface;
use dermis_studies::bounds::{Findings, SurfaceStudy, feet};
use dermis_studies::flat::flat;
use dermis_theory::normalised::TwoTaxels;
use dermis_theory::{Averages, ByForce, LineStudy, TaxelStudy};

use nalgebra::Point3;

use super::text::mm;

/// σ_S of the normalised figures.
const SIGMA: f64 = 0.05;
/// Isolines of the overview.
const SHOWN: usize = 5;

/// The whole page.
///
/// # Errors
///
/// Where a figure cannot be drawn.
pub fn html(findings: &Findings, text: &str) -> Result<String> {
    let mut body = format!("<pre>{}</pre>\n", escape(text));
    let unit = &findings.skin.unit;
    if let Some(line) = &findings.line {
        row(&mut body, line, unit)?;
    }
    if let Some(study) = &findings.surface {
        over_surface(&mut body, findings, study)?;
    }
    bounds(&mut body, findings)?;
    two_contacts(&mut body, findings)?;
    trends(&mut body, findings)?;
    shapes(&mut body)?;
    Ok(page(&format!("{}: what it can know at best", findings.skin.name), &body))
}

fn millimetres(points: impl Iterator<Item = (f64, f64)>) -> Vec<(f64, f64)> {
    points.map(|(x, y)| (x * 1e3, y)).collect()
}

/// Points of locations in a row \[mm\], parted where locations are missing between them.
fn unbroken(points: impl Iterator<Item = (usize, f64, f64)>) -> Vec<(f64, f64)> {
    let mut found = Vec::new();
    let mut last: Option<usize> = None;
    for (location, x, y) in points {
        if last.is_some_and(|l| l + 1 != location) {
            found.push((f64::NAN, f64::NAN));
        }
        found.push((x * 1e3, y));
        last = Some(location);
    }
    found
}

/// Middle taxel of a row.
fn middle(line: &LineStudy) -> Option<&TaxelStudy> {
    line.taxels.get(line.taxels.len() / 2)
}

fn row(body: &mut String, line: &LineStudy, unit: &str) -> Result<()> {
    let _ = writeln!(body, "<h2>A row of {} taxels</h2>", line.count);
    isolines(body, line, unit)?;
    coefficients(body, line, unit)?;
    maps(body, line, unit)?;
    factors(body, line)
}

fn isolines(body: &mut String, line: &LineStudy, unit: &str) -> Result<()> {
    let count = line.taxels.first().map_or(0, |t| t.isolines.len());
    let every = count.div_ceil(SHOWN).max(1);
    let axes = Axes {
        y_range: Some((0.0, 1.5)),
        ..Axes::new("isolines of all taxels", "position along the row [mm]", "force [N]")
    };
    let mut all = Vec::new();
    for (n, k) in (0..count).step_by(every).enumerate() {
        for (i, taxel) in line.taxels.iter().enumerate() {
            let isoline = &taxel.isolines[k];
            let name = if i == 0 { format!("{} {unit}", short(isoline.value)) } else { String::new() };
            let points = isoline.points.iter().map(|p| (p.location, line.arc[p.location], p.force));
            all.push(Curve::new(name, n, unbroken(points)));
        }
    }
    let mut fitted = Vec::new();
    if let Some(taxel) = middle(line) {
        for (n, k) in (0..count).step_by(every).enumerate() {
            let isoline = &taxel.isolines[k];
            let mut points: Vec<_> = isoline.points.iter().map(|p| (p.distance, p.force)).collect();
            points.sort_by(|a, b| a.0.total_cmp(&b.0));
            let thinned = points.iter().copied().step_by(points.len().div_ceil(60).max(1));
            fitted.push(Curve::new("", n, millimetres(thinned)).pen(Pen::Dots));
            if let Some(fit) = taxel.fits.iter().find(|f| f.value == isoline.value) {
                let name = format!(
                    "{} {unit}: {} + {}|d/mm|^{:.1}",
                    short(fit.value),
                    short(fit.g),
                    power(fit.lambda),
                    fit.alpha
                );
                fitted.push(Curve::new(name, n, millimetres(points.iter().map(|p| (p.0, fit.force(p.0))))));
            }
        }
    }
    let single = Axes {
        y_range: Some((0.0, 2.1)),
        ..Axes::new("one taxel, and its fits", "distance d from its foot [mm]", "force [N]")
    };
    body.push_str(&figure(
        &[curves(&axes, &all)?, curves(&single, &fitted)?],
        "<b>Taxel value isolines</b> (5.3): how hard the row must be pressed at each position for a taxel to read one value. \
         Where two of them cross, a contact is found. <i>One taxel, and its fits</i>: dots are its isolines, lines the fits \
         I(d) = g(S) + λ|d|<sup>α</sup> (5.16). In the manner of the thesis' Figs. 5.9 B and 5.10 B.",
    ));
    Ok(())
}

/// A small number as a power of ten.
fn power(value: f64) -> String {
    if value >= 1e-3 { short(value) } else { format!("{value:.0e}") }
}

fn coefficients(body: &mut String, line: &LineStudy, unit: &str) -> Result<()> {
    let foot = |t: &TaxelStudy| {
        t.isolines
            .iter()
            .filter_map(|i| {
                let nearest = i.points.iter().min_by(|a, b| a.distance.abs().total_cmp(&b.distance.abs()))?;
                (nearest.distance.abs() < 1e-3).then_some((i.value, nearest.force))
            })
            .collect::<Vec<_>>()
    };
    let mut above = Vec::new();
    for (n, taxel) in line.taxels.iter().enumerate() {
        above.push(Curve::new(format!("taxel {}", n + 1), n, foot(taxel)));
    }
    if let Some(taxel) = middle(line) {
        let straight = taxel.isolines.iter().map(|i| (i.value, taxel.c * i.value)).collect();
        above.push(Curve::new("c · S", 6, straight).pen(Pen::Dashed));
    }
    let by_distance: Vec<Curve> = line
        .taxels
        .iter()
        .enumerate()
        .map(|(n, t)| {
            let mut points: Vec<_> = t.c_by_distance.iter().map(|[d, c]| (d * 1e3, c * 1e3)).collect();
            points.sort_by(|a, b| a.0.total_cmp(&b.0));
            Curve::new("", n, points)
        })
        .collect();
    let fitted = |of: fn(&dermis_theory::IsolineFit) -> f64| -> Vec<Curve> {
        line.taxels
            .iter()
            .enumerate()
            .map(|(n, t)| Curve::new("", n, t.fits.iter().map(|f| (f.value, of(f))).collect()))
            .collect()
    };
    let value = format!("value S [{unit}]");
    let alpha = Axes { log_x: true, ..Axes::new("exponent α", &value, "α") };
    let lambda = Axes { log_x: true, log_y: true, ..Axes::new("coefficient λ", &value, "λ [N at 1 mm]") };
    let c = Axes {
        log_y: true,
        ..Axes::new(
            "c(d) at the middle one of the values",
            "distance d [mm]",
            format!("c [N per 1000 {unit}]"),
        )
    };
    body.push_str(&figure(
        &[
            curves(
                &Axes::new("force straight above", &value, "g(S) [N]"),
                &above,
            )?,
            curves(&c, &by_distance)?,
            curves(&alpha, &fitted(|f| f.alpha))?,
            curves(&lambda, &fitted(|f| f.lambda))?,
        ],
        "<b>What the isolines are made of.</b> g(S) is nearly c·S: the taxel is nearly linear. c(d) = dF/dS (5.17) turns a \
         reading's noise into newtons and grows with the distance. α and λ depend on the value: the isolines of small \
         values reach far, where the field falls ever more steeply. One colour a taxel; Figs. 5.9 C and 5.10 C, D.",
    ));
    Ok(())
}

fn maps(body: &mut String, line: &LineStudy, unit: &str) -> Result<()> {
    let arc: Vec<f64> = line.map.arc.iter().map(|a| a * 1e3).collect();
    let least = line.arc.iter().zip(&line.minimum_force).map(|(a, f)| (a * 1e3, f.unwrap_or(f64::NAN)));
    let least = Curve { colour: COLOURS[1], ..Curve::new("", 1, least.collect()) };
    let scaled: Vec<Vec<Option<f64>>> =
        line.map.position.iter().map(|r| r.iter().map(|v| v.map(|v| v * 1e3)).collect()).collect();
    let axes =
        |title: &str| Axes { log_y: true, ..Axes::new(title, "position along the row [mm]", "force [N]") };
    body.push_str(&figure(
        &[
            heat(&axes("σ_P"), "σ_P [mm]", (&arc, &line.map.forces), &scaled, std::slice::from_ref(&least))?,
            heat(&axes("σ_F"), "σ_F [N]", (&arc, &line.map.forces), &line.map.force, &[least])?,
        ],
        &format!(
            "<b>Both deviations over position and force</b>, from the area in which the bands S ± σ_S of all taxels that read \
             S<sub>min</sub> = {} {unit} or more overlap: half of the bounding box of its exact corners (5.7–5.10). Below the \
             line, F<sub>S</sub>, fewer than two taxels do, and nothing can be triangulated; it is lower between taxels \
             than above them. The harder a press, the more taxels take part. Fig. 5.4 B.",
            short(line.least)
        ),
    ));
    Ok(())
}

fn factors(body: &mut String, line: &LineStudy) -> Result<()> {
    type Way = fn(&ByForce) -> Option<Averages>;
    let ways: [(&str, Way); 3] = [
        ("fits of two (5.18)", |f| f.fits),
        ("corners of two (5.7–5.10)", |f| f.corners),
        ("bound of all", |f| f.bound),
    ];
    let mut position = Vec::new();
    let mut force = Vec::new();
    let mut factor = Vec::new();
    for (n, (name, of)) in ways.into_iter().enumerate() {
        let known = || line.by_force.iter().filter_map(move |f| Some((f.force, of(f)?)));
        position.push(Curve::new(name, n, known().map(|(f, a)| (f, a.position * 1e3)).collect()));
        force.push(Curve::new(name, n, known().map(|(f, a)| (f, a.force)).collect()));
        factor.push(Curve::new(name, n, known().map(|(f, a)| (f, a.factor)).collect()));
        let with: Vec<_> = known().map(|(f, a)| (f, a.factor_with_testbed)).collect();
        factor.push(Curve::new("… with the testbed (5.21)", n, with).pen(Pen::Dashed));
    }
    let axes = |title: &str, y: &str| Axes { log_y: true, ..Axes::new(title, "force [N]", y) };
    body.push_str(&figure(
        &[
            curves(&axes("σ_P, mean over the row", "σ_P [mm]"), &position)?,
            curves(&axes("σ_F, mean over the row", "σ_F [N]"), &force)?,
            curves(&Axes { size: (620, 380), ..axes("super-resolution factor", "Ω") }, &factor)?,
        ],
        &format!(
            "<b>Deviations and super-resolution factor over force.</b> Ω = length / (n · 2⟨σ_P⟩) (5.20), dashed with a stage \
             of 7.5 µm added to σ_P (5.21). Means over force: {:.0} by fits, {:.0} by corners, {:.0} by the bound; with the \
             testbed {:.0}, {:.0}, {:.0}. (5.19) names the height of the whole intersection, 2cσ_S, hence the fits' σ_F; the \
             corners' is half of it. The bound is a standard deviation of the best use of all taxels, boxes are not. Figs. \
             5.9 D-I, 5.10 E, F.",
            line.factors.fits[0],
            line.factors.corners[0],
            line.factors.bound[0],
            line.factors.fits[1],
            line.factors.corners[1],
            line.factors.bound[1]
        ),
    ));
    Ok(())
}

/// Points above taxels, each once however many channels it has.
fn taxels(findings: &Findings, surface: &Surface) -> Vec<Point3<f64>> {
    let mut found: Vec<Point3<f64>> = Vec::new();
    for foot in feet(&findings.skin, surface) {
        if !found.contains(&foot) {
            found.push(foot);
        }
    }
    found
}

fn over_surface(body: &mut String, findings: &Findings, study: &SurfaceStudy) -> Result<()> {
    let skin = findings.skin.surface();
    let (points, [x, y]) = flat(&skin, &skin.points);
    let (taxels, _) = flat(&skin, &taxels(findings, &skin));
    let mut isoline = vec![f64::NAN; points.len()];
    for point in &study.isoline.points {
        isoline[point.location] = point.force;
    }
    let least: Vec<f64> = study.minimum_force.iter().map(|f| f.unwrap_or(f64::NAN)).collect();
    body.push_str("<h2>The surface</h2>\n");
    let value = format!("isoline of {} {}", short(study.isoline.value), findings.skin.unit);
    body.push_str(&figure(
        &[
            surface(&Axes::new(value, x, y), "force [N]", &points, &isoline, &taxels)?,
            surface(&Axes::new("minimum force", x, y), "F_S [N]", &points, &least, &taxels)?,
        ],
        &format!(
            "<b>Isolines on a surface.</b> <i>Isoline</i>: the force that it takes for the taxel nearest to the middle to read one \
             value, its iso-surface seen from above (Fig. 5.6 A). <i>Minimum force</i>: the sensitivity F<sub>S</sub>, from \
             which on three taxels read S<sub>min</sub> = {} {} as triangulation on a surface needs; lower between taxels than above them \
             and higher at the rim (Figs. 5.6 C, 5.12 A). Crosses are taxels.",
            short(findings.least),
            findings.skin.unit
        ),
    ));
    if !study.factors.is_empty() {
        let mut table = String::from(
            "<table><tr><th>force [N]</th><th>bound σ_x, σ_y, RMS [mm]</th><th>Ω</th><th>Ω with the testbed</th><th>bound, \
             median [mm]</th><th>Ω</th><th>bands of three, median [mm]</th><th>Ω</th></tr>\n",
        );
        for f in &study.factors {
            let both = |s: [f64; 2]| format!("{}, {}", mm(s[0]), mm(s[1]));
            let _ = writeln!(
                table,
                "<tr><td>{}</td><td>{}</td><td>{:.0}</td><td>{:.0}</td><td>{}</td><td>{:.0}</td><td>{}</td><td>{:.0}</td></tr>",
                f.force,
                both(f.bound),
                f.factor,
                f.factor_with_testbed,
                both(f.bound_median),
                f.bound_median_factor,
                both(f.bands_median),
                f.bands_median_factor
            );
        }
        table.push_str("</table>\n");
        let _ = writeln!(
            body,
            "<figure>{table}<figcaption><b>Super-resolution on the surface</b>: Ω = A / (n π σ_x σ_y) (5.24) over the part \
             between the outermost taxels (all of a curved surface), with the Cramér–Rao bound of all taxels and with the box \
             around the bands of the three that read most.</figcaption></figure>"
        );
    }
    Ok(())
}

fn bounds(body: &mut String, findings: &Findings) -> Result<()> {
    let Some(model) = findings.model.as_ref().filter(|_| !findings.maps.is_empty()) else { return Ok(()) };
    let skin = model.surface();
    let (points, [x, y]) = flat(skin, &skin.points);
    let (taxels, _) = flat(skin, &taxels(findings, skin));
    let row = findings.unknowns == dermis_model::Unknowns::Line;
    body.push_str("<h2>The bound</h2>\n");
    let mut pictures = Vec::new();
    if row {
        let along = |of: fn(&dermis_theory::ContactBound) -> f64, factor: f64| -> Vec<Curve> {
            findings
                .maps
                .iter()
                .enumerate()
                .map(|(n, map)| {
                    let mut at: Vec<(f64, f64)> = skin
                        .points
                        .iter()
                        .zip(&map.bounds)
                        .map(|(p, b)| (p.x * 1e3, of(b) * factor))
                        .collect();
                    at.sort_by(|a, b| a.0.total_cmp(&b.0));
                    // Points across the row say the same.
                    at.dedup_by(|a, b| (a.0 - b.0).abs() < 1e-9);
                    Curve::new(format!("{} N", map.force), n, at)
                })
                .collect()
        };
        let axes = |title: &str, y: &str| Axes { log_y: true, ..Axes::new(title, "x [mm]", y) };
        pictures.push(curves(&axes("position", "bound [mm]"), &along(|b| b.position, 1e3))?);
        pictures.push(curves(&axes("force", "bound [N]"), &along(|b| b.normal_force, 1.0))?);
    } else {
        for map in &findings.maps {
            let values: Vec<f64> = map.bounds.iter().map(|b| b.position * 1e3).collect();
            let axes = Axes::new(format!("{} N", map.force), x, y);
            pictures.push(surface(&axes, "bound of the position [mm]", &points, &values, &taxels)?);
        }
    }
    body.push_str(&figure(
        &pictures,
        "<b>The Cramér–Rao bound</b>: the least standard deviation that an estimator without bias can have from one frame, \
         with every taxel used as well as its noise allows. It is worst where few taxels are near and where those near lie \
         straight below.",
    ));
    Ok(())
}

fn two_contacts(body: &mut String, findings: &Findings) -> Result<()> {
    if findings.pairs.is_empty() {
        return Ok(());
    }
    let pairs = &findings.pairs;
    let bound =
        pairs.iter().filter(|p| p.position < p.distance).map(|p| (p.distance * 1e3, p.position * 1e3));
    let half = pairs.iter().map(|p| (p.distance * 1e3, p.distance * 500.0));
    let limits = [
        Curve::new("bound of each", 0, bound.collect()),
        Curve::new("half of their distance", 6, half.collect()).pen(Pen::Dashed),
    ];
    let axes =
        Axes { log_y: true, ..Axes::new("two contacts across the middle", "distance [mm]", "position [mm]") };
    let mut pictures = vec![curves(&axes, &limits)?];
    if findings.distinguishable.len() == pairs.len() {
        let share = pairs.iter().zip(&findings.distinguishable).map(|(p, s)| (p.distance * 1e3, *s));
        let axes = Axes {
            y_range: Some((0.0, 1.0)),
            ..Axes::new("by isolines, anywhere on the row", "distance [mm]", "share of pairs distinguished")
        };
        pictures.push(curves(&axes, &[Curve::new("", 1, share.collect())])?);
    }
    body.push_str("<h2>Two contacts</h2>\n");
    body.push_str(&figure(
        &pictures,
        "<b>How close two equal contacts may come.</b> <i>Two contacts across the middle</i>: the bound of either when both are \
         unknown; they are distinguished where it is below half of their distance. <i>By isolines, anywhere on the row</i> (Fig. 5.5): \
         each contact needs two taxels of its own that the other leaves below S<sub>min</sub>, or crossings are spoilt; harder presses reach further, so that this \
         gets harder with force. The bound knows that readings add up and needs no taxel of its own.",
    ));
    Ok(())
}

fn trends(body: &mut String, findings: &Findings) -> Result<()> {
    if findings.trends.is_empty() {
        return Ok(());
    }
    let mut pictures = Vec::new();
    for trend in &findings.trends {
        let axes = Axes {
            y_range: Some((0.0, 1.0)),
            ..Axes::new(trend.label, "distance d from its foot [mm]", "force [N]")
        };
        let drawn: Vec<Curve> = trend
            .curves
            .iter()
            .enumerate()
            .map(|(n, c)| {
                let name = format!("{}{}", short(c.at), if c.nominal { " (as it is)" } else { "" });
                let curve = Curve::new(name, n, c.isoline.iter().map(|[d, f]| (d * 1e3, *f)).collect());
                curve.pen(if c.nominal { Pen::Line } else { Pen::Dashed })
            })
            .collect();
        pictures.push(curves(&axes, &drawn)?);
    }
    let value = findings.trends.first().map_or(0.0, |t| t.value);
    body.push_str("<h2>Trends</h2>\n");
    body.push_str(&figure(
        &pictures,
        &format!(
            "<b>What shapes the isolines</b>: that of {} {} of the taxel nearest to the middle, while one number of the skin or \
             of the tip varies. A lower line is a more sensitive taxel, a steeper one locates better. The questions of the \
             thesis' Fig. 5.7, for what these taxels read. <code>dermis sweep</code> says what they are worth.",
            short(value),
            findings.skin.unit
        ),
    ));
    Ok(())
}

fn shapes(body: &mut String) -> Result<()> {
    let alphas = [0.5, 1.0, 2.0, 4.0];
    let locations: Vec<f64> = (-60..=160).map(|i| f64::from(i) / 100.0).collect();
    let (mut lines, mut position, mut force, mut least) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for (n, alpha) in alphas.into_iter().enumerate() {
        let two = TwoTaxels::normalised(alpha)?;
        let name = format!("α = {alpha}");
        // Where two lie on each other both show.
        let pen = if alpha == 2.0 { Pen::Dashed } else { Pen::Line };
        let of = |value: &dyn Fn(f64) -> f64| locations.iter().map(|d| (*d, value(*d))).collect::<Vec<_>>();
        lines.push(Curve::new(name.clone(), n, of(&|d| 0.2 + two.rise(d)[0])));
        lines.push(Curve::new("", n, of(&|d| 0.2 + two.rise(d)[1])).pen(Pen::Dashed));
        position.push(Curve::new(name.clone(), n, of(&|d| two.corners(d, SIGMA).position / SIGMA)).pen(pen));
        force.push(Curve::new(name.clone(), n, of(&|d| two.corners(d, SIGMA).force / SIGMA)).pen(pen));
        least.push(Curve::new(name, n, of(&|d| two.minimum_force(d, 0.2))));
    }
    let axes = |title: &str, y: &str, top: f64| Axes {
        y_range: Some((0.0, top)),
        size: (480, 320),
        ..Axes::new(title, "position (taxels at 0 and 1)", y)
    };
    body.push_str("<h2>What the shape of isolines does</h2>\n");
    body.push_str(&figure(
        &[
            curves(&axes("isolines of both taxels", "force", 2.0), &lines)?,
            curves(&axes("position", "σ_P / σ_S", 4.0), &position)?,
            curves(&axes("force", "σ_F / σ_S", 6.0), &force)?,
            curves(&axes("minimum force", "F_S", 2.0), &least)?,
        ],
        "<b>Two ideal taxels at distance 1</b>, isolines g(S) + |d|<sup>α</sup> (5.5, 5.6), whatever the skin: α = 2 locates \
         equally well everywhere, with σ_P = σ_S; α = 1 locates between the \
         taxels only (its line ends there); α < 1 makes up to three areas, of which the right one is taken for known; larger α \
         locates better outside at the price of more force; between the taxels the force is known equally well whatever α is. σ_S is \
         0.05; exact corners (5.7–5.10). Fig. 5.3.",
    ));
    Ok(())
}
