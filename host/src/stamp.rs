//! Date and time, for names and records.

use std::time::{SystemTime, UNIX_EPOCH};

/// Date and time now, UTC, as in 20260301-120000.
#[must_use]
pub(crate) fn utc_stamp() -> String {
    stamp(unix_s())
}

/// Seconds since 1970 now.
#[must_use]
pub(crate) fn unix_s() -> u64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    since.map_or(0, |since| since.as_secs())
}

/// Hour and minute of a Unix time, UTC.
#[must_use]
pub(crate) const fn utc_clock(seconds: u64) -> (u64, u64) {
    (seconds / 3600 % 24, seconds / 60 % 60)
}

/// Date and time of a Unix time, Gregorian calendar.
fn stamp(seconds: u64) -> String {
    let (mut days, clock) = (seconds / 86_400, seconds % 86_400);
    let mut year = 1970;
    let leap = |year: u64| {
        (year.is_multiple_of(4) && !year.is_multiple_of(100)) || year.is_multiple_of(400)
    };
    while days >= 365 + u64::from(leap(year)) {
        days -= 365 + u64::from(leap(year));
        year += 1;
    }
    let february = 28 + u64::from(leap(year));
    let mut month = 1;
    for length in [31, february, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31] {
        if days < length {
            break;
        }
        days -= length;
        month += 1;
    }
    let (hour, minute, second) = (clock / 3600, clock / 60 % 60, clock % 60);
    format!(
        "{year}{month:02}{:02}-{hour:02}{minute:02}{second:02}",
        days + 1
    )
}

#[cfg(test)]
mod tests {
    use super::stamp;

    #[test]
    fn stamps_follow_the_calendar() {
        assert_eq!(stamp(0), "19700101-000000");
        // Leap days: 2000-02-29 and 2024-02-29, and the day after.
        assert_eq!(stamp(951_827_696), "20000229-123456");
        assert_eq!(stamp(1_709_251_199), "20240229-235959");
        assert_eq!(stamp(1_709_251_200), "20240301-000000");
        assert_eq!(stamp(4_107_542_399), "21000228-235959");
        assert_eq!(stamp(4_107_542_400), "21000301-000000");
    }
}
