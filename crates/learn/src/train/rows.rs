//! How many rows a dense network is fitted to.
//!
//! Problem: a dense network is fitted to rows in memory, in random order and many times over. Method: where those to learn from would take
//! more than [`MOST_BYTES`], every k-th of them is taken, in order of time. Assumption: frames that follow each other tell nearly the same.

/// \[bytes\] that rows take at most, counted as below: half the memory of a machine with 8 GiB. 4 million rows of 25 inputs and 3 outputs take 0.9 GB;
/// 0.7 million of 784 inputs take all of it.
const MOST_BYTES: usize = 4 << 30;

/// Of how many rows one is taken, where there are so many of so many inputs and outputs: 1 where all are.
pub(super) fn every(rows: usize, inputs: usize, outputs: usize) -> usize {
    // Inputs are there twice while they are prepared; each target has a weight.
    let bytes = 2 * size_of::<f32>() * (inputs + outputs);
    rows.div_ceil((MOST_BYTES / bytes.max(1)).max(1)).max(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_left_out_where_they_would_fill_the_memory() {
        assert_eq!([every(0, 25, 3), every(4_000_000, 25, 3), every(600_000, 784, 3)], [1; 3]);
        for (rows, inputs) in [(4_000_000, 784), (4_000_000, 1500), (usize::MAX / 2, 1)] {
            let every = every(rows, inputs, 4);
            assert!(every > 1);
            let bytes = |every| rows.div_ceil(every) * 8 * (inputs + 4);
            assert!(bytes(every) <= MOST_BYTES, "{rows} rows of {inputs}, every {every}");
        }
        assert_eq!(every(4_000_000, 784, 4), 6);
    }
}
