//! Regressions from readings to one contact, learned from recordings.
//!
//! | regression | method |
//! |---|---|
//! | support vectors | ε-insensitive support vector regression; each coordinate and the force for itself |
//! | nearest neighbours | mean of the nearest readings' contacts, weighted by the inverse of their distance |
//! | feed-forward network | direction of the readings and logarithm of their length → place and force |
//!
//! All take readings in deviations of their noise.

use anyhow::Result;
use dermis_estimate::finder::RegressionFinder;
use dermis_learn::real2sim::Recorded;
use dermis_learn::train::{Batch, NetworkConfig, TrainingConfig, fit};
use dermis_regress::{Neighbours, RegressError, Rows, Svr, SvrSettings};
use dermis_skin::SkinDescription;

/// Neighbours of the thesis.
const NEIGHBOURS: usize = 6;
/// Presses that settings are tried with at most, to learn from and to ask.
const TRIED: usize = 800;

/// γ, C and ε of support vectors that are tried.
fn grid() -> impl Iterator<Item = (f64, f64, f64)> {
    let gammas = [0.3, 1.0, 3.0, 10.0].into_iter();
    gammas.flat_map(|g| [3.0, 30.0, 300.0].map(|c| (g, c))).flat_map(|(g, c)| [1e-3, 1e-2].map(|e| (g, c, e)))
}

/// A finder that answers by a regression.
fn finder(
    skin: &SkinDescription,
    regress: impl Fn(&[f64]) -> Result<Vec<f64>, RegressError> + Send + 'static,
) -> RegressionFinder {
    RegressionFinder::new(skin, Box::new(move |row| regress(row).map_err(|e| format!("failed: {e}"))))
}

/// Tables of whitened readings and of places and forces.
fn tables(skin: &SkinDescription, recorded: &[Recorded]) -> (Vec<f64>, Vec<f64>) {
    let noise = skin.channel_noise();
    let (mut inputs, mut targets) = (Vec::new(), Vec::new());
    for press in recorded {
        inputs.extend(press.signal.iter().zip(&noise).map(|(v, n)| f64::from(*v) / n));
        let p = press.contact.position;
        targets.extend([p.x, p.y, p.z, press.contact.force.norm()]);
    }
    (inputs, targets)
}

/// Support vectors, each coordinate and the force for itself; of more than `most` presses every n-th is learned from.
pub fn vectors(skin: &SkinDescription, recorded: &[Recorded], most: usize) -> Result<RegressionFinder> {
    let step = recorded.len().div_ceil(most.max(1)).max(1);
    let some: Vec<Recorded> = recorded.iter().step_by(step).cloned().collect();
    let (inputs, targets) = tables(skin, &some);
    let places: Vec<f64> = targets.chunks_exact(4).flat_map(|t| [t[0], t[1], t[2]]).collect();
    let forces: Vec<f64> = targets.chunks_exact(4).map(|t| t[3]).collect();
    let inputs = Rows::new(&inputs, skin.channels().len(), "readings")?;
    // Metres and newtons are scaled for themselves: outputs of one fit share a tube.
    let place = Svr::fit(inputs, Rows::new(&places, 3, "places")?, &SvrSettings::default())?;
    let force = Svr::fit(inputs, Rows::new(&forces, 1, "forces")?, &SvrSettings::default())?;
    Ok(finder(skin, move |row| {
        let mut answer = place.predict(row)?;
        answer.extend(force.predict(row)?);
        Ok(answer)
    }))
}

/// Support vectors, x, y, z and the force each with the settings of the least error on `choose`, which are returned, too. Of
/// more than `most` presses every n-th is learned from, and fewer while settings are tried.
pub fn tuned_vectors(
    skin: &SkinDescription,
    learn: &[Recorded],
    choose: &[Recorded],
    most: usize,
) -> Result<(RegressionFinder, [SvrSettings; 4])> {
    let few = |of: &[Recorded], most: usize| -> Vec<Recorded> {
        of.iter().step_by(of.len().div_ceil(most.max(1)).max(1)).cloned().collect()
    };
    let width = skin.channels().len();
    let columns = |of: &[Recorded]| {
        let (inputs, targets) = tables(skin, of);
        let columns = [0, 1, 2, 3].map(|k| targets.chunks_exact(4).map(|t| t[k]).collect::<Vec<f64>>());
        (inputs, columns)
    };
    let (some, some_columns) = columns(&few(learn, TRIED));
    let (asked, answers) = columns(&few(choose, TRIED));
    let (all, all_columns) = columns(&few(learn, most));
    let tune = |k: usize| -> Result<(Svr, SvrSettings)> {
        let mut best: Option<(f64, SvrSettings)> = None;
        for (gamma, c, epsilon) in grid() {
            let settings = SvrSettings { gamma, c, epsilon, ..SvrSettings::default() };
            let targets = Rows::new(&some_columns[k], 1, "targets")?;
            let svr = Svr::fit(Rows::new(&some, width, "readings")?, targets, &settings)?;
            let mut error = 0.0;
            for (row, answer) in asked.chunks_exact(width).zip(&answers[k]) {
                error += svr.predict(row)?.first().map_or(f64::INFINITY, |v| (v - answer).abs());
            }
            if best.is_none_or(|(least, _)| error < least) {
                best = Some((error, settings));
            }
        }
        let settings = best.map_or_else(SvrSettings::default, |(_, s)| s);
        let targets = Rows::new(&all_columns[k], 1, "targets")?;
        Ok((Svr::fit(Rows::new(&all, width, "readings")?, targets, &settings)?, settings))
    };
    let [x, y, z, force] = [tune(0)?, tune(1)?, tune(2)?, tune(3)?];
    let settings = [x.1, y.1, z.1, force.1];
    let each = [x.0, y.0, z.0, force.0];
    let finder = finder(skin, move |row| {
        let mut answer = Vec::with_capacity(4);
        for svr in &each {
            answer.extend(svr.predict(row)?);
        }
        Ok(answer)
    });
    Ok((finder, settings))
}

/// Nearest neighbours, as many as locate best on `choose`; their number, too.
pub fn tuned_neighbours(
    skin: &SkinDescription,
    learn: &[Recorded],
    choose: &[Recorded],
) -> Result<(RegressionFinder, usize)> {
    let ((inputs, targets), (asked, answers)) = (tables(skin, learn), tables(skin, choose));
    let width = skin.channels().len();
    let fit = |count: usize| {
        Neighbours::fit(Rows::new(&inputs, width, "readings")?, Rows::new(&targets, 4, "contacts")?, count)
    };
    let every = choose.len().div_ceil(TRIED).max(1);
    let mut best = (f64::INFINITY, NEIGHBOURS);
    for count in [1, 2, 3, 4, 6, 9, 13, 19] {
        let neighbours = fit(count)?;
        let mut error = 0.0;
        for (row, answer) in asked.chunks_exact(width).zip(answers.chunks_exact(4)).step_by(every) {
            let found = neighbours.predict(row)?;
            error += found.iter().zip(&answer[..3]).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
        }
        if error < best.0 {
            best = (error, count);
        }
    }
    let neighbours = fit(best.1)?;
    Ok((finder(skin, move |row| neighbours.predict(row)), best.1))
}

/// Nearest neighbours.
pub fn neighbours(skin: &SkinDescription, recorded: &[Recorded]) -> Result<RegressionFinder> {
    let (inputs, targets) = tables(skin, recorded);
    let inputs = Rows::new(&inputs, skin.channels().len(), "readings")?;
    let neighbours = Neighbours::fit(inputs, Rows::new(&targets, 4, "contacts")?, NEIGHBOURS)?;
    Ok(finder(skin, move |row| neighbours.predict(row)))
}

/// A feed-forward network.
pub fn network(skin: &SkinDescription, recorded: &[Recorded]) -> Result<RegressionFinder> {
    let (inputs, targets) = tables(skin, recorded);
    let most = recorded.iter().map(|r| r.contact.force.norm()).fold(1e-9, f64::max);
    let reach = recorded.iter().map(|r| r.contact.position.coords.amax()).fold(1e-9, f64::max);
    let scales = [reach as f32, most as f32];
    let data = Batch {
        inputs: direction(&inputs, skin.channels().len()),
        targets: targets
            .iter()
            .enumerate()
            .map(|(i, v)| *v as f32 / scales[usize::from(i % 4 == 3)])
            .collect(),
        width: skin.channels().len() + 1,
        outputs: 4,
        ..Batch::default()
    };
    let network = NetworkConfig { hidden: vec![256, 256, 256], ..NetworkConfig::default() };
    let training = TrainingConfig { epochs: 60, learning_rate: 1e-3, ..TrainingConfig::default() };
    let net = fit(&data, &network, &training, 0)?;
    Ok(finder(skin, move |row| {
        let answer = net.predict(&direction(row, row.len()));
        Ok(answer.iter().enumerate().map(|(i, v)| f64::from(v * scales[usize::from(i == 3)])).collect())
    }))
}

/// Rows as their direction, and the logarithm of their length: where a contact is shows in the one, how hard in the other.
fn direction(rows: &[f64], width: usize) -> Vec<f32> {
    let mut out = Vec::with_capacity(rows.len() / width.max(1) * (width + 1));
    for row in rows.chunks_exact(width) {
        let length = (row.iter().map(|v| v * v).sum::<f64>() + width as f64).sqrt();
        // About 1, as the other inputs are of a unit vector of some ten.
        out.extend(row.iter().map(|v| (v / length * (width as f64).sqrt()) as f32));
        out.push((length.ln() - 4.0) as f32);
    }
    out
}
