//! Words of commands that a message or a page shows.

/// A word as a shell takes it.
pub fn quoted(word: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./#:=@+,%".contains(c);
    if !word.is_empty() && word.chars().all(plain) {
        word.to_owned()
    } else {
        format!("'{}'", word.replace('\'', r"'\''"))
    }
}

#[cfg(test)]
mod tests {
    use super::quoted;

    #[test]
    fn only_plain_words_stand_alone() {
        assert_eq!(
            ["runs/0001", "a b", "it's", ""].map(quoted),
            ["runs/0001", "'a b'", r"'it'\''s'", "''"]
        );
    }
}
