//! Keeps the sockets with which zenoh looks for peers on the loopback.
//!
//! zenoh 1.10 sends its questions over the interface that is configured, but binds the socket that waits for the answers to
//! every address. So any host of the network could send such an answer (a `Hello` with its own address in it) to our port,
//! and have us connect to it. There is no setting against that. So the sockets are bound to the loopback interface after
//! zenoh has made them; Linux then drops what comes from elsewhere. The socket that hears questions is bound too: it would get
//! those of other hosts as soon as any program of this machine joins the group on another interface.

/// Binds every socket of this process that looks for peers on the loopback to the loopback interface. Returns what the system
/// refused.
#[cfg(target_os = "linux")]
pub(super) fn keep_on_loopback() -> Result<(), std::io::Error> {
    use std::net::Ipv4Addr;
    use std::os::fd::{BorrowedFd, RawFd};

    use socket2::{SockRef, Type};

    for entry in std::fs::read_dir("/proc/self/fd")?.flatten() {
        let Some(number) = entry.file_name().to_str().and_then(|name| name.parse::<RawFd>().ok()) else {
            continue;
        };
        // SAFETY: the number was open when it was listed. Where another thread closes it meanwhile, the calls below fail, or
        // find another socket, which they only touch where all that is requested here is true of it, too.
        let fd = unsafe { BorrowedFd::borrow_raw(number) };
        let socket = SockRef::from(&fd);
        let Some(local) = socket.local_addr().ok().and_then(|address| address.as_socket_ipv4()) else {
            continue;
        };
        let asks = local.ip().is_unspecified()
            && socket.multicast_if_v4().is_ok_and(|interface| interface == Ipv4Addr::LOCALHOST);
        let hears = local.ip().is_multicast() && local.port() == super::zenoh_config::LOOPBACK_SCOUTING_PORT;
        let searches = socket.r#type().is_ok_and(|kind| kind == Type::DGRAM) && (asks || hears);
        if searches && socket.device().is_ok_and(|device| device.is_none()) {
            socket.bind_device(Some(b"lo"))?;
        }
    }
    Ok(())
}

/// Other systems have no such option.
#[cfg(not(target_os = "linux"))]
pub(super) fn keep_on_loopback() -> Result<(), std::io::Error> {
    Ok(())
}
