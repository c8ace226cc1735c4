//! Floats in JSON, which has no word for "not a number": NaN is `null`, both ways.
//!
//! JSON cannot hold infinities either; they become `null` too and come back as NaN.

use std::fmt;
use std::marker::PhantomData;

use serde::de::{Deserialize, Deserializer, Error, SeqAccess, Visitor};
use serde::ser::{Serialize, Serializer};

/// Writes a float, or a list of floats, with `null` for what JSON cannot hold.
pub(crate) fn serialize<T: Serialize, S: Serializer>(value: &T, serializer: S) -> Result<S::Ok, S::Error> {
    // serde_json writes floats that are not finite as null already.
    value.serialize(serializer)
}

/// Reads what [`serialize`] wrote.
pub(crate) fn deserialize<'de, T: JsonFloats, D: Deserializer<'de>>(deserializer: D) -> Result<T, D::Error> {
    // Formats that name no types have no null to look for.
    if deserializer.is_human_readable() { T::from_nullable(deserializer) } else { T::plain(deserializer) }
}

/// A float, or a list of floats.
pub(crate) trait JsonFloats: Sized {
    fn from_nullable<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error>;
    fn plain<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error>;
}

macro_rules! floats {
    ($($float:ty),*) => {$(
        impl JsonFloats for $float {
            fn from_nullable<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                Ok(Option::deserialize(deserializer)?.unwrap_or(<$float>::NAN))
            }

            fn plain<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                Self::deserialize(deserializer)
            }
        }

        impl JsonFloats for Vec<$float> {
            fn from_nullable<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                let values = Vec::<Option<$float>>::deserialize(deserializer)?;
                Ok(values.into_iter().map(|value| value.unwrap_or(<$float>::NAN)).collect())
            }

            fn plain<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                Self::deserialize(deserializer)
            }
        }

        impl<const N: usize> JsonFloats for [$float; N] {
            fn from_nullable<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                let values: [Option<$float>; N] = array(deserializer)?;
                Ok(values.map(|value| value.unwrap_or(<$float>::NAN)))
            }

            fn plain<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                array(deserializer)
            }
        }
    )*};
}

floats!(f32, f64);

fn array<'de, T: Deserialize<'de>, D: Deserializer<'de>, const N: usize>(
    deserializer: D,
) -> Result<[T; N], D::Error> {
    struct Elements<T, const N: usize>(PhantomData<T>);
    impl<'de, T: Deserialize<'de>, const N: usize> Visitor<'de> for Elements<T, N> {
        type Value = [T; N];

        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            write!(f, "{N} numbers")
        }

        fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Self::Value, A::Error> {
            let mut values = Vec::with_capacity(N);
            while values.len() < N {
                match seq.next_element()? {
                    Some(value) => values.push(value),
                    None => return Err(A::Error::invalid_length(values.len(), &self)),
                }
            }
            values.try_into().map_err(|values: Vec<T>| A::Error::invalid_length(values.len(), &self))
        }
    }
    deserializer.deserialize_tuple(N, Elements(PhantomData))
}
