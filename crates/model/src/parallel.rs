//! The same work on many things at a time.

use std::sync::atomic::{AtomicUsize, Ordering};

/// Pieces that each thread takes of the work, roughly: few are cheap to take, many are evenly spread.
const PIECES: usize = 16;

/// What `of` says of each of `count` numbers from 0 on, in their order, by as many threads as this one may use processors.
pub fn in_parallel<T: Send>(count: usize, of: impl Fn(usize) -> T + Sync) -> Vec<T> {
    let threads = std::thread::available_parallelism().map_or(1, usize::from).min(count);
    let piece = count.div_ceil(threads.max(1) * PIECES).max(1);
    let next = AtomicUsize::new(0);
    let mut found: Vec<(usize, Vec<T>)> = std::thread::scope(|scope| {
        let one = || {
            let mut mine = Vec::new();
            loop {
                let from = next.fetch_add(piece, Ordering::Relaxed);
                if from >= count {
                    return mine;
                }
                mine.push((from, (from..(from + piece).min(count)).map(&of).collect()));
            }
        };
        let running: Vec<_> = (0..threads).map(|_| scope.spawn(one)).collect();
        // A thread that panics takes this one with it.
        let done = |thread: std::thread::ScopedJoinHandle<'_, _>| {
            thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
        };
        running.into_iter().flat_map(done).collect()
    });
    found.sort_unstable_by_key(|(from, _)| *from);
    found.into_iter().flat_map(|(_, part)| part).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn answers_come_in_order() {
        for count in [0, 1, 2, 31, 1000] {
            let expected: Vec<usize> = (0..count).map(|i| 2 * i).collect();
            assert_eq!(in_parallel(count, |i| 2 * i), expected);
        }
    }

    #[test]
    #[should_panic(expected = "seven")]
    fn a_panic_is_the_callers() {
        in_parallel(20, |i| assert_ne!(i, 7, "seven"));
    }
}
