//! Swapped lines: channel k reads what the line `order[k]` carries.

use super::diagnosis::{Diagnosis, Evidence};
use super::{Act, CommonEffect, CommonParameters, ReadingAct, Refused, Settings, Stage};

pub(super) const EFFECT: CommonEffect = CommonEffect {
    name: "channel-order",
    what: "Channels are read in another order: each parameter names the place, from 0, from which the channel's readings come.",
    source: "swapped plugs",
    parameters: CommonParameters::Channels,
    unit: "1",
    stateful: false,
    rig: false,
    stage: Stage::Electronics,
    diagnosis: Diagnosis { evidence: Evidence::ChannelOrder, ..Diagnosis::FAMILY },
    acts,
};

fn acts(settings: &Settings<'_>) -> Result<Vec<Act>, Refused> {
    let lines = settings.skin().channels().len();
    let given = settings.channels(f64::NAN, |value| {
        let from = value.round();
        if from != value || from < 0.0 || from >= lines as f64 {
            return Err(format!("is {value} and must be a place from 0 to {}", lines - 1));
        }
        Ok(from)
    })?;
    // An order is, or is not.
    let on = settings.strength() > 0.0;
    let order: Vec<usize> = given
        .filter(|_| on)
        .unwrap_or_default()
        .into_iter()
        .enumerate()
        .map(|(k, from)| if from.is_nan() { k } else { from as usize })
        .collect();
    if order.iter().enumerate().all(|(k, from)| k == *from) {
        return Ok(Vec::new());
    }
    Ok(vec![Act::reading(Stage::Electronics, Order(order))])
}

struct Order(Vec<usize>);

impl ReadingAct for Order {
    fn apply(&self, _: f64, readings: &mut [f64]) {
        let read = readings.to_vec();
        for (r, from) in readings.iter_mut().zip(&self.0) {
            *r = read[*from];
        }
    }
}
