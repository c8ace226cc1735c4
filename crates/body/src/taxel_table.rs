//! Tables of taxel positions, as the skins of the iCub have them (`skinGui/conf/positions`).
//!
//! A line `[calibration]`, then one line a taxel: x y z \[m\] and the normal, in the frame of the link. A line of zeros keeps the place
//! of a taxel that is not there. What stands before that line, or has no number, is skipped; a normal of length 0 is not known.

use nalgebra::{Point3, Vector3};

/// \[m\] farthest that a taxel can be from the origin of its link.
const FARTHEST: f64 = 10.0;

/// A taxel of a table.
#[derive(Debug, Clone, PartialEq)]
pub struct TableTaxel {
    /// Its line behind `[calibration]`, from 0: the index of its value in a frame.
    pub index: usize,
    /// \[m\]
    pub position: Point3<f64>,
    /// Unit, out of the skin; `None` where the table does not say it.
    pub normal: Option<Vector3<f64>>,
}

/// Reads a table; taxels that are not there are left out.
///
/// # Errors
///
/// One sentence with the line, where a line is no taxel or nothing is a table.
pub fn read(text: &str) -> Result<Vec<TableTaxel>, String> {
    let mut lines = text.lines().enumerate();
    if !lines.any(|(_, line)| line.trim() == "[calibration]") {
        return Err("has no line `[calibration]`, behind which a table of taxels begins".into());
    }
    let mut taxels = Vec::new();
    let mut index = 0;
    for (number, line) in lines {
        if line.trim().is_empty() {
            continue;
        }
        let wrong = |what: &str| format!("line {}: {what}; write x y z [m] and the normal", number + 1);
        let numbers: Option<Vec<f64>> = line.split_whitespace().map(|word| word.parse().ok()).collect();
        let numbers = numbers.ok_or_else(|| wrong("is not six numbers"))?;
        let [x, y, z, nx, ny, nz] = *numbers.as_slice() else { return Err(wrong("is not six numbers")) };
        let (position, normal) = (Point3::new(x, y, z), Vector3::new(nx, ny, nz));
        if !position.iter().all(|v| v.abs() <= FARTHEST) || !normal.iter().all(|v| v.is_finite()) {
            return Err(wrong("is no place on a robot"));
        }
        if position != Point3::origin() || normal != Vector3::zeros() {
            taxels.push(TableTaxel { index, position, normal: normal.try_normalize(1e-3) });
        }
        index += 1;
    }
    if taxels.is_empty() {
        return Err("has no taxel".into());
    }
    Ok(taxels)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn absent_taxels_keep_their_index() {
        let text = "name chest\n[calibration]\n0 0 0 0 0 0\n0.01 -0.02 0.03 0 0 2\n\n0.01 0 0.5 0 0 0\n";
        let taxels = read(text).unwrap();
        assert_eq!(taxels.iter().map(|t| t.index).collect::<Vec<_>>(), [1, 2]);
        assert_eq!(taxels[0].normal, Some(Vector3::z()));
        assert_eq!(taxels[1].normal, None);
    }

    #[test]
    fn lines_that_cannot_be_are_named() {
        insta::assert_snapshot!(read("0 0 0 0 0 1").unwrap_err(), @"has no line `[calibration]`, behind which a table of taxels begins");
        insta::assert_snapshot!(read("[calibration]\n1 2 3").unwrap_err(), @"line 2: is not six numbers; write x y z [m] and the normal");
        insta::assert_snapshot!(read("[calibration]\n1 2 300 0 0 1").unwrap_err(), @"line 2: is no place on a robot; write x y z [m] and the normal");
        insta::assert_snapshot!(read("[calibration]\n0 0 0 0 0 0").unwrap_err(), @"has no taxel");
    }
}
