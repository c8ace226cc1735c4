//! Which skin a message is about, without decoding the rest of it.
//!
//! A topic may carry the messages of several skins, and a bridge or a player has to tell them apart at the rate at which they
//! come. All types that name their skin begin alike: a header, then the name.

use crate::cdr::{Cdr, CdrErrorKind, Reader};
use crate::msg::{ContactArray, DisplacementMap, ForceMap, Indentation, SkinGeometry, TaxelFrame};
use crate::std_msgs::msg::Header;
use crate::{CdrError, Message};

/// Types whose messages name the skin that they are about.
pub const OF_A_SKIN: [&str; 6] = [
    ContactArray::TYPE_NAME,
    TaxelFrame::TYPE_NAME,
    ForceMap::TYPE_NAME,
    DisplacementMap::TYPE_NAME,
    SkinGeometry::TYPE_NAME,
    Indentation::TYPE_NAME,
];

/// What a message of one of the types [`OF_A_SKIN`] says of its skin.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SkinNames {
    /// Name of the skin, unique on the robot.
    pub skin: String,
    /// Coordinate frame of the message.
    pub frame_id: String,
}

impl SkinNames {
    /// Reads the beginning of an encoded message of one of the types [`OF_A_SKIN`].
    ///
    /// # Errors
    /// Where the bytes are no such message. The rest of it is not inspected.
    pub fn of(cdr: &[u8]) -> Result<Self, CdrError> {
        let read = || -> Result<Self, CdrErrorKind> {
            let mut reader = Reader::of(cdr)?;
            reader.enter("header");
            let header = Header::read(&mut reader)?;
            reader.enter("skin");
            let skin = String::read(&mut reader)?;
            Ok(Self { skin, frame_id: header.frame_id })
        };
        read().map_err(|kind| CdrError { type_name: "message of a skin", kind })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn every_type_begins_with_its_skin() {
        macro_rules! check {
            ($($message:ident),*) => {
                let types = [$($message::TYPE_NAME),*];
                assert!(OF_A_SKIN.iter().all(|name| types.contains(name)));
                $({
                    let header = Header { frame_id: "left_link".into(), ..Header::default() };
                    let message = $message { header, skin: "left_palm".into(), ..$message::default() };
                    let expected = SkinNames { skin: "left_palm".into(), frame_id: "left_link".into() };
                    assert_eq!(SkinNames::of(&message.to_cdr()).unwrap(), expected);
                })*
            };
        }
        check!(ContactArray, TaxelFrame, ForceMap, DisplacementMap, SkinGeometry, Indentation);
        assert!(
            SkinNames::of(&[0, 1, 0, 0, 1]).unwrap_err().to_string().starts_with("not a message of a skin")
        );
    }

    proptest! {
        #[test]
        fn no_bytes_panic(bytes in proptest::collection::vec(any::<u8>(), 0..64)) {
            let _ = SkinNames::of(&bytes);
        }
    }
}
