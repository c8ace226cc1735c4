//! Which electrodes are driven and read.

/// The adjacent (Sheffield) pattern: a current goes in at electrode k and out at k + 1, and voltages are read between m and m + 1, for
/// every k and every m that has no driven electrode (B. H. Brown, A. D. Seagar, *The Sheffield data collection system*, Clin. Phys.
/// Physiol. Meas. 8A, 1987). Electrodes are counted round the rim.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Adjacent {
    /// Electrodes.
    pub electrodes: usize,
}

impl Adjacent {
    /// Electrodes between which a current flows, in and out.
    #[must_use]
    pub fn drive(self, k: usize) -> (usize, usize) {
        (k % self.electrodes, (k + 1) % self.electrodes)
    }

    /// Readings of a frame as (drive, first of the electrodes that are read), drive by drive, each beginning behind the drive.
    pub fn readings(self) -> impl Iterator<Item = (usize, usize)> {
        let n = self.electrodes;
        (0..n).flat_map(move |k| (2..n.saturating_sub(1)).map(move |step| (k, (k + step) % n)))
    }

    /// Readings in a frame.
    #[must_use]
    pub fn len(self) -> usize {
        self.electrodes * self.electrodes.saturating_sub(3)
    }

    /// Whether there are too few electrodes for one reading.
    #[must_use]
    pub fn is_empty(self) -> bool {
        self.len() == 0
    }

    /// A frame in the order of [`readings`](Self::readings) of the electrodes' potentials, one row a drive.
    #[must_use]
    pub fn frame(self, potentials: &[Vec<f64>]) -> Vec<f64> {
        self.readings().map(|(k, m)| potentials[k][m] - potentials[k][(m + 1) % self.electrodes]).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_of_16_electrodes_has_208_readings() {
        let pattern = Adjacent { electrodes: 16 };
        let all: Vec<_> = pattern.readings().collect();
        assert_eq!((all.len(), pattern.len(), pattern.is_empty()), (208, 208, false));
        assert_eq!((all[0], all[12], all[13]), ((0, 2), (0, 14), (1, 3)));
        for (k, m) in all {
            let (source, sink) = pattern.drive(k);
            assert!(![m, (m + 1) % 16].iter().any(|e| [source, sink].contains(e)));
        }
        assert!(Adjacent { electrodes: 3 }.is_empty());
    }
}
