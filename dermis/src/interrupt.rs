//! How people end what goes on: Ctrl-C and SIGTERM.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context, Result};

/// A flag that Ctrl-C or SIGTERM sets.
pub fn stop_on_interrupt() -> Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&stop);
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    std::thread::Builder::new().name("interrupt".to_owned()).spawn(move || {
        runtime.block_on(async {
            if let Ok(ended) = ended() {
                ended.await;
                flag.store(true, Ordering::Release);
            }
        });
    })?;
    Ok(stop)
}

/// Ends with Ctrl-C or SIGTERM, from now on.
pub fn ended() -> Result<impl Future<Output = ()>> {
    dermis_node::signalled().context("Ctrl-C and SIGTERM cannot be waited for")
}
