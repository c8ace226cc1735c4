//! How many samples a forward model gives.

use std::sync::Barrier;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use dermis_insight::model::ThumbModel;
use dermis_model::{ForwardModel, Stimulus};
use dermis_skin::SkinDescription;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

/// Samples between two looks at the clock.
const BATCH: usize = 256;

/// \[s\] of CPU time that this thread has used.
fn cpu_time() -> Result<f64> {
    let path = "/proc/thread-self/schedstat";
    let text = std::fs::read_to_string(path).with_context(|| format!("{path} cannot be read"))?;
    let nanoseconds: f64 = text.split(' ').next().unwrap_or_default().parse()?;
    Ok(nanoseconds * 1e-9)
}

/// Samples per second of all threads, by the clock and by their CPU time: response, noise, range, and where `maps` are requested the
/// displacement of every point.
pub fn sample(
    model: &dyn ForwardModel,
    skin: &SkinDescription,
    stimuli: &[Stimulus],
    maps: bool,
    seconds: f64,
    threads: usize,
) -> Result<[f64; 2]> {
    let ranges: Vec<[f64; 2]> =
        skin.channels().iter().map(|c| c.range.unwrap_or([f64::MIN, f64::MAX])).collect();
    rates(seconds, threads, |seed| {
        let mut rng = ChaCha8Rng::seed_from_u64(seed as u64);
        let mut clean = vec![0.0; model.channels()];
        let mut values = vec![0.0f32; model.channels()];
        let mut map = vec![0.0; if maps { model.surface().points.len() } else { 0 }];
        let mut batches = stimuli.chunks(BATCH).cycle();
        let ranges = &ranges;
        move || {
            let Some(batch) = batches.next() else { bail!("there is nothing to sample") };
            for stimulus in batch {
                model.response(stimulus, &mut clean)?;
                for (((value, clean), sigma), [low, high]) in
                    values.iter_mut().zip(&clean).zip(model.noise()).zip(ranges)
                {
                    let noise: f64 = rng.sample(StandardNormal);
                    *value = (clean + sigma * noise).clamp(*low, *high) as f32;
                }
                if maps {
                    model.displacement(stimulus, &mut map)?;
                }
                std::hint::black_box((&values, &map));
            }
            Ok(batch.len())
        }
    })
}

/// Pictures per second of all threads, by the clock and by their CPU time, noise included; before a camera would compress them.
pub fn render(model: &ThumbModel, stimuli: &[Stimulus], seconds: f64, threads: usize) -> Result<[f64; 2]> {
    rates(seconds, threads, |seed| {
        let mut rng = ChaCha8Rng::seed_from_u64(seed as u64);
        let mut next = stimuli.iter().cycle();
        move || {
            let Some(stimulus) = next.next() else { bail!("there is nothing to sample") };
            let image = model.render(stimulus, &mut || rng.sample(StandardNormal))?;
            std::hint::black_box(image.context("this skin has no camera")?);
            Ok(1)
        }
    })
}

/// What workers do per second, all threads together, by the clock and by their CPU time. `start` makes the worker of a thread, which says
/// how much it did each time that it is called.
fn rates<W: FnMut() -> Result<usize>>(
    seconds: f64,
    threads: usize,
    start: impl Fn(usize) -> W + Sync,
) -> Result<[f64; 2]> {
    let duration = Duration::from_secs_f64(seconds);
    let barrier = Barrier::new(threads);
    let run = |thread: usize| -> Result<[f64; 2]> {
        let mut work = start(thread);
        barrier.wait();
        let (begun, idle, mut count) = (Instant::now(), cpu_time()?, 0);
        while begun.elapsed() < duration {
            count += work()?;
        }
        let count = count as f64;
        Ok([count / begun.elapsed().as_secs_f64(), count / (cpu_time()? - idle)])
    };
    let rates = std::thread::scope(|scope| {
        let run = &run;
        let running: Vec<_> = (0..threads).map(|thread| scope.spawn(move || run(thread))).collect();
        running
            .into_iter()
            .map(|t| t.join().unwrap_or_else(|_| bail!("a thread broke off")))
            .collect::<Result<Vec<_>>>()
    })?;
    Ok([0, 1].map(|i| rates.iter().map(|r| r[i]).sum()))
}
