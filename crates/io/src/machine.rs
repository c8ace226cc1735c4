//! What this program runs on, as far as a measurement of time depends on it.

/// What is said of a machine beside a measurement.
#[derive(Debug, Clone, PartialEq)]
pub struct Machine {
    /// Name of the processor; `unknown` where the system does not tell.
    pub processor: String,
    /// Cores that this program may use.
    pub cores: usize,
    /// Processes that ran or waited for a core, averaged over the last minute.
    pub load: Option<f64>,
}

/// The machine that this program runs on, now.
#[must_use]
pub fn machine() -> Machine {
    let read = |path: &str| std::fs::read_to_string(path).unwrap_or_default();
    let processor = read("/proc/cpuinfo")
        .lines()
        .find_map(|line| line.strip_prefix("model name")?.split_once(": ").map(|(_, name)| name.to_owned()));
    Machine {
        processor: processor.unwrap_or_else(|| "unknown".to_owned()),
        cores: std::thread::available_parallelism().map_or(0, std::num::NonZero::get),
        load: read("/proc/loadavg").split(' ').next().and_then(|word| word.parse().ok()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_machine_has_a_processor_and_cores() {
        let machine = machine();
        assert!(machine.cores > 0 && !machine.processor.is_empty(), "{machine:?}");
    }
}
