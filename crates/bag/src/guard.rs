//! Calls into the parser of the container, which is another's. It panics on damage that it did not foresee (mcap 0.26: an
//! attachment without room for its checksum; where overflow is checked, a record that claims more than its chunk): here
//! that is an error like any other damage.

use std::panic::{AssertUnwindSafe, catch_unwind};

use mcap::{McapError, McapResult, records::Record};

/// What `parse` gives. Whatever it worked on must not be used again after an error.
pub(crate) fn guarded<T>(parse: impl FnOnce() -> T) -> McapResult<T> {
    catch_unwind(AssertUnwindSafe(parse)).map_err(|_| McapError::UnexpectedEoc)
}

/// One record from its bytes.
pub(crate) fn parse_record(opcode: u8, data: &[u8]) -> McapResult<Record<'_>> {
    guarded(|| mcap::parse_record(opcode, data))?
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_attachment_without_its_checksum_is_refused() {
        let mut attachment = vec![0; 16];
        attachment.extend_from_slice(&[0; 16]);
        assert!(parse_record(mcap::records::op::ATTACHMENT, &attachment).is_err());
    }
}
