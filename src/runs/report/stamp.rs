//! The start time of a run in nuPlan's format.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::time::SystemTime;

/// Where the digits of a stamp stand; between them are dots.
const PATTERN: &str = "0000.00.00.00.00.00";

/// `YYYY.MM.DD.hh.mm.ss` in UTC (nuPlan: `%Y.%m.%d.%H.%M.%S`). It becomes part of file names.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Stamp(String);

/// A text that is no stamp.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("'{}' is no start time; expected YYYY.MM.DD.hh.mm.ss", .0.escape_debug())]
pub struct NoStamp(String);

/// The stamp of a time.
pub fn stamp(time: SystemTime) -> Stamp {
    // Only times outside the years -9999 to 9999 have no timestamp.
    let time = Timestamp::try_from(time).unwrap_or(Timestamp::UNIX_EPOCH);
    let text = time.strftime("%Y.%m.%d.%H.%M.%S").to_string();
    Stamp::try_from(text).unwrap_or_else(|_| Stamp(PATTERN.to_owned()))
}

impl TryFrom<String> for Stamp {
    type Error = NoStamp;

    fn try_from(text: String) -> Result<Self, NoStamp> {
        let fits = |(own, expected): (u8, u8)| match expected {
            b'0' => own.is_ascii_digit(),
            _ => own == expected,
        };
        if text.len() == PATTERN.len() && text.bytes().zip(PATTERN.bytes()).all(fits) {
            Ok(Self(text))
        } else {
            Err(NoStamp(planagent_files::shortened(&text).into_owned()))
        }
    }
}

impl From<Stamp> for String {
    fn from(stamp: Stamp) -> Self {
        stamp.0
    }
}

impl fmt::Display for Stamp {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::{Duration, UNIX_EPOCH};

    #[test]
    fn stamps_are_dates() {
        let at = |seconds| stamp(UNIX_EPOCH + Duration::from_secs(seconds)).to_string();
        assert_eq!(at(951_782_400), "2000.02.29.00.00.00");
        assert_eq!(at(1_795_132_800), "2026.11.20.00.00.00");
    }

    #[test]
    fn what_is_no_date_is_no_stamp() {
        for text in [
            "",
            "a/../../outside",
            "2026.11.20.00.00.0/",
            "2026-11-20.00.00.00",
            "2026.11.20.00.00.00.00",
            "２026.11.20.00.00.00",
        ] {
            assert!(Stamp::try_from(text.to_owned()).is_err(), "{text}");
        }
    }
}
