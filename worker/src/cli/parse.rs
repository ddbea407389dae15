//! Values of flags.

use farm_film::Resolution;
use std::time::Duration;

/// `960x540`.
pub fn resolution(text: &str) -> Result<Resolution, String> {
    let number = |part: &str| part.trim().parse::<u32>().ok();
    let (width, height) = text
        .split_once(['x', 'X'])
        .and_then(|(width, height)| Some((number(width)?, number(height)?)))
        .ok_or("write WIDTHxHEIGHT in pixels, for example 960x540")?;
    Resolution::new(width, height).map_err(|err| err.to_string())
}

/// `90s`, `5m`, `2h`, `250ms`, or plain seconds.
pub fn duration(text: &str) -> Result<Duration, String> {
    let units = [("ms", 1e-3), ("s", 1.0), ("m", 60.0), ("h", 3600.0), ("", 1.0)];
    let seconds = units.iter().find_map(|(unit, seconds)| {
        let number: f64 = text.strip_suffix(unit)?.trim().parse().ok()?;
        Some(number * seconds)
    });
    seconds
        .and_then(|seconds| Duration::try_from_secs_f64(seconds).ok())
        .ok_or_else(|| "write a time such as 90s, 5m, 2h or 250ms".to_owned())
}

/// `500M`, `20G`, `1.5T`, or plain bytes; decimal.
pub fn bytes(text: &str) -> Result<u64, String> {
    let units = [("k", 1e3), ("M", 1e6), ("G", 1e9), ("T", 1e12), ("", 1.0)];
    let bytes = units.iter().find_map(|(unit, bytes)| {
        let number: f64 = text.strip_suffix(unit)?.trim().parse().ok()?;
        Some(number * bytes)
    });
    bytes
        .filter(|bytes| (1.0..1e18).contains(bytes))
        .map(|bytes| bytes as u64)
        .ok_or_else(|| "write a size such as 500M or 20G".to_owned())
}

/// A number within `range`, finite.
pub(crate) fn real(range: std::ops::RangeFrom<f64>) -> impl Fn(&str) -> Result<f64, String> + Clone {
    move |text| match text.parse::<f64>() {
        Ok(value) if value.is_finite() && range.contains(&value) => Ok(value),
        Ok(value) => Err(format!("{value} is not a finite number of at least {}", range.start)),
        Err(_) => Err("write a number".to_owned()),
    }
}

/// A finite number above zero.
pub(crate) fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() && value > 0.0 => Ok(value),
        Ok(value) => Err(format!("{value} is not a finite number above 0")),
        Err(_) => Err("write a number".to_owned()),
    }
}

/// A radiance above zero that single precision holds.
pub(crate) fn brightness(text: &str) -> Result<f32, String> {
    match text.parse::<f32>() {
        Ok(value) if value.is_finite() && value > 0.0 => Ok(value),
        Ok(value) => Err(format!("{value} is not a finite radiance above 0")),
        Err(_) => Err("write a number".to_owned()),
    }
}

/// A distance above zero in metres, or `inf`.
pub(crate) fn distance(text: &str) -> Result<f32, String> {
    match text.parse::<f32>() {
        Ok(value) if value > 0.0 => Ok(value),
        Ok(value) => Err(format!("{value} is not a distance above 0 metres")),
        Err(_) => Err("write a distance in metres, or inf".to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn resolutions_read_as_they_are_written() {
        assert_eq!(resolution("960x540"), Ok(Resolution::new(960, 540).unwrap()));
        for wrong in ["", "960", "960x", "x540", "0x540", "-1x5", "960x540x2", "99999999x1", "1e3x5"] {
            assert!(resolution(wrong).is_err(), "{wrong:?} is no resolution");
        }
    }

    #[test]
    fn durations_read_as_they_are_written() {
        assert_eq!(duration("90s"), Ok(Duration::from_secs(90)));
        assert_eq!(duration("250ms"), Ok(Duration::from_millis(250)));
        assert_eq!(duration("1.5m"), Ok(Duration::from_secs(90)));
        assert_eq!(duration("2h"), Ok(Duration::from_secs(7200)));
        assert_eq!(duration("7"), Ok(Duration::from_secs(7)));
        for wrong in ["", "s", "-1s", "nan", "inf", "5 days"] {
            assert!(duration(wrong).is_err(), "{wrong:?} is no duration");
        }
    }

    #[test]
    fn sizes_read_as_they_are_written() {
        assert_eq!(
            ["20G", "1.5M", "7k", "9"].map(|text| bytes(text).unwrap()),
            [20_000_000_000, 1_500_000, 7_000, 9]
        );
        for wrong in ["", "G", "-1G", "0", "nan", "5 apples", "1e30"] {
            assert!(bytes(wrong).is_err(), "{wrong:?} is no size");
        }
    }

    #[test]
    fn numbers_out_of_range_are_refused() {
        assert_eq!(real(0.0..)("0.5"), Ok(0.5));
        for wrong in ["-0.1", "nan", "inf", "x"] {
            assert!(real(0.0..)(wrong).is_err(), "{wrong:?}");
        }
        assert_eq!(distance("inf"), Ok(f32::INFINITY));
        for wrong in ["0", "-1", "nan", "x"] {
            assert!(distance(wrong).is_err(), "{wrong:?}");
        }
        assert!(positive("0").is_err());
    }
}
