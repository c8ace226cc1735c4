//! Dead time: readings of a while ago, linear between frames; before the first frame, as in it.

use std::collections::VecDeque;

use dermis_skin::ParameterInfo;

use super::diagnosis::{Diagnosis, FORWARDS, FreeNumber, Variation};
use super::{Act, Circumstances, CommonEffect, CommonParameters, Refused, Settings, Stage, StatefulAct};

pub(super) const EFFECT: CommonEffect = CommonEffect {
    name: "delay",
    what: "Readings come late against the ground truth.",
    source: "dead time of a chain of measurement",
    parameters: CommonParameters::Named(&[ParameterInfo::new(
        "time",
        "s",
        "by which they are late",
        0.0,
        [0.0, 0.1],
        [0.0, f64::INFINITY],
    )]),
    unit: "s",
    stateful: true,
    rig: false,
    stage: Stage::Electronics,
    diagnosis: Diagnosis {
        limits: FORWARDS,
        free: &[FreeNumber::LAG],
        ..Diagnosis::simulated(&[Variation::frames("time", 1.0), Variation::frames("time", 5.0)])
    },
    acts,
};

fn acts(settings: &Settings<'_>) -> Result<Vec<Act>, Refused> {
    let by = settings.duration("time")?;
    if by == 0.0 {
        return Ok(Vec::new());
    }
    Ok(vec![Act::remembers(Stage::Electronics, Delay { by, frames: VecDeque::new() })])
}

#[derive(Clone)]
struct Delay {
    /// \[s\]
    by: f64,
    /// Time and readings, as far back as needed.
    frames: VecDeque<(f64, Vec<f64>)>,
}

impl StatefulAct for Delay {
    fn apply(&mut self, now: &Circumstances, readings: &mut [f64]) {
        let at = now.time - self.by;
        while self.frames.len() > 1 && self.frames[1].0 <= at {
            self.frames.pop_front();
        }
        self.frames.push_back((now.time, readings.to_vec()));
        let after = self.frames.partition_point(|(t, _)| *t < at);
        match (after.checked_sub(1), self.frames.get(after)) {
            (Some(before), Some((t1, next))) => {
                let (t0, ago) = &self.frames[before];
                let part = (at - t0) / (t1 - t0);
                for ((r, a), n) in readings.iter_mut().zip(ago).zip(next) {
                    *r = a + (n - a) * part;
                }
            }
            (None, Some((_, next))) => readings.copy_from_slice(next),
            (_, None) => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// What was read at `at` \[s\], between frames linearly, and before the first as in it.
    fn history(frames: &[(f64, f64)], at: f64) -> f64 {
        let after = frames.iter().position(|(t, _)| *t >= at).unwrap_or(frames.len() - 1);
        let (t1, b) = frames[after];
        if after == 0 || t1 < at {
            return b;
        }
        let (t0, a) = frames[after - 1];
        a + (b - a) * (at - t0) / (t1 - t0)
    }

    proptest! {
        #[test]
        fn every_reading_is_the_one_of_a_while_ago(
            by in 0.001..0.2_f64,
            frames in prop::collection::vec((0.001..0.05_f64, -1.0..1.0_f64), 2..60),
        ) {
            let mut delay = Delay { by, frames: VecDeque::new() };
            let (mut time, mut all) = (0.0, Vec::new());
            for (step, value) in frames {
                time += step;
                all.push((time, value));
                let mut readings = [value, 2.0 * value];
                delay.apply(&Circumstances { time, touched: false }, &mut readings);
                let wanted = history(&all, time - by);
                prop_assert!((readings[0] - wanted).abs() < 1e-9, "{readings:?} is not {wanted}");
                prop_assert!((readings[1] - 2.0 * wanted).abs() < 1e-9);
                // Nothing is kept that is too old to matter: one frame before the delay and all since.
                let since = all.iter().filter(|(t, _)| *t > time - by).count();
                prop_assert!(delay.frames.len() <= since + 2, "{} frames are kept", delay.frames.len());
            }
        }
    }
}
