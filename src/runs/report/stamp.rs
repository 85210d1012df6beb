//! The start time of a run in nuPlan's format.

use jiff::Timestamp;
use std::time::SystemTime;

/// `YYYY.MM.DD.hh.mm.ss` in UTC (nuPlan: `%Y.%m.%d.%H.%M.%S`).
pub fn stamp(time: SystemTime) -> String {
    // Only times outside the years -9999 to 9999 have no timestamp.
    let time = Timestamp::try_from(time).unwrap_or(Timestamp::UNIX_EPOCH);
    time.strftime("%Y.%m.%d.%H.%M.%S").to_string()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::{Duration, UNIX_EPOCH};

    #[test]
    fn stamps_are_dates() {
        let at = |seconds| stamp(UNIX_EPOCH + Duration::from_secs(seconds));
        assert_eq!(at(951_782_400), "2000.02.29.00.00.00");
        assert_eq!(at(1_795_132_800), "2026.11.20.00.00.00");
    }
}
