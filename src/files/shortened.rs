//! Texts of files in messages.

use std::borrow::Cow;

/// Most bytes of a text from outside that a message shows.
pub(crate) const MAX_SHOWN_BYTES: usize = 4096;
/// Bytes of a mark in the place of what is left out.
const MARK_BYTES: usize = 64;

/// A text of at most [`MAX_SHOWN_BYTES`]: its begin and its end, because messages about a long line
/// say at the end what is wrong with it.
pub fn shortened(text: &str) -> Cow<'_, str> {
    if text.len() <= MAX_SHOWN_BYTES {
        return Cow::Borrowed(text);
    }
    let left = MAX_SHOWN_BYTES - MARK_BYTES;
    let head = (0..=left * 3 / 4)
        .rev()
        .find(|&at| text.is_char_boundary(at))
        .expect("the begin of a text is a boundary");
    let tail = (text.len() - left / 4..=text.len())
        .find(|&at| text.is_char_boundary(at))
        .expect("the end of a text is a boundary");
    let (begin, end) = (&text[..head], &text[tail..]);
    Cow::Owned(format!("{begin} [{} bytes left out] {end}", tail - head))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn begin_and_end_of_a_long_text_stay() {
        assert_eq!(shortened("short"), "short");
        for letter in ["a", "ü", "汉"] {
            let long = format!("begin{}end", letter.repeat(1_000_000));
            let short = shortened(&long);
            assert!(
                short.len() <= MAX_SHOWN_BYTES
                    && short.starts_with("begin")
                    && short.ends_with("end"),
                "{}",
                short.len()
            );
            assert!(short.contains("bytes left out"));
        }
    }
}
