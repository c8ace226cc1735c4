//! The device's end of a line: a pseudo-terminal, or a TCP server for one client at a time.

use std::io::{self, Read, Write};
use std::net::{TcpListener, TcpStream};

use dermis_transport::Pty;

use super::Outlet;
use crate::TestbedError;

/// Where bytes leave the process.
#[derive(Debug)]
enum Port {
    Pty(Pty),
    Tcp { listener: TcpListener, client: Option<TcpStream> },
}

/// The device's end of the line. Like a UART with a buffer, it sends a frame whole or not at all.
#[derive(Debug)]
pub(super) struct Line {
    port: Port,
    /// The rest of a frame that was begun.
    pending: Vec<u8>,
}

impl Line {
    /// Opens the outlet; returns the URL to read it under, too.
    pub(super) fn open(outlet: &Outlet, skin: &str) -> Result<(Self, String), TestbedError> {
        let (port, url) = match outlet {
            Outlet::Pty => {
                let pty = Pty::open()?;
                let url = format!("pty://{}", pty.slave_path().display());
                (Port::Pty(pty), url)
            }
            Outlet::PtyLink(link) => {
                let mut pty = Pty::open()?;
                pty.link(link)?;
                (Port::Pty(pty), format!("pty://{}", link.display()))
            }
            Outlet::Tcp(address) => {
                let failed = |source| TestbedError::Device {
                    skin: skin.to_owned(),
                    what: "cannot listen on its TCP port",
                    source,
                };
                let listener = TcpListener::bind(address).map_err(failed)?;
                listener.set_nonblocking(true).map_err(failed)?;
                let bound = listener.local_addr().map_err(failed)?;
                (Port::Tcp { listener, client: None }, format!("tcp://{bound}"))
            }
        };
        Ok((Self { port, pending: Vec::new() }, url))
    }

    /// Takes a frame, and sends of it what the line takes now; `false` where the line is full and the frame is
    /// dropped.
    pub(super) fn send(&mut self, frame: &[u8]) -> io::Result<bool> {
        if !self.flush()? {
            return Ok(false);
        }
        let Some(sent) = self.write(frame)? else { return Ok(false) };
        if sent == 0 {
            return Ok(false);
        }
        self.pending.extend_from_slice(&frame[sent..]);
        Ok(true)
    }

    /// Sends on the frame that was begun; returns whether nothing is left of it.
    pub(super) fn flush(&mut self) -> io::Result<bool> {
        if !self.pending.is_empty() {
            let pending = std::mem::take(&mut self.pending);
            if let Some(sent) = self.write(&pending)? {
                // The client that the frame was begun for may be another by now.
                self.pending = pending[sent..].to_vec();
            }
        }
        Ok(self.pending.is_empty())
    }

    /// What the host wrote, as far as it has come.
    pub(super) fn received(&mut self) -> Vec<u8> {
        let mut buffer = [0; 4096];
        let read = match &mut self.port {
            Port::Pty(pty) => pty.try_read(&mut buffer),
            Port::Tcp { client: Some(stream), .. } => stream.read(&mut buffer),
            Port::Tcp { client: None, .. } => return Vec::new(),
        };
        // A fault of the line shows when it is written to.
        read.map_or_else(|_| Vec::new(), |n| buffer[..n].to_vec())
    }

    /// What the port takes now; `None` where nobody is there. A TCP client that has gone makes room for another,
    /// which gets whole frames only.
    fn write(&mut self, bytes: &[u8]) -> io::Result<Option<usize>> {
        match &mut self.port {
            Port::Pty(pty) => pty.write_lossy(bytes).map(Some),
            Port::Tcp { listener, client } => {
                if let Ok((stream, _)) = listener.accept() {
                    stream.set_nonblocking(true)?;
                    stream.set_nodelay(true)?;
                    *client = Some(stream);
                    return Ok(None);
                }
                let Some(stream) = client else { return Ok(None) };
                match stream.write(bytes) {
                    Ok(sent) => Ok(Some(sent)),
                    Err(e) if matches!(e.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::Interrupted) => {
                        Ok(Some(0))
                    }
                    Err(_) => {
                        *client = None;
                        Ok(None)
                    }
                }
            }
        }
    }
}
