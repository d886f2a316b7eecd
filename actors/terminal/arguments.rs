//! Types of command-line values: sizes in pixels and bytes, durations, percentages.

use std::str::FromStr;
use std::time::Duration;

use bytesize::ByteSize;

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

/// A length of time up to some months: `16ms`, `2s`, `1.5min`, `1h 30min`; a bare number is seconds.
pub fn duration(s: &str) -> Result<Duration, String> {
    let wrong = || format!("`{s}` is not a time; write it as 16ms, 2s or 1min");
    let parsed = match s.trim().parse() {
        Ok(seconds) => Duration::try_from_secs_f64(seconds).map_err(|_| wrong())?,
        Err(_) => humantime::parse_duration(s).map_err(|_| wrong())?,
    };
    if parsed > Duration::from_secs(10_000_000) { Err(wrong()) } else { Ok(parsed) }
}

/// A number of bytes, at most 1 PB: `64MiB`, `1.5GiB`, `100kB`; a bare number is bytes.
pub fn bytes(s: &str) -> Result<u64, String> {
    match s.parse::<ByteSize>() {
        Ok(size) if size <= ByteSize::pb(1) => Ok(size.as_u64()),
        _ => Err(format!("`{s}` is not a size; write it as 64MiB")),
    }
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

/// One of how many: `1/64`.
pub fn one_of(s: &str) -> Result<u32, String> {
    match s.trim().strip_prefix("1/").and_then(|many| many.parse().ok()) {
        Some(many) if many > 0 => Ok(many),
        _ => Err(format!("`{s}` is not one of so many; write it as 1/64")),
    }
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
        assert_eq!(duration("1h 30min"), Ok(Duration::from_secs(5400)));
        for s in ["", "ms", "1x", "-1s", "-1", "nan", "inf", "nans", "infs", "1000y", "1e300"] {
            assert!(duration(s).is_err(), "{s}");
        }
        assert_eq!(bytes("64MiB"), Ok(64 << 20));
        assert_eq!(bytes("1.5GiB"), Ok(3 << 29));
        for s in ["", "MiB", "-1", "nan", "inf", "1x", "2PB", "99999999999999999999999"] {
            assert!(bytes(s).is_err(), "{s}");
        }
        assert_eq!(share("2%"), Ok(0.02));
        assert!(share("0").is_err() && share("nan").is_err());
        assert_eq!((one_of("1/64"), one_of("1/1")), (Ok(64), Ok(1)));
        assert!(one_of("1/0").is_err() && one_of("2/3").is_err() && one_of("64").is_err());
        assert!(unit("1.1").is_err() && unit("nan").is_err() && unit("0.5") == Ok(0.5));
        assert!(positive("0").is_err() && positive("inf").is_err());
    }
}
