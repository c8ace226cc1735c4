#![no_main]

use libfuzzer_sys::fuzz_target;

// A panic of the container's parser is caught where it is called; any other ends the run, as everywhere.
fuzz_target!(
    init: std::panic::set_hook(Box::new(|info| {
        if !info.location().is_some_and(|at| at.file().contains("/mcap-")) {
            eprintln!("{info}");
            std::process::abort();
        }
    })),
    |data: &[u8]| dermis_fuzz::bag(data)
);
