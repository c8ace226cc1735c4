//! Samples that stay in memory from one epoch to the next.
//!
//! Problem: inputs come from bags, which are read and decoded whole, and targets such as pictures are drawn, from 18,000 distances for each
//! contact of 15 pixels: a GPU learns from them in less time. Method: samples are kept up to a share of the memory that the machine has left
//! ([`budget`]); lists of which most numbers are 0 without their zeros ([`Packed`]), a picture of 160 × 160 pixels with six contacts in 2 to
//! 14 kB instead of 102 kB. They come back bit by bit as they were. Where they are too many, all are made anew in every epoch. Assumptions:
//! what else the machine runs leaves this much alone. Cost: one pass over the numbers to pack and to unpack.

use std::cell::Cell;

use super::conv::TensorSample;

/// Of the memory that is left, what samples may take.
const SHARE: f64 = 0.25;
/// \[bytes\] that they may take where it is not known how much is left.
const OTHERWISE: usize = 256 << 20;

/// \[bytes\] that samples may take on this machine now: a quarter of what neither other programs nor this program's control group have
/// taken; 256 MB where the system does not say.
pub(super) fn budget() -> usize {
    let read = |path: &str| std::fs::read_to_string(path).unwrap_or_default();
    let group = |name: &str| read(&format!("/sys/fs/cgroup/{name}"));
    match left(&read("/proc/meminfo"), &group("memory.max"), &group("memory.current")) {
        Some(bytes) => (bytes as f64 * SHARE) as usize,
        None => OTHERWISE,
    }
}

/// \[bytes\] that are left by what Linux says of the machine's memory and of a control group's (version 2).
fn left(machine: &str, most: &str, taken: &str) -> Option<u64> {
    let number = |text: &str| text.trim().parse::<u64>().ok();
    let available = machine.lines().find_map(|line| {
        number(line.strip_prefix("MemAvailable:")?.trim().strip_suffix("kB")?)?.checked_mul(1024)
    });
    let group = number(most).zip(number(taken)).map(|(most, taken)| most.saturating_sub(taken));
    [available, group].into_iter().flatten().min()
}

/// Numbers without their zeros, where that is shorter.
#[derive(Debug, Clone, PartialEq)]
enum Packed {
    Whole(Vec<f32>),
    /// How many there are, and those that are not 0 with their indices.
    Few(usize, Vec<(u32, f32)>),
}

impl Packed {
    fn of(values: &[f32]) -> Self {
        // Bits, because −0 and NaN come back, too.
        let other = |(i, v): (usize, &f32)| Some((u32::try_from(i).ok()?, *v)).filter(|_| v.to_bits() != 0);
        let few = values.iter().filter(|v| v.to_bits() != 0).count();
        if 2 * few < values.len() && u32::try_from(values.len()).is_ok() {
            Self::Few(values.len(), values.iter().enumerate().filter_map(other).collect())
        } else {
            Self::Whole(values.to_vec())
        }
    }

    fn values(&self) -> Vec<f32> {
        match self {
            Self::Whole(values) => values.clone(),
            Self::Few(len, few) => {
                let mut values = vec![0.0; *len];
                few.iter().for_each(|(i, v)| values[*i as usize] = *v);
                values
            }
        }
    }

    fn bytes(&self) -> usize {
        size_of::<Self>()
            + match self {
                Self::Whole(values) => size_of_val(values.as_slice()),
                Self::Few(_, few) => size_of_val(few.as_slice()),
            }
    }
}

/// A sample, packed.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct PackedSample {
    input: Vec<f32>,
    targets: Vec<Packed>,
    weights: Vec<Packed>,
}

impl PackedSample {
    fn of(sample: &TensorSample) -> Self {
        let pack = |lists: &[Vec<f32>]| lists.iter().map(|list| Packed::of(list)).collect();
        Self { input: sample.input.clone(), targets: pack(&sample.targets), weights: pack(&sample.weights) }
    }

    /// The sample.
    pub(super) fn unpack(&self) -> TensorSample {
        let unpack = |lists: &[Packed]| lists.iter().map(Packed::values).collect();
        TensorSample {
            input: self.input.clone(),
            targets: unpack(&self.targets),
            weights: unpack(&self.weights),
        }
    }

    /// \[bytes\] that it takes.
    fn bytes(&self) -> usize {
        let lists = self.targets.iter().chain(&self.weights).map(Packed::bytes).sum::<usize>();
        size_of::<Self>() + size_of_val(self.input.as_slice()) + lists
    }
}

/// Whether samples are held.
pub(super) enum Held {
    /// So many bytes were read so far, and they may still be few.
    Reading(Vec<PackedSample>, usize),
    /// All of them.
    All(Vec<PackedSample>),
    /// They are too many.
    No,
}

impl Held {
    /// None so far.
    pub(super) fn new() -> Self {
        Self::Reading(Vec::new(), 0)
    }

    /// Begins to read anew: what an earlier, interrupted reading has kept is given back to `left`.
    pub(super) fn begin(&mut self, left: &Cell<usize>) {
        if let Self::Reading(_, bytes) = self {
            left.set(left.get() + *bytes);
            *self = Self::new();
        }
    }

    /// Keeps one more sample, unless they have become too many for the bytes that are `left`.
    pub(super) fn push(&mut self, sample: &TensorSample, left: &Cell<usize>) {
        let Self::Reading(samples, bytes) = self else { return };
        let sample = PackedSample::of(sample);
        let size = sample.bytes();
        if let Some(rest) = left.get().checked_sub(size) {
            left.set(rest);
            *bytes += size;
            samples.push(sample);
        } else {
            left.set(left.get() + *bytes);
            *self = Self::No;
        }
    }

    /// All were read.
    pub(super) fn end(&mut self) {
        if let Self::Reading(samples, _) = self {
            *self = Self::All(std::mem::take(samples));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A picture of which few pixels are not 0, and a full list.
    fn sample(first: f32) -> TensorSample {
        let mut picture = vec![0.0; 1000];
        (picture[3], picture[998], picture[999]) = (first, -0.0, f32::NAN);
        TensorSample {
            input: vec![first; 4],
            targets: vec![picture, vec![1.0, 2.0, 0.0]],
            weights: vec![vec![0.0; 1000], vec![0.5; 3]],
        }
    }

    fn bits(sample: &TensorSample) -> Vec<u32> {
        let lists = sample.targets.iter().chain(&sample.weights).flatten();
        sample.input.iter().chain(lists).map(|v| v.to_bits()).collect()
    }

    #[test]
    fn samples_come_back_bit_by_bit_and_are_smaller() {
        for one in [sample(7.0), sample(f32::NEG_INFINITY), TensorSample::default()] {
            assert_eq!(bits(&PackedSample::of(&one).unpack()), bits(&one));
        }
        assert!(PackedSample::of(&sample(7.0)).bytes() < 500);
    }

    #[test]
    fn samples_are_held_up_to_the_budget_and_then_none_of_them() {
        let size = PackedSample::of(&sample(1.0)).bytes();
        let left = Cell::new(3 * size);
        let mut held = Held::new();
        // A sample of 0 has no number in it, and is smaller.
        (1..3).for_each(|i| held.push(&sample(i as f32), &left));
        assert_eq!(left.get(), size);
        // An interrupted reading gives back what it kept.
        held.begin(&left);
        assert_eq!(left.get(), 3 * size);
        (0..3).for_each(|i| held.push(&sample(1.0 + i as f32), &left));
        held.end();
        let Held::All(samples) = &held else { panic!("three fit") };
        assert_eq!(bits(&samples[2].unpack()), bits(&sample(3.0)));
        // Another reader shares the budget.
        let mut other = Held::new();
        other.push(&sample(1.0), &left);
        assert!(matches!(other, Held::No));
        other.begin(&left);
        other.end();
        assert!(matches!(other, Held::No) && left.get() == 0);
    }

    #[test]
    fn what_is_left_is_the_least_that_the_system_says() {
        let machine = "MemTotal:       24000000 kB\nMemAvailable:    2000000 kB\nBuffers:  1 kB\n";
        assert_eq!(left(machine, "max\n", "5\n"), Some(2_048_000_000));
        assert_eq!(left(machine, "1000\n", "400\n"), Some(600));
        assert_eq!(left(machine, "400\n", "1000\n"), Some(0));
        assert_eq!(left("", "", ""), None);
        assert!(budget() > 0);
    }
}
