//! Numeric variables of MATLAB files of level 5 (versions 5 to 7.2; MathWorks, "MAT-File Format", 2019).
//!
//! Problem: a file is a row of tagged elements; one that is a matrix holds flags, dimensions, a name, and real and imaginary parts, each an
//! element again, and may be compressed as a whole. Method: elements are read one after the other from bytes in memory. Numbers of all ten types become `f64`;
//! texts, cells, structures, objects and sparse matrices are left out. Assumptions: little-endian, as every platform of today writes; level 4 and
//! version 7.3 (HDF5) are refused. Cost: a copy of the numbers; at most [`MOST_BYTES`] are unpacked of all elements together, so that
//! a short file cannot fill the memory.
//!
//! The crates for this were judged at `matrw` 0.1.4 and `matreader` 0.1.0, which unpack without a limit (the first panics on damaged data), and
//! `matfile` 0.5, which calls itself alpha, was last released in 2024 and prints to standard error.

use std::io::Read as _;
use std::path::Path;

use super::ImportError;

/// Bytes that compressed elements may unpack to.
const MOST_BYTES: u64 = 64 << 20;
/// Length of the head of a file.
const HEAD: usize = 128;

// Types of elements.
const INT8: u32 = 1;
const UINT8: u32 = 2;
const INT16: u32 = 3;
const UINT16: u32 = 4;
const INT32: u32 = 5;
const UINT32: u32 = 6;
const SINGLE: u32 = 7;
const DOUBLE: u32 = 9;
const INT64: u32 = 12;
const UINT64: u32 = 13;
const MATRIX: u32 = 14;
const COMPRESSED: u32 = 15;

/// Classes of matrices that hold numbers: double, single, and whole numbers of 8 to 64 bits.
const NUMERIC: std::ops::RangeInclusive<u8> = 6..=15;
/// The flag of a matrix with an imaginary part.
const COMPLEX: u8 = 0x08;

/// A matrix of numbers.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Variable {
    pub name: String,
    /// Numbers along the first dimension.
    pub rows: usize,
    /// Numbers along all others together.
    pub columns: usize,
    /// Column by column.
    pub real: Vec<f64>,
    /// As `real`, where the variable is complex.
    pub imaginary: Option<Vec<f64>>,
}

/// Whether a file begins as one of MATLAB's does from version 5 on.
pub(super) fn recognises(start: &[u8]) -> bool {
    start.starts_with(b"MATLAB ")
}

/// The numeric variables of a file, in its order.
///
/// # Errors
///
/// File, variable, and what is wrong.
pub(super) fn variables(file: &Path, bytes: &[u8]) -> Result<Vec<Variable>, ImportError> {
    let (head, body) = bytes.split_at_checked(HEAD).unwrap_or_default();
    if !(head.starts_with(b"MATLAB 5.0") && head.ends_with(b"IM")) {
        let problem = "is no little-endian MATLAB file of level 5; save it again with `save -v7`";
        return Err(ImportError::file(file, problem));
    }
    let mut reader = Reader { file, unpacked: 0, found: Vec::new() };
    reader.elements(body)?;
    Ok(reader.found)
}

struct Reader<'a> {
    file: &'a Path,
    /// Bytes that were unpacked so far.
    unpacked: u64,
    found: Vec<Variable>,
}

/// An element: its type and its content.
type Element<'a> = (u32, &'a [u8]);

/// Takes an element from the front of `bytes`; `None` where it is cut short.
fn take<'a>(bytes: &mut &'a [u8]) -> Option<Element<'a>> {
    let (tag, rest) = bytes.split_at_checked(8)?;
    let number = |at: usize| Some(u32::from_le_bytes(tag.get(at..at + 4)?.try_into().ok()?));
    let (kind, length) = (number(0)?, number(4)?);
    if kind >> 16 != 0 {
        // Up to four bytes lie in the tag itself.
        *bytes = rest;
        return Some((kind & 0xffff, tag.get(4..)?.get(..(kind >> 16) as usize)?));
    }
    let length = usize::try_from(length).ok()?;
    let (content, rest) = rest.split_at_checked(length)?;
    // All but what is compressed ends at a multiple of eight; the last one may lack what fills it up.
    let filling = if kind == COMPRESSED { 0 } else { length.next_multiple_of(8) - length };
    *bytes = rest.get(filling..).unwrap_or_default();
    Some((kind, content))
}

impl Reader<'_> {
    fn wrong(&self, at: &str, problem: impl Into<String>) -> ImportError {
        ImportError::Value { path: self.file.into(), at: at.to_owned(), problem: problem.into() }
    }

    fn elements(&mut self, mut rest: &[u8]) -> Result<(), ImportError> {
        while !rest.is_empty() {
            let number = self.found.len() + 1;
            let (kind, content) = take(&mut rest)
                .ok_or_else(|| self.wrong(&format!("behind {} variables", number - 1), "is cut short"))?;
            match kind {
                MATRIX => self.matrix(content)?,
                COMPRESSED => {
                    let unpacked = self.unpack(content)?;
                    let mut inner = unpacked.as_slice();
                    if let Some((MATRIX, content)) = take(&mut inner) {
                        self.matrix(content)?;
                    }
                }
                _ => {}
            }
        }
        Ok(())
    }

    fn unpack(&mut self, content: &[u8]) -> Result<Vec<u8>, ImportError> {
        let at = format!("compressed variable {}", self.found.len() + 1);
        let mut bytes = Vec::new();
        let left = MOST_BYTES - self.unpacked;
        flate2::read::ZlibDecoder::new(content)
            .take(left + 1)
            .read_to_end(&mut bytes)
            .map_err(|error| self.wrong(&at, format!("cannot be unpacked: {error}")))?;
        if bytes.len() as u64 > left {
            return Err(self.wrong(&at, format!("unpacks to more than {MOST_BYTES} bytes")));
        }
        self.unpacked += bytes.len() as u64;
        Ok(bytes)
    }

    /// Keeps a matrix, where it is one of numbers.
    fn matrix(&mut self, mut rest: &[u8]) -> Result<(), ImportError> {
        let nameless = format!("variable {}", self.found.len() + 1);
        let mut next = |what: &str, at: &str| {
            take(&mut rest).ok_or_else(|| self.wrong(at, format!("has no {what}: the file is cut short")))
        };
        let (_, flags) = next("flags", &nameless)?;
        let (Some(class), Some(bits)) = (flags.first().copied(), flags.get(1).copied()) else {
            return Err(self.wrong(&nameless, "has no flags: the file is damaged"));
        };
        let (_, dimensions) = next("dimensions", &nameless)?;
        let (_, name) = next("name", &nameless)?;
        if !NUMERIC.contains(&class) {
            return Ok(());
        }
        let name = String::from_utf8_lossy(name).into_owned();
        let at = format!("variable `{name}`");
        let sizes: Vec<usize> = dimensions
            .as_chunks::<4>()
            .0
            .iter()
            .map(|size| usize::try_from(i32::from_le_bytes(*size)).unwrap_or(usize::MAX))
            .collect();
        let count = sizes.iter().try_fold(1_usize, |product, size| product.checked_mul(*size));
        let real = next("numbers", &at)?;
        let imaginary = if bits & COMPLEX == 0 { None } else { Some(next("imaginary part", &at)?) };
        let numbers = |(kind, content): Element<'_>| -> Result<Vec<f64>, ImportError> {
            let numbers = decoded(kind, content)
                .ok_or_else(|| self.wrong(&at, format!("has numbers of type {kind}")))?;
            if count != Some(numbers.len()) {
                let problem = format!(
                    "has {} numbers where its dimensions are {sizes:?}: the file is damaged",
                    numbers.len()
                );
                return Err(self.wrong(&at, problem));
            }
            Ok(numbers)
        };
        let (real, imaginary) = (numbers(real)?, imaginary.map(numbers).transpose()?);
        let rows = sizes.first().copied().unwrap_or(0);
        let columns = real.len().checked_div(rows).unwrap_or(0);
        self.found.push(Variable { name, rows, columns, real, imaginary });
        Ok(())
    }
}

/// Numbers as they are stored; `None` for a type that holds none.
fn decoded(kind: u32, bytes: &[u8]) -> Option<Vec<f64>> {
    fn each<const N: usize>(bytes: &[u8], number: impl Fn([u8; N]) -> f64) -> Vec<f64> {
        bytes.as_chunks::<N>().0.iter().map(|bytes| number(*bytes)).collect()
    }
    Some(match kind {
        INT8 => each(bytes, |b| i8::from_le_bytes(b).into()),
        UINT8 => each(bytes, |b| u8::from_le_bytes(b).into()),
        INT16 => each(bytes, |b| i16::from_le_bytes(b).into()),
        UINT16 => each(bytes, |b| u16::from_le_bytes(b).into()),
        INT32 => each(bytes, |b| i32::from_le_bytes(b).into()),
        UINT32 => each(bytes, |b| u32::from_le_bytes(b).into()),
        SINGLE => each(bytes, |b| f32::from_le_bytes(b).into()),
        DOUBLE => each(bytes, f64::from_le_bytes),
        INT64 => each(bytes, |b| i64::from_le_bytes(b) as f64),
        UINT64 => each(bytes, |b| u64::from_le_bytes(b) as f64),
        _ => return None,
    })
}

#[cfg(test)]
pub(super) mod tests {
    use std::io::Write as _;

    use super::*;

    fn element(kind: u32, content: &[u8]) -> Vec<u8> {
        let mut out = [kind.to_le_bytes(), (content.len() as u32).to_le_bytes()].concat();
        out.extend_from_slice(content);
        if kind != COMPRESSED {
            out.resize(out.len().next_multiple_of(8), 0);
        }
        out
    }

    /// A matrix of `columns` columns of doubles.
    pub(in crate::import) fn matrix(
        name: &str,
        columns: usize,
        real: &[f64],
        imaginary: Option<&[f64]>,
    ) -> Vec<u8> {
        let doubles = |values: &[f64]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
        let sizes = [real.len() / columns, columns].map(|size| (size as i32).to_le_bytes()).concat();
        let flags = [6, if imaginary.is_some() { COMPLEX } else { 0 }, 0, 0, 0, 0, 0, 0];
        let mut parts = [
            element(UINT32, &flags),
            element(INT32, &sizes),
            element(INT8, name.as_bytes()),
            element(DOUBLE, &doubles(real)),
        ]
        .concat();
        parts.extend(imaginary.map(|values| element(DOUBLE, &doubles(values))).unwrap_or_default());
        element(MATRIX, &parts)
    }

    pub(in crate::import) fn file(elements: &[Vec<u8>]) -> Vec<u8> {
        let mut head = b"MATLAB 5.0 MAT-file".to_vec();
        head.resize(HEAD - 4, b' ');
        head.extend(b"\x00\x01IM");
        head.extend(elements.concat());
        head
    }

    pub(in crate::import) fn compressed(element: &[u8]) -> Vec<u8> {
        let mut encoder = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::fast());
        encoder.write_all(element).unwrap();
        self::element(COMPRESSED, &encoder.finish().unwrap())
    }

    fn read(bytes: &[u8]) -> Result<Vec<Variable>, String> {
        variables(Path::new("a.mat"), bytes).map_err(|error| error.to_string())
    }

    #[test]
    fn plain_and_compressed_matrices_are_read_and_texts_left_out() {
        let real = [1.0, -2.5, 3.0, 4.0, 5.0, 6e300];
        let imaginary = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0];
        let text = [
            element(UINT32, &[4, 0, 0, 0, 0, 0, 0, 0]),
            element(INT32, &[1, 0, 0, 0, 2, 0, 0, 0]),
            element(INT8, b"description"),
            element(UINT16, &[b'o', 0, b'k', 0]),
        ];
        let elements = [
            element(MATRIX, &text.concat()),
            matrix("plain", 2, &real, None),
            compressed(&matrix("both", 3, &real, Some(&imaginary))),
        ];
        let found = read(&file(&elements)).unwrap();
        assert_eq!(found.iter().map(|v| v.name.as_str()).collect::<Vec<_>>(), ["plain", "both"]);
        assert_eq!((found[0].rows, found[0].columns, found[0].imaginary.as_ref()), (3, 2, None));
        assert_eq!((found[1].rows, found[1].columns), (2, 3));
        assert_eq!((&found[1].real[..], found[1].imaginary.as_deref()), (&real[..], Some(&imaginary[..])));
    }

    #[test]
    fn numbers_are_stored_in_the_shortest_type_and_short_ones_in_the_tag() {
        // [3, 258] as doubles, stored as whole numbers of 16 bits within the tag; so is the name.
        let small = |kind: u32, content: &[u8]| {
            let mut out = (kind | (content.len() as u32) << 16).to_le_bytes().to_vec();
            out.extend_from_slice(content);
            out.resize(8, 0);
            out
        };
        let parts = [
            element(UINT32, &[6, 0, 0, 0, 0, 0, 0, 0]),
            element(INT32, &[1, 0, 0, 0, 2, 0, 0, 0]),
            small(INT8, b"v"),
            small(INT16, &[3, 0, 2, 1]),
        ];
        let found = read(&file(&[element(MATRIX, &parts.concat())])).unwrap();
        assert_eq!((found[0].name.as_str(), &found[0].real[..]), ("v", &[3.0, 258.0][..]));
    }

    #[test]
    fn damaged_files_are_refused_by_variable() {
        let refused = |bytes: &[u8]| read(bytes).unwrap_err();
        insta::assert_snapshot!(refused(b"MATLAB 7.3 MAT-file"), @"a.mat: is no little-endian MATLAB file of level 5; save it again with `save -v7`");
        let whole = file(&[matrix("v", 1, &[1.0, 2.0], None)]);
        insta::assert_snapshot!(refused(&whole[..whole.len() - 8]), @"a.mat, behind 0 variables: is cut short");
        // One number too few for the dimensions.
        let mut parts = matrix("v", 1, &[1.0, 2.0], None);
        parts[8 + 16 + 8] = 3;
        insta::assert_snapshot!(refused(&file(&[parts])), @"a.mat, variable `v`: has 2 numbers where its dimensions are [3, 1]: the file is damaged");
        let broken = element(COMPRESSED, b"no zlib at all");
        assert!(refused(&file(&[broken])).starts_with("a.mat, compressed variable 1: cannot be unpacked"));
    }

    #[test]
    fn a_short_file_cannot_fill_the_memory() {
        let bomb = compressed(&vec![0; MOST_BYTES as usize + 1]);
        assert!(bomb.len() < 1 << 20);
        let refused = read(&file(&[bomb])).unwrap_err();
        assert_eq!(refused, "a.mat, compressed variable 1: unpacks to more than 67108864 bytes");
    }

    proptest::proptest! {
        #[test]
        fn no_bytes_panic(bytes in proptest::collection::vec(proptest::num::u8::ANY, 0..200), at in 0..200_usize) {
            let _ = read(&file(std::slice::from_ref(&bytes)));
            let mut whole = file(&[matrix("v", 2, &[1.0, 2.0, 3.0, 4.0], None)]);
            let at = HEAD + at % (whole.len() - HEAD);
            whole[at] ^= bytes.first().copied().unwrap_or(255);
            let _ = read(&whole);
        }
    }
}
