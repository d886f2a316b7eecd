//! Types of command-line values: sizes in pixels and bytes, durations, percentages.

use std::str::FromStr;
use std::time::Duration;

/// A picture size, `WIDTHxHEIGHT`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Size {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

impl FromStr for Size {
    type Err = String;

    fn from_str(s: &str) -> Result<Self, String> {
        let wrong = || format!("`{s}` is not a picture size; write it as 512x512");
        let (w, h) = s.split_once(['x', 'X', '×']).ok_or_else(wrong)?;
        let (width, height) = (w.parse().map_err(|_| wrong())?, h.parse().map_err(|_| wrong())?);
        if !(1..=16384).contains(&width)
            || !(1..=16384).contains(&height)
            || width as u64 * height as u64 > 1 << 26
        {
            return Err(format!("`{s}`: each side 1 to 16384, at most 64 Mi pixels"));
        }
        Ok(Self { width, height })
    }
}

/// A length of time: `16ms`, `2s`, `1.5min`; a bare number is seconds.
pub fn duration(s: &str) -> Result<Duration, String> {
    let wrong = || format!("`{s}` is not a time; write it as 16ms, 2s or 1min");
    let at = s.find(|c: char| c.is_ascii_alphabetic()).unwrap_or(s.len());
    let (number, unit) = s.split_at(at);
    let number: f64 = number.trim().parse().map_err(|_| wrong())?;
    let factor = match unit {
        "us" | "µs" => 1e-6,
        "ms" => 1e-3,
        "" | "s" => 1.0,
        "min" | "m" => 60.0,
        "h" => 3600.0,
        _ => return Err(wrong()),
    };
    let seconds = number * factor;
    if !(0.0..=1e7).contains(&seconds) {
        return Err(wrong());
    }
    Ok(Duration::from_secs_f64(seconds))
}

/// A number of bytes: `64MiB`, `1.5GiB`, `100kB`; a bare number is bytes.
pub fn bytes(s: &str) -> Result<u64, String> {
    let wrong = || format!("`{s}` is not a size; write it as 64MiB");
    let at = s.find(|c: char| c.is_ascii_alphabetic()).unwrap_or(s.len());
    let (number, unit) = s.split_at(at);
    let number: f64 = number.trim().parse().map_err(|_| wrong())?;
    let factor = match unit {
        "" | "B" => 1.0,
        "kB" | "KB" => 1e3,
        "MB" => 1e6,
        "GB" => 1e9,
        "KiB" => 1024.0,
        "MiB" => 1_048_576.0,
        "GiB" => 1_073_741_824.0,
        _ => return Err(wrong()),
    };
    let size = number * factor;
    if !(0.0..=1e15).contains(&size) {
        return Err(wrong());
    }
    Ok(size as u64)
}

/// A share: `2%` or `0.02`.
pub fn share(s: &str) -> Result<f32, String> {
    let wrong = || format!("`{s}` is not a share; write it as 2%");
    let (number, scale) = s.strip_suffix('%').map_or((s, 1.0), |n| (n, 0.01));
    let value: f32 = number.trim().parse().map_err(|_| wrong())?;
    if !(value > 0.0 && value.is_finite()) {
        return Err(wrong());
    }
    Ok(value * scale)
}

/// A number above zero and below a million.
pub fn positive(s: &str) -> Result<f32, String> {
    match s.parse::<f32>() {
        Ok(v) if v > 0.0 && v < 1e6 => Ok(v),
        _ => Err(format!("`{s}`: a number above 0 and below 1000000 is needed")),
    }
}

/// A number from 0 to 1.
pub fn unit(s: &str) -> Result<f32, String> {
    match s.parse::<f32>() {
        Ok(v) if (0.0..=1.0).contains(&v) => Ok(v),
        _ => Err(format!("`{s}`: a number from 0 to 1 is needed")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_parse_and_nonsense_is_refused() {
        assert_eq!("512x384".parse(), Ok(Size { width: 512, height: 384 }));
        for s in ["512", "0x4", "4x0", "x", "99999x1", "-1x4", "8192x16384"] {
            assert!(s.parse::<Size>().is_err(), "{s}");
        }
        assert_eq!(duration("16ms"), Ok(Duration::from_millis(16)));
        assert_eq!(duration("1.5min"), Ok(Duration::from_secs(90)));
        assert_eq!(duration("2"), Ok(Duration::from_secs(2)));
        for s in ["", "ms", "1x", "-1s", "nans", "infs"] {
            assert!(duration(s).is_err(), "{s}");
        }
        assert_eq!(bytes("64MiB"), Ok(64 << 20));
        assert!(bytes("64mib").is_err() && bytes("-1").is_err());
        assert_eq!(share("2%"), Ok(0.02));
        assert!(share("0").is_err() && share("nan").is_err());
        assert!(unit("1.1").is_err() && unit("nan").is_err() && unit("0.5") == Ok(0.5));
        assert!(positive("0").is_err() && positive("inf").is_err());
    }
}
