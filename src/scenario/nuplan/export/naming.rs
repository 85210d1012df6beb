//! Names of tokens, files and locations. They depend on the content only: the same scenario gets
//! the same names everywhere.

use crate::nuplan::token::{TOKEN_BYTES, Token};
use std::path::Path;

/// The tokens of one log.
#[derive(Debug, Clone, Copy)]
pub(super) struct Tokens<'a> {
    log: &'a str,
}

impl<'a> Tokens<'a> {
    pub(super) fn new(log: &'a str) -> Self {
        Self { log }
    }

    /// The token of the `number`-th row of a table: the first bytes of BLAKE3 over log, table and
    /// number.
    pub(super) fn token(&self, table: &str, number: u64) -> Token {
        let mut hasher = blake3::Hasher::new();
        for part in [self.log.as_bytes(), table.as_bytes(), &number.to_le_bytes()] {
            hasher.update(&(part.len() as u64).to_le_bytes());
            hasher.update(part);
        }
        let mut bytes = [0; TOKEN_BYTES];
        hasher.finalize_xof().fill(&mut bytes);
        Token::new(bytes)
    }
}

/// A text as a portable file name: anything but letters, digits, dots, minuses and underscores
/// becomes an underscore.
pub(super) fn file_name(text: &str) -> String {
    let safe = |c: char| {
        if c.is_ascii_alphanumeric() || "._-".contains(c) {
            c
        } else {
            '_'
        }
    };
    let name: String = text.chars().map(safe).collect();
    // A leading dot would hide the file, or leave the folder.
    let name = name.trim_start_matches('.');
    if name.is_empty() {
        "scenario".to_owned()
    } else {
        name.to_owned()
    }
}

/// Name of the written log: the name of the scenario's log and its id, as one file name.
pub(super) fn log_name(log: &str, id: &str) -> String {
    let (log, id) = (file_name(log), file_name(id));
    if log == id { id } else { format!("{log}_{id}") }
}

/// Whether a text can name a folder.
pub(super) fn is_folder_name(text: &str) -> bool {
    !text.is_empty() && file_name(text) == text && Path::new(text).components().count() == 1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tokens_differ_by_log_table_and_number() {
        let token = |log, table, number| Tokens::new(log).token(table, number);
        assert_eq!(token("a", "track", 1), token("a", "track", 1));
        let all = [
            token("a", "track", 1),
            token("a", "track", 2),
            token("a", "trac", 1),
            token("at", "rack", 1),
        ];
        assert!((0..4).all(|i| (0..i).all(|j| all[i] != all[j])));
    }

    #[test]
    fn names_are_safe() {
        assert_eq!(
            log_name("generated-2", "generated/changing_lane/2"),
            "generated-2_generated_changing_lane_2"
        );
        assert_eq!(log_name("x", "x"), "x");
        assert_eq!(file_name("../../etc/passwd"), "_.._etc_passwd");
        assert_eq!(file_name(".."), "scenario");
        assert!(
            is_folder_name("us-nv-las-vegas-strip")
                && !is_folder_name("a/b")
                && !is_folder_name("..")
        );
    }
}
