//! Standard output whose reader has gone.
//!
//! Problem: in `dermis bag info B | head` the reader leaves before everything is printed. Rust ignores SIGPIPE, so that the next
//! `println!` panics, with a message and an exit code that mean a fault of the program. Restoring the default of SIGPIPE would end
//! a program at any write, also of a node to a socket whose other end is gone (`writev` knows no `MSG_NOSIGNAL`).
//!
//! Solution: SIGPIPE stays ignored, and the panic of `print!` to a standard stream is caught where it is reported: the process
//! ends by SIGPIPE itself, as the shell expects it (status 141). That is how rustc does it. It holds in every thread, and for all
//! that print.

use std::panic::{PanicHookInfo, set_hook, take_hook};

use nix::sys::signal::{SigHandler, Signal, raise, signal};

/// The reader of the standard output has gone: what `main` gets where output is written without `print!`, so that there is
/// something to clean up first. It ends the program with [`die`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("nobody reads the output any more")]
pub struct ReaderGone;

/// From now on the process ends by SIGPIPE where `print!` or `eprint!` find that nobody reads any more. To be called once, at the
/// start of a program.
pub fn end_quietly() {
    let others = take_hook();
    set_hook(Box::new(move |panic| {
        if is_closed_pipe(panic) {
            die();
        }
        others(panic);
    }));
}

/// Ends the process by SIGPIPE, as if it had never been ignored.
pub fn die() -> ! {
    // SAFETY: this sets no handler, so that no code of ours runs in one.
    let restored = unsafe { signal(Signal::SIGPIPE, SigHandler::SigDfl) };
    if restored.is_ok() {
        let _ = raise(Signal::SIGPIPE);
    }
    // Where the signal is blocked: the same status, as a shell shows it.
    std::process::exit(128 + Signal::SIGPIPE as i32)
}

fn is_closed_pipe(panic: &PanicHookInfo<'_>) -> bool {
    panic.payload_as_str().is_some_and(|text| {
        text.starts_with("failed printing to std") && text.ends_with(&format!("(os error {})", libc_epipe()))
    })
}

fn libc_epipe() -> i32 {
    nix::errno::Errno::EPIPE as i32
}
