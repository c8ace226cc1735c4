//! What stands behind the `?` of a URL, and its target.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

use super::{HOLD, Newcomer, SourceUrl};
use crate::TransportError;

pub(super) struct Query<'a> {
    pub(super) url: &'a str,
    pub(super) target: &'a str,
    pub(super) keys: BTreeMap<String, String>,
}

impl<'a> Query<'a> {
    pub(super) fn parse(
        url: &'a str,
        scheme: &'static str,
        target: &'a str,
        query: &str,
        valid: &[&str],
    ) -> Result<Self, TransportError> {
        let mut keys = BTreeMap::new();
        for pair in query.split('&').filter(|p| !p.is_empty()) {
            let (key, value) = pair.split_once('=').unwrap_or((pair, ""));
            if !valid.contains(&key) {
                return Err(TransportError::UnknownKey {
                    url: url.into(),
                    scheme,
                    key: key.into(),
                    valid: valid.join(", "),
                });
            }
            let Some(value) = unescape(value) else {
                return Err(TransportError::InvalidValue {
                    url: url.into(),
                    key: key.into(),
                    value: value.into(),
                    expected: "UTF-8 text with % only in %XX escapes".into(),
                });
            };
            if keys.insert(key.to_owned(), value).is_some() {
                return Err(TransportError::DuplicateKey { url: url.into(), key: key.into() });
            }
        }
        Ok(Self { url, target, keys })
    }

    pub(super) fn invalid(&self, key: &str, value: &str, expected: &str) -> TransportError {
        TransportError::InvalidValue {
            url: self.url.into(),
            key: key.into(),
            value: value.into(),
            expected: expected.into(),
        }
    }

    pub(super) fn take_with<T>(
        &mut self,
        key: &str,
        expected: &str,
        read: impl FnOnce(&str) -> Option<T>,
    ) -> Result<Option<T>, TransportError> {
        let Some(value) = self.keys.remove(key) else { return Ok(None) };
        read(&value).map(Some).ok_or_else(|| self.invalid(key, &value, expected))
    }

    pub(super) fn flag(&mut self, key: &str) -> Result<bool, TransportError> {
        let value = self.take_with(key, "true or false", |v| match v {
            "" | "true" | "1" => Some(true),
            "false" | "0" => Some(false),
            _ => None,
        })?;
        Ok(value.unwrap_or(false))
    }

    pub(super) fn idle(&mut self) -> Result<Option<Duration>, TransportError> {
        self.idle_or(None)
    }

    pub(super) fn idle_or(&mut self, default: Option<Duration>) -> Result<Option<Duration>, TransportError> {
        let given = self.take_with("idle", "seconds, 0 (never) or 0.001 to 86400", |v| {
            let seconds = v.parse::<f64>().ok().filter(|s| *s == 0.0 || (0.001..=86_400.0).contains(s))?;
            Duration::try_from_secs_f64(seconds).ok()
        })?;
        Ok(given.map_or(default, |idle| Some(idle).filter(|idle| !idle.is_zero())))
    }

    pub(super) fn hold(&mut self) -> Result<Duration, TransportError> {
        let given = self.take_with("hold", "seconds, 0.001 to 86400", |v| {
            let seconds = v.parse::<f64>().ok().filter(|s| (0.001..=86_400.0).contains(s))?;
            Duration::try_from_secs_f64(seconds).ok()
        })?;
        Ok(given.unwrap_or(HOLD))
    }

    pub(super) fn tcp_listen(mut self) -> Result<SourceUrl, TransportError> {
        let newcomer = self.take_with("newcomer", "refuse or replace", |v| match v {
            "refuse" => Some(Newcomer::Refuse),
            "replace" => Some(Newcomer::Replace),
            _ => None,
        })?;
        Ok(SourceUrl::TcpListen {
            bind: self.socket_addr()?,
            newcomer: newcomer.unwrap_or_default(),
            hold: self.hold()?,
            idle: self.idle()?,
        })
    }

    pub(super) fn target_error(&self, what: &'static str, expected: &str) -> TransportError {
        TransportError::InvalidTarget { url: self.url.into(), what, expected: expected.into() }
    }

    pub(super) fn path(&self, expected: &str) -> Result<PathBuf, TransportError> {
        match unescape(self.target) {
            Some(path) if !path.is_empty() && !path.contains('\0') => Ok(PathBuf::from(path)),
            _ => Err(self.target_error("path", &format!("expected {expected}"))),
        }
    }

    pub(super) fn socket_addr(&self) -> Result<SocketAddr, TransportError> {
        self.target.parse().map_err(|_| {
            self.target_error(
                "address",
                "expected ADDRESS:PORT of this machine, as in 0.0.0.0:7400 or [::]:7400",
            )
        })
    }

    pub(super) fn host_port(&self) -> Result<String, TransportError> {
        let valid = self.target.rsplit_once(':').is_some_and(|(host, port)| {
            !host.is_empty() && !host.contains(['/', '%']) && port.parse::<u16>().is_ok_and(|p| p != 0)
        });
        if valid {
            Ok(self.target.to_owned())
        } else {
            Err(self.target_error("address", "expected HOST:PORT, as in 192.168.1.20:7400"))
        }
    }
}

/// Reads what follows `http://`.
pub(super) fn http(url: &str, rest: &str) -> Result<SourceUrl, TransportError> {
    let refused = |what, expected: &str| TransportError::InvalidTarget {
        url: url.into(),
        what,
        expected: expected.into(),
    };
    let (host, path) = rest.find(['/', '?']).map_or((rest, ""), |at| rest.split_at(at));
    let path = if path.starts_with('/') { path.to_owned() } else { format!("/{path}") };
    if !path.bytes().all(|byte| byte.is_ascii_graphic() && byte != b'#') {
        return Err(refused(
            "path",
            "write spaces and what is not ASCII as %XX, and leave out what follows `#`",
        ));
    }
    // The colons of an IPv6 address stand in brackets.
    let named = host.rsplit_once(':').filter(|(_, port)| !port.ends_with(']'));
    let (name, port) = named.unwrap_or((host, "80"));
    let valid = !name.is_empty()
        && name.bytes().all(|byte| byte.is_ascii_graphic() && !b"@%\\".contains(&byte))
        && port.parse::<u16>().is_ok_and(|port| port != 0);
    if !valid {
        return Err(refused(
            "address",
            "expected HOST or HOST:PORT without a user's name, as in http://192.168.1.20:8080/?action=stream",
        ));
    }
    Ok(SourceUrl::Http { address: format!("{name}:{port}"), path })
}

pub(super) fn unescape(text: &str) -> Option<String> {
    let mut out = Vec::with_capacity(text.len());
    let mut bytes = text.bytes();
    while let Some(b) = bytes.next() {
        if b == b'%' {
            let high = char::from(bytes.next()?).to_digit(16)?;
            let low = char::from(bytes.next()?).to_digit(16)?;
            out.push(u8::try_from(high * 16 + low).ok()?);
        } else {
            out.push(b);
        }
    }
    String::from_utf8(out).ok()
}

pub(super) fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        if matches!(c, '%' | '?' | '&' | '=' | '#') || c.is_whitespace() || c.is_control() {
            let mut utf8 = [0; 4];
            for b in c.encode_utf8(&mut utf8).bytes() {
                let _ = write!(out, "%{b:02X}");
            }
        } else {
            out.push(c);
        }
    }
    out
}
