//! Products of dense matrices.

/// c = a · b, or c += a · b.
#[derive(Clone, Copy)]
pub(crate) struct Product {
    pub(crate) rows: usize,
    pub(crate) inner: usize,
    pub(crate) columns: usize,
    /// Adds to what is in c.
    pub(crate) keep: bool,
}

impl Product {
    /// Matrices come with the distance between rows and between columns; c is row-major.
    pub(crate) fn run(self, a: &[f32], a_steps: [usize; 2], b: &[f32], b_steps: [usize; 2], c: &mut [f32]) {
        let Self { rows, inner, columns, keep } = self;
        let reach = |rows: usize, columns: usize, steps: [usize; 2]| {
            (rows.max(1) - 1) * steps[0] + (columns.max(1) - 1) * steps[1] + 1
        };
        assert!(a.len() >= reach(rows, inner, a_steps) || rows * inner == 0, "a is too short");
        assert!(b.len() >= reach(inner, columns, b_steps) || inner * columns == 0, "b is too short");
        assert!(c.len() >= rows * columns, "c is too short");
        let [ars, acs, brs, bcs, crs] =
            [a_steps[0], a_steps[1], b_steps[0], b_steps[1], columns].map(usize::cast_signed);
        // SAFETY: every index that the product reads or writes lies in its slice, as asserted above, and c is
        // borrowed mutably, so that it overlaps neither a nor b.
        unsafe {
            matrixmultiply::sgemm(
                rows,
                inner,
                columns,
                1.0,
                a.as_ptr(),
                ars,
                acs,
                b.as_ptr(),
                brs,
                bcs,
                if keep { 1.0 } else { 0.0 },
                c.as_mut_ptr(),
                crs,
                1,
            );
        }
    }
}
