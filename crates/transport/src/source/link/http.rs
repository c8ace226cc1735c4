//! A stream out of a web server: asks for it, and reads what comes behind the head of the answer.
//!
//! It asks in HTTP 1.0, whose answers come in one piece until the server closes: streams of cameras are served like that.

use std::io::{self, Read, Write};
use std::net::TcpStream;
use std::os::fd::{AsFd, BorrowedFd};
use std::time::{Duration, Instant};

/// \[bytes\] of an answer's head at most, and lines.
const HEAD: usize = 1 << 14;
const LINES: usize = 64;

/// The body of an answer.
pub(super) struct Body {
    stream: TcpStream,
    /// What came of it with the head, last byte first.
    first: Vec<u8>,
}

impl Body {
    /// Asks for `path`, and reads the head of the answer, within so much time. A reason for people where there is no such stream.
    pub(super) fn of(
        mut stream: TcpStream,
        address: &str,
        path: &str,
        timeout: Duration,
    ) -> Result<Self, String> {
        let failed = |e: io::Error| match e.kind() {
            io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut => {
                format!(
                    "http://{address}{path} does not answer within {timeout:?}: is this port a web server's?"
                )
            }
            _ => format!("cannot get http://{address}{path}: {e}"),
        };
        let until = Instant::now() + timeout;
        let request =
            format!("GET {path} HTTP/1.0\r\nHost: {address}\r\nUser-Agent: dermis\r\nAccept: */*\r\n\r\n");
        let mut head = Vec::new();
        let mut send_request = || -> io::Result<()> {
            stream.set_nonblocking(false)?;
            stream.set_write_timeout(Some(timeout))?;
            stream.write_all(request.as_bytes())?;
            let mut piece = [0; 2048];
            while !ended(&head) && head.len() <= HEAD {
                let left = until.saturating_duration_since(Instant::now());
                stream.set_read_timeout(Some(left.max(Duration::from_millis(1))))?;
                let read = stream.read(&mut piece)?;
                if read == 0 {
                    return Err(io::ErrorKind::UnexpectedEof.into());
                }
                head.extend_from_slice(&piece[..read]);
                if left.is_zero() {
                    return Err(io::ErrorKind::TimedOut.into());
                }
            }
            stream.set_nonblocking(true)
        };
        send_request().map_err(failed)?;
        let end = check(&head).map_err(|reason| format!("http://{address}{path} {reason}"))?;
        let mut first = head.split_off(end);
        first.reverse();
        Ok(Self { stream, first })
    }

    /// Whether bytes that came with the head are not read yet.
    pub(super) fn holds(&self) -> bool {
        !self.first.is_empty()
    }

    pub(super) fn as_fd(&self) -> BorrowedFd<'_> {
        self.stream.as_fd()
    }

    pub(super) fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.first.is_empty() {
            return self.stream.read(buffer);
        }
        let given = self.first.len().min(buffer.len());
        let rest = self.first.len() - given;
        buffer.iter_mut().zip(self.first.drain(rest..).rev()).for_each(|(to, from)| *to = from);
        Ok(given)
    }
}

fn ended(head: &[u8]) -> bool {
    head.windows(4).any(|bytes| bytes == b"\r\n\r\n")
}

/// Where the body begins, of an answer that can be read.
fn check(head: &[u8]) -> Result<usize, String> {
    let mut lines = [httparse::EMPTY_HEADER; LINES];
    let mut answer = httparse::Response::new(&mut lines);
    let end = match answer.parse(head) {
        Ok(httparse::Status::Complete(end)) => end,
        Ok(httparse::Status::Partial) => {
            return Err(format!("answers with a head of more than {HEAD} bytes"));
        }
        Err(e) => return Err(format!("answers no HTTP ({e}): is this port a web server's?")),
    };
    let code = answer.code.unwrap_or_default();
    if code != 200 {
        let reason = answer.reason.unwrap_or_default();
        let hint = match code {
            301..=308 => "open the address that it names",
            401 | 403 => "it wants a password, which is not supported: let it serve this machine without",
            _ => "check the path",
        };
        return Err(format!("answers {code} {reason}: {hint}"));
    }
    let chunked = answer
        .headers
        .iter()
        .any(|line| line.name.eq_ignore_ascii_case("transfer-encoding") && line.value != b"identity");
    if chunked {
        return Err(
            "sends its answer in chunks though HTTP 1.0 was requested, which is not read: use another server"
                .to_owned(),
        );
    }
    Ok(end)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heads_are_checked() {
        assert_eq!(check(b"HTTP/1.0 200 OK\r\nServer: x\r\n\r\nbody"), Ok(30));
        assert!(
            check(b"HTTP/1.1 404 Not Found\r\n\r\n").unwrap_err().contains("404 Not Found: check the path")
        );
        assert!(check(b"HTTP/1.1 401 Unauthorized\r\n\r\n").unwrap_err().contains("password"));
        assert!(
            check(b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n").unwrap_err().contains("chunks")
        );
        assert!(check(b"220 mail.example.org ESMTP\r\n\r\n").unwrap_err().contains("no HTTP"));
        assert!(check(b"HTTP/1.1 200 OK\r\nA: ").unwrap_err().contains("head"));
    }
}
