//! Times and sizes as people write them on a command line.

use std::time::Duration;

/// Reads `500ms`, `10s`, `1.5` (seconds), `10min`, `2h`.
pub fn duration(text: &str) -> Result<Duration, String> {
    let (number, unit) = split(text);
    let factor = match unit {
        "" | "s" => 1.0,
        "ms" => 1e-3,
        "m" | "min" => 60.0,
        "h" => 3600.0,
        _ => return Err(format!("`{unit}` is no unit of time: write e.g. `500ms`, `10s`, `10min` or `2h`")),
    };
    match number.parse::<f64>().map(|n| n * factor) {
        Ok(seconds) if seconds > 0.0 && seconds < 1e9 => Ok(Duration::from_secs_f64(seconds)),
        _ => Err(format!("`{text}` is no duration: write e.g. `500ms`, `10s`, `10min` or `2h`")),
    }
}

/// Reads `1GiB`, `500MB`, `4096` (bytes).
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
        _ => Err(format!("`{text}` is no size: write e.g. `500MB` or `1GiB`")),
    }
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
        assert_eq!(duration("10min"), Ok(Duration::from_secs(600)));
        assert_eq!(duration("1.5"), Ok(Duration::from_millis(1500)));
        assert_eq!(duration("20 ms"), Ok(Duration::from_millis(20)));
        assert_eq!(size("1GiB"), Ok(1 << 30));
        assert_eq!(size("1.5 MB"), Ok(1_500_000));
        assert_eq!(size("77"), Ok(77));
        for bad in ["", "s", "-1s", "3y", "NaN", "inf", "0"] {
            assert!(duration(bad).is_err() && size(bad).is_err(), "{bad}");
        }
    }
}
