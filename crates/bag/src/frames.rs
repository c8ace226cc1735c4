//! The numbers of taxel frames, read without decoding the frame.
//!
//! A recorder looks at every frame, and a frame may have hundreds of channels. The number stands behind the header and the skin's
//! name, so that three fields are enough; it did so before frames lost their channel names, too.

use dermis_msgs::{Message as _, TypeSupport, msg::TaxelFrame, sequence::LossCounter};

use crate::Topic;

/// What tells a frame from the others of its topic.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Head<'a> {
    pub(crate) skin: &'a str,
    pub(crate) sequence: u64,
    /// When it was acquired [ns]; `None` where the frame has no time.
    pub(crate) stamp: Option<i64>,
}

/// Reads CDR fields one after the other, aligned to their size from the end of the encapsulation header on.
struct Fields<'a> {
    bytes: &'a [u8],
    at: usize,
    little: bool,
}

impl<'a> Fields<'a> {
    fn take(&mut self, count: usize) -> Option<&'a [u8]> {
        let taken = self.bytes.get(self.at..self.at.checked_add(count)?)?;
        self.at += count;
        Some(taken)
    }

    fn word(&mut self) -> Option<u32> {
        self.at = self.at.next_multiple_of(4);
        let bytes = self.take(4)?.try_into().ok()?;
        Some(if self.little { u32::from_le_bytes(bytes) } else { u32::from_be_bytes(bytes) })
    }

    fn long(&mut self) -> Option<u64> {
        self.at = self.at.next_multiple_of(8);
        let bytes = self.take(8)?.try_into().ok()?;
        Some(if self.little { u64::from_le_bytes(bytes) } else { u64::from_be_bytes(bytes) })
    }

    fn text(&mut self) -> Option<&'a str> {
        let length = usize::try_from(self.word()?).ok()?;
        let bytes = self.take(length)?;
        std::str::from_utf8(bytes.strip_suffix(&[0]).unwrap_or(bytes)).ok()
    }
}

/// The head of a taxel frame; `None` where the bytes are none.
pub(crate) fn head(cdr: &[u8]) -> Option<Head<'_>> {
    let (&[0, order @ (0 | 1), _, _], bytes) = cdr.split_first_chunk::<4>()? else { return None };
    let mut fields = Fields { bytes, at: 0, little: order == 1 };
    let (seconds, nanos) = (fields.word()?.cast_signed(), fields.word()?);
    fields.text()?;
    let skin = fields.text()?;
    let sequence = fields.long()?;
    let stamp = i64::from(seconds) * 1_000_000_000 + i64::from(nanos);
    Some(Head { skin, sequence, stamp: (stamp != 0).then_some(stamp) })
}

/// Counts the frames that a topic lacks, by skin.
#[derive(Debug, Default)]
pub(crate) struct FrameCounter(LossCounter<String>);

impl FrameCounter {
    /// A counter for topics that carry taxel frames as they are known here.
    pub(crate) fn of(topic: &Topic) -> Option<Self> {
        let hash = TypeSupport::of::<TaxelFrame>().hash;
        let same = topic.type_name == TaxelFrame::TYPE_NAME && topic.type_hash.as_deref() == Some(hash);
        (same || topic.upgrade().is_some_and(|upgrade| upgrade.new.hash == hash)).then(Self::default)
    }

    pub(crate) fn observe(&mut self, cdr: &[u8]) {
        if let Some(head) = head(cdr) {
            self.0.observe(head.skin, head.sequence, head.stamp);
        }
    }

    /// Frames that the skins numbered and that did not come.
    pub(crate) fn missing(&self) -> u64 {
        self.0.losses().lost
    }
}

#[cfg(test)]
mod tests {
    use dermis_msgs::std_msgs::msg::Header;
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn the_head_is_that_of_the_frame(
            frame_id in "[a-zµ]{0,9}", skin in "[a-zµ]{0,9}", sequence: u64, stamp in 1..4_000_000_000_000_000_000_i64, channels in 0..9_usize,
        ) {
            let frame = TaxelFrame {
                header: Header::new(stamp % 2_000_000_000_000_000_000, frame_id.as_str()),
                skin: skin.clone(),
                sequence,
                values: vec![1.0; channels],
                ..TaxelFrame::default()
            };
            let bytes = frame.to_cdr();
            let stamp = frame.header.stamp.as_nanos();
            let expected = Head { skin: &skin, sequence, stamp: (stamp != 0).then_some(stamp) };
            prop_assert_eq!(head(&bytes), Some(expected));
            let before = dermis_msgs::v0::msg::TaxelFrame {
                header: frame.header,
                skin: skin.clone(),
                sequence,
                channels: vec!["p0".into(); channels],
                ..Default::default()
            };
            let before = before.to_cdr();
            prop_assert_eq!(head(&before), Some(expected));
            // Cut anywhere, it is no frame and no panic.
            for end in 0..bytes.len() {
                let _ = head(&bytes[..end]);
            }
        }

        #[test]
        fn noise_is_no_panic(bytes in prop::collection::vec(any::<u8>(), 0..64)) {
            let _ = head(&bytes);
        }
    }
}
