//! Pictures of maps: what a transfer network leaves of each channel, and force maps of single frames beside the true ones.

use dermis_figures::{Axes, Curve, Pen, curves, escape, figure, short, surface_within};

use super::SIZE;
use crate::LearnError;
use crate::evaluate::Evaluation;
use crate::metrics::{ChannelErrors, MapErrors, MapExample};

/// All pictures of an evaluation's maps, with their captions, as HTML; empty where there are none.
pub(super) fn of_maps(evaluation: &Evaluation) -> Result<String, LearnError> {
    let mut body = String::new();
    for (name, errors) in &evaluation.maps {
        if let Some(channels) = &errors.channels {
            let unit = escape(&errors.unit);
            let caption = format!(
                "What is left of each channel of <code>{name}</code>: mean and standard deviation of estimate − truth over {} touched frames. \
                 Standard deviation of the median channel: {} {}; of the worst: {} {}.",
                errors.touched.frames,
                short(quantile(&channels.deviation, 0.5)),
                unit,
                short(quantile(&channels.deviation, 1.0)),
                unit
            );
            body += &figure(&[residual(channels, &errors.unit)?], &caption);
        }
        body += &examples(name, errors)?;
    }
    Ok(body)
}

/// The value below which this share of all lies; not a number where there are none.
fn quantile(values: &[f64], share: f64) -> f64 {
    let mut sorted: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
    sorted.sort_by(f64::total_cmp);
    let last = sorted.len().saturating_sub(1);
    sorted.get((share * last as f64).round() as usize).copied().unwrap_or(f64::NAN)
}

/// Mean and standard deviation over the channels.
fn residual(channels: &ChannelErrors, unit: &str) -> Result<String, LearnError> {
    let points = |values: &[f64]| values.iter().enumerate().map(|(i, v)| (i as f64, *v)).collect();
    let axes = Axes::new("what is left of each channel", "channel", format!("estimate − truth [{unit}]"));
    let shown = [
        Curve::new("standard deviation", 1, points(&channels.deviation)).pen(Pen::Dots),
        Curve::new("mean", 0, points(&channels.mean)).pen(Pen::Dots),
    ];
    Ok(curves(&axes, &shown)?)
}

/// True and estimated map of each example, in pairs of one scale.
fn examples(name: &str, errors: &MapErrors) -> Result<String, LearnError> {
    let mut body = String::new();
    for example in &errors.examples {
        let forces: Vec<String> = example.forces.iter().map(|force| format!("{force:.1} N")).collect();
        let caption = format!(
            "<code>{name}</code>, contacts with {}: the truth and the estimate, on one scale. The frame with the most force of the first press with \
             {} contact{}.",
            forces.join(", "),
            forces.len(),
            if forces.len() == 1 { "" } else { "s" }
        );
        body += &figure(&pair(example)?, &caption);
    }
    Ok(body)
}

fn pair(example: &MapExample) -> Result<[String; 2], LearnError> {
    let points: Vec<(f64, f64)> = example.points.iter().map(|(x, y)| (x * 1e3, y * 1e3)).collect();
    let most = example.truth.iter().chain(&example.answer).copied().fold(f64::MIN_POSITIVE, f64::max);
    let drawn = |title: &str, values: &[f64]| {
        let axes = Axes { size: SIZE, ..Axes::new(title, "x [mm]", "y [mm]").equal(points.iter().copied()) };
        // A network's map may be a little below 0 where nothing presses.
        let values: Vec<f64> = values.iter().map(|v| v.max(0.0)).collect();
        surface_within(&axes, "force of a point [N]", &points, &values, [0.0, most], most)
    };
    Ok([drawn("truth", &example.truth)?, drawn("estimate", &example.answer)?])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::{MapPart, Scores};

    #[test]
    fn residuals_and_examples_are_drawn_with_what_they_are_of() {
        let mut evaluation = Evaluation::of(&Scores::default(), "x", 3, 0, 0);
        assert_eq!(of_maps(&evaluation).unwrap(), "");
        let touched = MapPart { frames: 12, ..MapPart::default() };
        let channels = ChannelErrors { mean: vec![0.0, 0.001, -0.001], deviation: vec![0.002, 0.004, 0.03] };
        let signal =
            MapErrors { unit: "V".into(), touched, channels: Some(channels), ..MapErrors::default() };
        evaluation.maps.insert("signal".into(), signal);
        let points: Vec<(f64, f64)> =
            (0..25).map(|i| (f64::from(i % 5) * 0.01, f64::from(i / 5) * 0.01)).collect();
        let map = |at: usize, force: f64| {
            let mut map = vec![0.0; 25];
            map[at] = force;
            map
        };
        let example =
            MapExample { forces: vec![5.0, 7.25], points, truth: map(12, 5.0), answer: map(13, 4.0) };
        let normal = MapErrors { unit: "N".into(), examples: vec![example.clone()], ..MapErrors::default() };
        evaluation.maps.insert("map.normal".into(), normal);
        let html = of_maps(&evaluation).unwrap();
        assert_eq!((html.matches("<svg").count(), html.matches("<figure>").count()), (3, 2));
        assert!(
            html.contains("over 12 touched frames. Standard deviation of the median channel: "),
            "{html}"
        );
        assert!(html.contains("contacts with 5.0 N, 7.2 N") || html.contains("contacts with 5.0 N, 7.3 N"));
        assert!(html.contains("first press with 2 contacts.") && !html.contains("NaN"));
        // But for its title, a right estimate is drawn as the truth is, and a wrong one is not.
        let right = MapExample { answer: example.truth.clone(), ..example.clone() };
        let [truth, estimate] = pair(&right).unwrap();
        assert_eq!(truth.replace("truth", "estimate"), estimate);
        let [truth, estimate] = pair(&example).unwrap();
        assert_ne!(truth.replace("truth", "estimate"), estimate);
        assert_eq!(quantile(&[3.0, 1.0, 2.0], 0.5), 2.0);
        assert!(quantile(&[], 0.5).is_nan());
    }
}
