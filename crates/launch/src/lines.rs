//! Bytes of a pipe to lines, with a bound on how much is held.

/// Longest line that is kept whole \[byte\]; what goes on is a line of its own.
pub(crate) const LONGEST_LINE: usize = 16 * 1024;

/// Cuts a stream of bytes into lines.
#[derive(Debug, Default)]
pub(crate) struct Lines {
    open: Vec<u8>,
}

impl Lines {
    /// Takes the next bytes and hands over every line that ends in them.
    pub(crate) fn push(&mut self, mut bytes: &[u8], mut line: impl FnMut(&[u8])) {
        while !bytes.is_empty() {
            let room = LONGEST_LINE - self.open.len();
            let window = &bytes[..bytes.len().min(room)];
            match window.iter().position(|b| *b == b'\n') {
                Some(end) => {
                    if self.open.is_empty() {
                        line(trimmed(&window[..end]));
                    } else {
                        self.open.extend_from_slice(&window[..end]);
                        line(trimmed(&self.open));
                        self.open.clear();
                    }
                    bytes = &bytes[end + 1..];
                }
                None => {
                    self.open.extend_from_slice(window);
                    bytes = &bytes[window.len()..];
                    if self.open.len() == LONGEST_LINE {
                        line(&self.open);
                        self.open.clear();
                    }
                }
            }
        }
    }

    /// Hands over what came after the last end of a line.
    pub(crate) fn finish(&mut self, mut line: impl FnMut(&[u8])) {
        if !self.open.is_empty() {
            line(trimmed(&self.open));
            self.open.clear();
        }
    }
}

fn trimmed(line: &[u8]) -> &[u8] {
    line.strip_suffix(b"\r").unwrap_or(line)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn cut(chunks: &[&[u8]]) -> Vec<String> {
        let mut found = Vec::new();
        let mut lines = Lines::default();
        let mut keep = |line: &[u8]| found.push(String::from_utf8_lossy(line).into_owned());
        for chunk in chunks {
            lines.push(chunk, &mut keep);
        }
        lines.finish(keep);
        found
    }

    proptest! {
        #[test]
        fn lines_do_not_depend_on_how_they_arrive(text in "[a-c\n\r]{0,200}", at in prop::collection::vec(0..200usize, 0..6)) {
            let bytes = text.as_bytes();
            let mut at: Vec<usize> = at.into_iter().map(|i| i.min(bytes.len())).collect();
            at.sort_unstable();
            at.push(bytes.len());
            let mut from = 0;
            let chunks: Vec<&[u8]> = at.iter().map(|to| { let c = &bytes[from..*to]; from = *to; c }).collect();
            let expected: Vec<&str> = text.split('\n').map(|l| l.strip_suffix('\r').unwrap_or(l)).collect();
            let expected = if text.ends_with('\n') || text.is_empty() { &expected[..expected.len() - 1] } else { &expected[..] };
            prop_assert_eq!(cut(&chunks), expected);
        }
    }

    #[test]
    fn a_line_without_end_does_not_grow() {
        let block = vec![b'x'; 10_000];
        let found = cut(&[block.as_slice(); 5]);
        assert_eq!(found.iter().map(String::len).collect::<Vec<_>>(), [16384, 16384, 16384, 848]);
    }
}
