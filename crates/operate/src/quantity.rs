//! Times and sizes as people write them on a command line.

use std::time::Duration;

/// Reads `500ms`, `10s`, `1.5` (seconds), `10min`, `2m`, `2h`.
///
/// # Errors
///
/// A sentence that says how to write it.
pub fn duration(text: &str) -> Result<Duration, String> {
    let (number, unit) = split(text);
    let factor = match unit {
        "" | "s" => 1.0,
        "ms" => 1e-3,
        "m" | "min" => 60.0,
        "h" => 3600.0,
        _ => return Err(format!("`{unit}` is no unit of time: write e.g. `500ms`, `10s`, `10min` or `2h`")),
    };
    number.parse::<f64>().ok().and_then(|n| time(n * factor)).ok_or_else(|| no_duration(text))
}

/// A number of seconds as a time.
///
/// # Errors
///
/// A sentence that says how to write it.
pub fn seconds(number: f64) -> Result<Duration, String> {
    time(number).ok_or_else(|| no_duration(&number.to_string()))
}

fn time(seconds: f64) -> Option<Duration> {
    // Far longer than any machine runs, and short enough to be added to any instant.
    (seconds > 0.0 && seconds < 1e9).then(|| Duration::from_secs_f64(seconds))
}

fn no_duration(text: &str) -> String {
    format!("`{text}` is no duration: write e.g. `500ms`, `10s`, `10min` or `2h`")
}

/// Reads `1GiB`, `500MB`, `4096` (bytes).
///
/// # Errors
///
/// A sentence that says how to write it.
pub fn size(text: &str) -> Result<u64, String> {
    let (number, unit) = split(text);
    let factor: f64 = match unit {
        "" | "B" => 1.0,
        "kB" => 1e3,
        "MB" => 1e6,
        "GB" => 1e9,
        "KiB" | "K" => 1024.0,
        "MiB" | "M" => 1_048_576.0,
        "GiB" | "G" => 1_073_741_824.0,
        _ => return Err(format!("`{unit}` is no unit of size: write e.g. `500MB` or `1GiB`")),
    };
    match number.parse::<f64>().map(|n| n * factor) {
        Ok(bytes) if (1.0..1e15).contains(&bytes) => Ok(bytes as u64),
        _ => Err(no_size(text)),
    }
}

/// A number of bytes as a size.
///
/// # Errors
///
/// A sentence that says how to write it.
pub fn bytes(number: u64) -> Result<u64, String> {
    if (1..1_000_000_000_000_000).contains(&number) { Ok(number) } else { Err(no_size(&number.to_string())) }
}

fn no_size(text: &str) -> String {
    format!("`{text}` is no size: write e.g. `500MB` or `1GiB`")
}

fn split(text: &str) -> (&str, &str) {
    let text = text.trim();
    let (number, unit) = text.split_at(text.find(|c: char| c.is_ascii_alphabetic()).unwrap_or(text.len()));
    (number.trim_end(), unit)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_and_sizes_read_as_people_write_them() {
        assert_eq!(duration("10s"), Ok(Duration::from_secs(10)));
        assert_eq!(duration("10min"), Ok(Duration::from_secs(600)));
        assert_eq!(duration("2m"), Ok(Duration::from_secs(120)));
        assert_eq!(duration("3h"), Ok(Duration::from_secs(10_800)));
        assert_eq!(duration("1.5"), Ok(Duration::from_millis(1500)));
        assert_eq!(duration("20 ms"), Ok(Duration::from_millis(20)));
        assert_eq!(size("1GiB"), Ok(1 << 30));
        assert_eq!(size("1.5 MB"), Ok(1_500_000));
        assert_eq!(size("77"), Ok(77));
        for bad in ["", "s", "-1s", "3y", "NaN", "inf", "0"] {
            assert!(duration(bad).is_err() && size(bad).is_err(), "{bad}");
        }
        for bad in [-1.0, 0.0, f64::NAN, f64::INFINITY, 1e30] {
            assert!(seconds(bad).is_err() && duration(&bad.to_string()).is_err(), "{bad}");
        }
        assert_eq!(seconds(0.5), duration("500ms"));
        assert_eq!((bytes(77), bytes(0).is_err(), bytes(u64::MAX).is_err()), (Ok(77), true, true));
    }
}
