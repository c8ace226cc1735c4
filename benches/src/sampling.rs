//! How many samples a forward model gives.

use std::sync::Barrier;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
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

/// Samples per second of all threads, by the clock and by their CPU time: response, noise, range, and where `maps` are asked for the
/// displacement of every point.
pub fn sample(
    model: &dyn ForwardModel,
    skin: &SkinDescription,
    stimuli: &[Stimulus],
    maps: bool,
    seconds: f64,
    threads: usize,
) -> Result<[f64; 2]> {
    let duration = Duration::from_secs_f64(seconds);
    let barrier = Barrier::new(threads);
    let ranges: Vec<[f64; 2]> =
        skin.channels().iter().map(|c| c.range.unwrap_or([f64::MIN, f64::MAX])).collect();
    let rates = std::thread::scope(|scope| {
        let work = |seed: usize| {
            let (barrier, ranges) = (&barrier, &ranges);
            move || -> Result<[f64; 2]> {
                let mut rng = ChaCha8Rng::seed_from_u64(seed as u64);
                let mut clean = vec![0.0; model.channels()];
                let (mut values, mut count) = (vec![0.0f32; model.channels()], 0);
                let mut map = vec![0.0; if maps { model.surface().points.len() } else { 0 }];
                barrier.wait();
                let (begun, idle) = (Instant::now(), cpu_time()?);
                let mut batches = stimuli.chunks(BATCH).cycle();
                while begun.elapsed() < duration {
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
                    count += batch.len();
                }
                let count = count as f64;
                Ok([count / begun.elapsed().as_secs_f64(), count / (cpu_time()? - idle)])
            }
        };
        let running: Vec<_> = (0..threads).map(|seed| scope.spawn(work(seed))).collect();
        running
            .into_iter()
            .map(|t| t.join().unwrap_or_else(|_| bail!("a thread broke off")))
            .collect::<Result<Vec<_>>>()
    })?;
    Ok([0, 1].map(|i| rates.iter().map(|r| r[i]).sum()))
}
