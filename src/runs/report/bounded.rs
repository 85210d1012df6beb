//! Lists of records with a maximum length, for serde.

use serde::de::{Error, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer};
use std::fmt;
use std::marker::PhantomData;

/// Reads a list of at most `MAX` entries.
pub(super) fn at_most<'de, D, T, const MAX: usize>(deserializer: D) -> Result<Vec<T>, D::Error>
where
    D: Deserializer<'de>,
    T: Deserialize<'de>,
{
    struct AtMost<T, const MAX: usize>(PhantomData<T>);

    impl<'de, T: Deserialize<'de>, const MAX: usize> Visitor<'de> for AtMost<T, MAX> {
        type Value = Vec<T>;

        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            write!(f, "a list of at most {MAX} entries")
        }

        fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Vec<T>, A::Error> {
            let mut entries = Vec::new();
            while let Some(entry) = list.next_element()? {
                if entries.len() == MAX {
                    return Err(A::Error::custom(format!(
                        "a list has more than {MAX} entries, which is the limit"
                    )));
                }
                entries.push(entry);
            }
            Ok(entries)
        }
    }

    deserializer.deserialize_seq(AtMost::<T, MAX>(PhantomData))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, Deserialize)]
    struct Record {
        #[serde(deserialize_with = "at_most::<_, _, 3>")]
        entries: Vec<u8>,
    }

    #[test]
    fn a_longer_list_is_refused() {
        let read = |text: &str| serde_json::from_str::<Record>(text).map(|record| record.entries);
        assert_eq!(read(r#"{"entries": [1, 2, 3]}"#).unwrap(), [1, 2, 3]);
        let error = read(r#"{"entries": [1, 2, 3, 4]}"#)
            .unwrap_err()
            .to_string();
        assert!(error.contains("more than 3 entries"), "{error}");
    }
}
