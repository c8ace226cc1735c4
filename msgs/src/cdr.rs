//! Common Data Representation (XCDR1), the encoding of ROS 2 messages on the wire and in bags.
//!
//! Everything is aligned to its own size, counted from behind the four bytes of the encapsulation header.
//! Generated types implement [`Cdr`]; use them through [`Message::to_cdr`](crate::Message::to_cdr) and
//! [`Message::from_cdr`](crate::Message::from_cdr).
//!
//! Decoding takes any bytes: it never panics, and a length in the input is believed only as far as the bytes that are
//! left can hold that many elements, so that memory stays within a small multiple of the input.

use thiserror::Error;

/// Header of little-endian CDR: representation 0x0001, no options.
const LITTLE_ENDIAN_HEADER: [u8; 4] = [0, 1, 0, 0];
/// Bytes that a transport may append to fill its last 4-byte word.
const WORD_PADDING: usize = 3;

/// Why bytes or JSON are not a message.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("not a {type_name}: {kind}")]
pub struct CdrError {
    /// Full name of the message that was requested.
    pub type_name: &'static str,
    /// What is wrong, and where.
    pub kind: CdrErrorKind,
}

/// What is wrong in bytes or JSON that are not a message. Offsets count from the start of the encapsulation header.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum CdrErrorKind {
    /// The input is shorter than the encapsulation header.
    #[error("{length} bytes hold no encapsulation header, which has 4")]
    NoHeader {
        /// Length of the input.
        length: usize,
    },
    /// The input is not plain CDR.
    #[error(
        "encapsulation {first:02x} {second:02x} is neither big-endian (00 00) nor little-endian (00 01) plain CDR"
    )]
    Encapsulation {
        /// First byte of the input.
        first: u8,
        /// Second byte of the input.
        second: u8,
    },
    /// The input ends within a field.
    #[error("{field} at byte {offset} needs {needed} bytes, {left} are left")]
    TooShort {
        /// Field that was read.
        field: &'static str,
        /// Where it was read.
        offset: usize,
        /// Bytes that it needs.
        needed: usize,
        /// Bytes that are left.
        left: usize,
    },
    /// A sequence claims more elements than the rest of the input can hold, or than its type allows.
    #[error("{field} at byte {offset} claims a length of {count}, at most {max} is possible")]
    Length {
        /// Field that was read.
        field: &'static str,
        /// Where its length stands.
        offset: usize,
        /// Elements, or bytes of a string, that the input claims.
        count: usize,
        /// The most that are possible.
        max: usize,
    },
    /// A boolean is neither 0 nor 1.
    #[error("{field} at byte {offset} is {value}, a boolean is 0 or 1")]
    Boolean {
        /// Field that was read.
        field: &'static str,
        /// Where it stands.
        offset: usize,
        /// Its value.
        value: u8,
    },
    /// A string is not UTF-8.
    #[error("{field} at byte {offset} is not UTF-8")]
    Utf8 {
        /// Field that was read.
        field: &'static str,
        /// Where the string's first byte that is no UTF-8 stands.
        offset: usize,
    },
    /// Bytes follow the message.
    #[error(
        "{count} bytes follow the message, which ends at byte {offset}: this is another type or another version"
    )]
    Trailing {
        /// Bytes that follow.
        count: usize,
        /// Where the message ends.
        offset: usize,
    },
    /// JSON does not fit the message.
    #[error("{path}: {problem}")]
    Json {
        /// Where in the JSON value, as `contacts[0].force.x`.
        path: String,
        /// What is wrong there.
        problem: String,
    },
}

/// Encodes a message behind a little-endian encapsulation header.
pub fn encode<T: Cdr>(message: &T, out: Vec<u8>) -> Vec<u8> {
    let mut writer = Writer { out, start: 0 };
    writer.out.clear();
    writer.out.extend_from_slice(&LITTLE_ENDIAN_HEADER);
    writer.start = writer.out.len();
    message.write(&mut writer);
    writer.out
}

/// Decodes a message from behind an encapsulation header of either byte order.
///
/// # Errors
/// Says what is wrong and where.
pub fn decode<T: Cdr>(bytes: &[u8]) -> Result<T, CdrErrorKind> {
    let mut reader = Reader::of(bytes)?;
    let message = T::read(&mut reader)?;
    // Fast RTPS hands out serialised messages with as many bytes as it had estimated, and it estimates up to 4 bytes of
    // padding too many for each empty sequence, which has 4 bytes itself.
    let count = reader.left();
    if count > WORD_PADDING + reader.at {
        return Err(CdrErrorKind::Trailing { count, offset: reader.offset() });
    }
    Ok(message)
}

/// A type with a CDR encoding.
pub trait Cdr: Sized {
    /// Lower bound of the bytes that a value takes, at least 1.
    const MIN_SIZE: usize;

    /// Appends the value.
    fn write(&self, w: &mut Writer);

    /// Takes a value.
    ///
    /// # Errors
    /// Says what is wrong in the input and where.
    fn read(r: &mut Reader<'_>) -> Result<Self, CdrErrorKind>;

    /// Appends values one after the other.
    fn write_all(values: &[Self], w: &mut Writer) {
        for value in values {
            value.write(w);
        }
    }

    /// Takes `count` values. The caller has checked that the input may hold them.
    ///
    /// # Errors
    /// Says what is wrong in the input and where.
    fn read_all(r: &mut Reader<'_>, count: usize) -> Result<Vec<Self>, CdrErrorKind> {
        let mut values = Vec::with_capacity(count);
        for _ in 0..count {
            values.push(Self::read(r)?);
        }
        Ok(values)
    }
}

/// Takes the bytes of a message.
#[derive(Debug)]
pub struct Writer {
    out: Vec<u8>,
    start: usize,
}

impl Writer {
    /// Stands in for the fields of a message without fields, as rosidl does.
    pub fn placeholder(&mut self) {
        self.out.push(0);
    }

    fn align(&mut self, size: usize) {
        let end = self.start + (self.out.len() - self.start).next_multiple_of(size);
        self.out.resize(end, 0);
    }

    fn length(&mut self, length: usize) {
        let length = u32::try_from(length).expect("CDR counts elements in 32 bits");
        length.write(self);
    }
}

/// Gives the bytes of a message.
#[derive(Debug)]
pub struct Reader<'a> {
    payload: &'a [u8],
    at: usize,
    little_endian: bool,
    field: &'static str,
}

impl<'a> Reader<'a> {
    /// Reads the encapsulation header.
    pub(crate) fn of(bytes: &'a [u8]) -> Result<Self, CdrErrorKind> {
        let Some((header, payload)) = bytes.split_at_checked(LITTLE_ENDIAN_HEADER.len()) else {
            return Err(CdrErrorKind::NoHeader { length: bytes.len() });
        };
        let little_endian = match header {
            [0, 0, ..] => false,
            [0, 1, ..] => true,
            _ => return Err(CdrErrorKind::Encapsulation { first: header[0], second: header[1] }),
        };
        Ok(Self { payload, at: 0, little_endian, field: "" })
    }

    /// Names the field that is read next, for errors.
    pub fn enter(&mut self, field: &'static str) {
        self.field = field;
    }

    /// Takes what stands in for the fields of a message without fields. Some peers leave it away.
    ///
    /// # Errors
    /// Where the input ends early within another message.
    pub fn placeholder(&mut self) -> Result<(), CdrErrorKind> {
        if self.payload.is_empty() {
            return Ok(());
        }
        self.take(1).map(drop)
    }

    /// Takes a sequence of at most `max` elements.
    ///
    /// # Errors
    /// Where it is longer, or says what is wrong in the input.
    pub fn bounded_sequence<T: Cdr>(&mut self, max: usize) -> Result<Vec<T>, CdrErrorKind> {
        let count = self.length(T::MIN_SIZE, max)?;
        T::read_all(self, count)
    }

    /// Takes a string of at most `max` bytes.
    ///
    /// # Errors
    /// Where it is longer, or says what is wrong in the input.
    pub fn bounded_string(&mut self, max: usize) -> Result<String, CdrErrorKind> {
        let length = self.length(1, max.saturating_add(1))?;
        let offset = self.offset();
        let bytes = self.take(length)?;
        let bytes = bytes.strip_suffix(&[0]).unwrap_or(bytes);
        match std::str::from_utf8(bytes) {
            Ok(text) => Ok(text.to_owned()),
            Err(e) => Err(CdrErrorKind::Utf8 { field: self.field, offset: offset + e.valid_up_to() }),
        }
    }

    fn left(&self) -> usize {
        self.payload.len() - self.at
    }

    fn offset(&self) -> usize {
        LITTLE_ENDIAN_HEADER.len() + self.at
    }

    fn align(&mut self, size: usize) {
        // What lies behind the end is found out by the take that follows.
        self.at = self.at.next_multiple_of(size).min(self.payload.len());
    }

    fn take(&mut self, needed: usize) -> Result<&'a [u8], CdrErrorKind> {
        let rest = &self.payload[self.at..];
        let Some(bytes) = rest.get(..needed) else {
            return Err(CdrErrorKind::TooShort {
                field: self.field,
                offset: self.offset(),
                needed,
                left: rest.len(),
            });
        };
        self.at += needed;
        Ok(bytes)
    }

    /// Takes the length of a sequence whose elements have at least `min_size` bytes.
    fn length(&mut self, min_size: usize, max: usize) -> Result<usize, CdrErrorKind> {
        let count = u32::read(self)?;
        let count = usize::try_from(count).unwrap_or(usize::MAX);
        let max = max.min(self.left() / min_size.max(1));
        if count > max {
            return Err(CdrErrorKind::Length { field: self.field, offset: self.offset() - 4, count, max });
        }
        Ok(count)
    }
}

macro_rules! numbers {
    ($($number:ty),*) => {$(
        impl Cdr for $number {
            const MIN_SIZE: usize = size_of::<Self>();

            fn write(&self, w: &mut Writer) {
                w.align(size_of::<Self>());
                w.out.extend_from_slice(&self.to_le_bytes());
            }

            fn read(r: &mut Reader<'_>) -> Result<Self, CdrErrorKind> {
                r.align(size_of::<Self>());
                let mut bytes = [0; size_of::<Self>()];
                bytes.copy_from_slice(r.take(size_of::<Self>())?);
                Ok(if r.little_endian { Self::from_le_bytes(bytes) } else { Self::from_be_bytes(bytes) })
            }

            // Chunks of constant size compile to copies of whole registers.
            fn write_all(values: &[Self], w: &mut Writer) {
                if values.is_empty() {
                    return;
                }
                w.align(size_of::<Self>());
                let start = w.out.len();
                w.out.resize(start + size_of_val(values), 0);
                for (chunk, value) in w.out[start..].chunks_exact_mut(size_of::<Self>()).zip(values) {
                    chunk.copy_from_slice(&value.to_le_bytes());
                }
            }

            fn read_all(r: &mut Reader<'_>, count: usize) -> Result<Vec<Self>, CdrErrorKind> {
                if count == 0 {
                    return Ok(Vec::new());
                }
                r.align(size_of::<Self>());
                let bytes = r.take(count.saturating_mul(size_of::<Self>()))?;
                let (chunks, _) = bytes.as_chunks();
                Ok(if r.little_endian {
                    chunks.iter().map(|chunk| Self::from_le_bytes(*chunk)).collect()
                } else {
                    chunks.iter().map(|chunk| Self::from_be_bytes(*chunk)).collect()
                })
            }
        }
    )*};
}

numbers!(u8, i8, u16, i16, u32, i32, u64, i64, f32, f64);

impl Cdr for bool {
    const MIN_SIZE: usize = 1;

    fn write(&self, w: &mut Writer) {
        w.out.push(u8::from(*self));
    }

    fn read(r: &mut Reader<'_>) -> Result<Self, CdrErrorKind> {
        match u8::read(r)? {
            0 => Ok(false),
            1 => Ok(true),
            value => Err(CdrErrorKind::Boolean { field: r.field, offset: r.offset() - 1, value }),
        }
    }
}

impl Cdr for String {
    // The length; an empty string of some peers has not even its NUL.
    const MIN_SIZE: usize = 4;

    fn write(&self, w: &mut Writer) {
        w.length(self.len() + 1);
        w.out.extend_from_slice(self.as_bytes());
        w.out.push(0);
    }

    fn read(r: &mut Reader<'_>) -> Result<Self, CdrErrorKind> {
        r.bounded_string(usize::MAX)
    }
}

impl<T: Cdr> Cdr for Vec<T> {
    const MIN_SIZE: usize = 4;

    fn write(&self, w: &mut Writer) {
        w.length(self.len());
        T::write_all(self, w);
    }

    fn read(r: &mut Reader<'_>) -> Result<Self, CdrErrorKind> {
        r.bounded_sequence(usize::MAX)
    }
}

impl<T: Cdr + Default, const N: usize> Cdr for [T; N] {
    const MIN_SIZE: usize = N * T::MIN_SIZE;

    fn write(&self, w: &mut Writer) {
        T::write_all(self, w);
    }

    fn read(r: &mut Reader<'_>) -> Result<Self, CdrErrorKind> {
        let mut values = std::array::from_fn(|_| T::default());
        for value in &mut values {
            *value = T::read(r)?;
        }
        Ok(values)
    }
}
