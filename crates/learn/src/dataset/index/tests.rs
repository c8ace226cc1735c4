use std::collections::BTreeSet;

use proptest::prelude::*;

use super::*;
use crate::dataset::tests::{STEP, contact};

/// What is said of a frame: nothing, untouched (and idle), or a touch of a press.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Said {
    Nothing,
    Untouched(bool),
    Touched(u64),
}

fn truth(said: Said) -> Option<Truth> {
    match said {
        Said::Nothing => None,
        Said::Untouched(idle) => Some(Truth { press: 0, location: 0, idle, contacts: Vec::new() }),
        Said::Touched(press) => {
            let contacts = vec![contact(0.001, 0.0, 1.0)];
            Some(Truth { press, location: press as u32, idle: false, contacts })
        }
    }
}

fn indexed(said: &[Said], share: Share) -> (Vec<FrameInfo>, Option<Arc<Between>>, Counts) {
    let flags: Arc<[ChannelFlags]> = [].into();
    let mut index = Indexer::new(share, Some(3e-9 * STEP as f64), said.len());
    for (k, said) in said.iter().enumerate() {
        index.push(k as i64 * STEP, Arc::clone(&flags), truth(*said));
    }
    index.finish()
}

/// Stretches of frames of which the same is said; a press has a number of its own, and may be interrupted.
fn recordings() -> impl Strategy<Value = Vec<Said>> {
    let part = (0_u8..5, 1_usize..12);
    proptest::collection::vec(part, 0..40).prop_map(|parts| {
        let (mut all, mut press) = (Vec::new(), 0);
        for (kind, count) in parts {
            let said = match kind {
                0 => Said::Nothing,
                1 => Said::Untouched(false),
                2 => Said::Untouched(true),
                _ => {
                    press += u64::from(kind == 3);
                    Said::Touched(press)
                }
            };
            all.extend(std::iter::repeat_n(said, count));
        }
        all
    })
}

/// Frames from which on the zero is taken anew: the first of those that are idle for three steps.
fn tares(said: &[Said]) -> BTreeSet<usize> {
    let idle = |k: usize| said.get(k) == Some(&Said::Untouched(true));
    let begins = |k: usize| idle(k) && (k == 0 || !idle(k - 1));
    (0..said.len()).filter(|k| begins(*k) && (0..4).all(|more| idle(k + more))).collect()
}

fn presses<'a>(said: impl Iterator<Item = &'a Said>) -> BTreeSet<u64> {
    said.filter_map(|said| if let Said::Touched(press) = said { Some(*press) } else { None }).collect()
}

proptest! {
    #[test]
    fn an_index_of_all_frames_is_what_was_said(said in recordings()) {
        let (samples, between, counts) = indexed(&said, Share::ALL);
        prop_assert!(between.is_none());
        prop_assert_eq!((counts.frames, samples.len()), (said.len(), said.len()));
        let tares = tares(&said);
        for (k, sample) in samples.iter().enumerate() {
            prop_assert_eq!((sample.number as usize, sample.stamp), (k, k as i64 * STEP));
            prop_assert_eq!(&sample.truth, &truth(said[k]));
            prop_assert_eq!(sample.tare, tares.contains(&k), "frame {}", k);
        }
    }

    #[test]
    fn a_thinned_index_keeps_order_and_presses_and_what_the_zero_needs(
        said in recordings(), every in 2_usize..30,
    ) {
        let share = Share { every, spare: 1000, stretches: 1000 };
        let (samples, between, counts) = indexed(&said, share);
        let (whole, _, all) = indexed(&said, Share::ALL);
        prop_assert_eq!((counts, counts.presses_left_out), (all, 0));
        prop_assert!(samples.iter().is_sorted_by_key(|s| s.number));
        // Each is the frame that it would be without thinning.
        for sample in &samples {
            prop_assert_eq!(sample, &whole[sample.number as usize]);
        }
        let even = samples.iter().filter(|s| (s.number as usize).is_multiple_of(every)).count();
        prop_assert_eq!(even, said.len().div_ceil(every));
        let numbers = || samples.iter().map(|s| s.number as usize);
        prop_assert_eq!(presses(numbers().map(|k| &said[k])), presses(said.iter()));
        prop_assert!(samples.len() - even <= presses(said.iter()).len());
        let Some(between) = between else { return Ok(()) };
        let (tares, mut at) = (tares(&said), 0);
        prop_assert_eq!((between.frames, between.tares()), (said.len(), tares.len()));
        for (k, said) in said.iter().enumerate() {
            let wanted = (tares.contains(&k), matches!(said, Said::Untouched(_)));
            prop_assert_eq!(between.of_frame(k, &mut at), wanted, "frame {}", k);
        }
        // The same again.
        prop_assert_eq!(&indexed(&said, share).0, &samples);
    }

    #[test]
    fn lists_are_bounded_whatever_comes(
        said in recordings(), every in 2_usize..30, spare in 0_usize..6, stretches in 0_usize..6,
    ) {
        let (samples, between, counts) = indexed(&said, Share { every, spare, stretches });
        let extra = samples.iter().filter(|s| !(s.number as usize).is_multiple_of(every)).count();
        prop_assert!(extra <= spare.max(2) && samples.iter().is_sorted_by_key(|s| s.number));
        prop_assert!(between.is_none_or(|between| between.stretches.len() <= stretches.max(2)));
        let kept = presses(samples.iter().map(|s| &said[s.number as usize]));
        // A press that was interrupted by another one counts twice.
        prop_assert!(presses(said.iter()).len() - kept.len() <= counts.presses_left_out);
    }

    #[test]
    fn a_sparse_list_is_even_and_bounded(most in 0_usize..20, count in 0_usize..200) {
        let mut sparse = Sparse::new(most);
        (0..count).for_each(|i| sparse.push(i));
        let list = sparse.list();
        prop_assert!(list.len() <= most.max(2) && list.len() + sparse.left_out() == count);
        prop_assert!(list.iter().enumerate().all(|(i, v)| *v == i * sparse.step));
        prop_assert_eq!(list.len(), count.div_ceil(sparse.step));
    }

    #[test]
    fn a_plan_keeps_to_its_bound(
        most in 1_usize..2000, frames in proptest::collection::vec(0_usize..100_000, 1..5),
    ) {
        let (plan, total) = (Plan::new(most, &frames), frames.iter().sum::<usize>());
        prop_assert_eq!(plan.every == 1, total <= most);
        let of = |n: &usize| { let share = plan.share(*n); n.div_ceil(share.every) + share.spare };
        prop_assert!(frames.iter().map(of).sum::<usize>() <= most + frames.len());
    }
}
