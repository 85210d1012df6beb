//! The forms in which a text may repeat a key.

use base64::Engine;
use base64::engine::general_purpose::{STANDARD_NO_PAD, URL_SAFE_NO_PAD};
use std::collections::BTreeSet;

/// Shortest part of a key that is hidden where the rest is missing, bytes. A shorter one tells
/// nothing and can be a word.
const MIN_PART: usize = 12;
/// The same in base64, where four characters hold three bytes.
const MIN_PART_BASE64: usize = MIN_PART * 4 / 3;
/// Keys with fewer bytes are hidden only where they stand as a word: else a key such as `none`
/// would tear texts apart.
const MIN_KEY: usize = 8;
/// Bytes that are looked up before a form is compared.
const GRAM: usize = 4;

/// A key in all its forms.
#[derive(Clone)]
pub(super) struct Forms {
    key: String,
    /// Each with the shortest part of it that is hidden.
    spellings: Vec<(Vec<u8>, usize)>,
    grams: BTreeSet<[u8; GRAM]>,
}

/// A byte of a text with its place there.
struct Unit {
    byte: u8,
    from: usize,
    to: usize,
}

impl Forms {
    pub(super) fn from_key(key: &str) -> Self {
        let mut forms = Vec::new();
        let mut add = |bytes: Vec<u8>, min_part: usize| {
            let min_part = min_part.min(bytes.len());
            if bytes.len() >= GRAM && !forms.contains(&(bytes.clone(), min_part)) {
                forms.push((bytes, min_part));
            }
        };
        if key.len() >= MIN_KEY {
            add(key.as_bytes().to_vec(), MIN_PART);
            for before in 0..3 {
                // In base64 a text looks different at each of three places.
                let padded = [vec![0; before], key.as_bytes().to_vec()].concat();
                let (from, to) = ((before * 8).div_ceil(6), padded.len() * 8 / 6);
                for encoded in [
                    STANDARD_NO_PAD.encode(&padded),
                    URL_SAFE_NO_PAD.encode(&padded),
                ] {
                    add(
                        encoded
                            .as_bytes()
                            .get(from..to)
                            .expect("the key's digits lie within the code")
                            .to_vec(),
                        MIN_PART_BASE64,
                    );
                }
            }
            let digits = |upper: bool| {
                let digit = |byte: u8| {
                    if upper {
                        format!("{byte:02X}")
                    } else {
                        format!("{byte:02x}")
                    }
                };
                key.bytes().map(digit).collect::<String>().into_bytes()
            };
            add(digits(false), 2 * MIN_PART);
            add(digits(true), 2 * MIN_PART);
        }
        let grams = forms
            .iter()
            .flat_map(|(form, _)| form.windows(GRAM))
            .filter_map(|gram| gram.try_into().ok());
        Self {
            key: key.to_owned(),
            grams: grams.collect(),
            spellings: forms,
        }
    }

    /// A text with `mark` in the place of the key.
    pub(super) fn replaced(&self, text: &str, mark: &str) -> String {
        if self.spellings.is_empty() {
            return self.word_replaced(text, mark);
        }
        // As it is too: the key itself may look like an escape.
        let mut spans = [self.spans(&plain(text)), self.spans(&unescaped(text))].concat();
        spans.sort_unstable();
        let (mut out, mut copied) = (String::with_capacity(text.len()), 0);
        for (from, to) in spans {
            // A key may have letters of several bytes: one that a span cuts is hidden whole.
            let (from, to) = (text.floor_char_boundary(from), text.ceil_char_boundary(to));
            if from >= copied {
                out.push_str(&text[copied..from]);
                out.push_str(mark);
            }
            copied = copied.max(to);
        }
        out.push_str(&text[copied..]);
        out
    }

    /// Where parts of the key begin and end in a text of these units.
    fn spans(&self, units: &[Unit]) -> Vec<(usize, usize)> {
        let bytes: Vec<u8> = units.iter().map(|unit| unit.byte).collect();
        let (mut spans, mut at) = (Vec::new(), 0);
        while at < units.len() {
            let length = self.match_at(&bytes[at..]);
            let matched = &units[at..at + length];
            if let (Some(first), Some(last)) = (matched.first(), matched.last()) {
                spans.push((first.from, last.to));
            }
            at += length.max(1);
        }
        spans
    }

    /// Length of the longest part of a form that the bytes begin with; 0 if it is too short to
    /// hide.
    fn match_at(&self, bytes: &[u8]) -> usize {
        let gram: Option<[u8; GRAM]> = bytes.get(..GRAM).and_then(|gram| gram.try_into().ok());
        let Some(gram) = gram.filter(|gram| self.grams.contains(gram)) else {
            return 0;
        };
        let of_form = |(form, min_part): &(Vec<u8>, usize)| {
            let starts = form
                .windows(GRAM)
                .enumerate()
                .filter(|(_, window)| **window == gram)
                .map(|(start, _)| start);
            let common = |start: usize| {
                let rest = &form[start..];
                rest.iter().zip(bytes).take_while(|(a, b)| a == b).count()
            };
            starts
                .map(common)
                .max()
                .filter(|length| length >= min_part)
                .unwrap_or(0)
        };
        self.spellings.iter().map(of_form).max().unwrap_or(0)
    }

    /// Replaces a short key where no letter or digit stands beside it.
    fn word_replaced(&self, text: &str, mark: &str) -> String {
        let mut out = String::with_capacity(text.len());
        let mut copied = 0;
        for (from, _) in text.match_indices(&self.key) {
            let to = from + self.key.len();
            let before = text
                .get(..from)
                .and_then(|before| before.chars().next_back());
            let after = text.get(to..).and_then(|after| after.chars().next());
            if ![before, after]
                .into_iter()
                .flatten()
                .any(char::is_alphanumeric)
            {
                out.push_str(&text[copied..from]);
                out.push_str(mark);
                copied = to;
            }
        }
        out.push_str(&text[copied..]);
        out
    }
}

fn plain(text: &str) -> Vec<Unit> {
    text.bytes()
        .enumerate()
        .map(|(at, byte)| Unit {
            byte,
            from: at,
            to: at + 1,
        })
        .collect()
}

/// The bytes that escapes of addresses (`%2D`), JSON (`\u002d`, `\/`), programs (`\x2d`) and HTML
/// (`&#45;`) stand for.
fn unescaped(text: &str) -> Vec<Unit> {
    let mut units = Vec::with_capacity(text.len());
    let mut from = 0;
    while let Some((&first, _)) = text.as_bytes().get(from..).and_then(<[u8]>::split_first) {
        let rest = &text.as_bytes()[from..];
        let (byte, length) = escape(rest).unwrap_or((first, 1));
        units.push(Unit {
            byte,
            from,
            to: from + length,
        });
        from += length;
    }
    units
}

/// The byte of an escape that a text begins with, and the length of the escape.
fn escape(text: &[u8]) -> Option<(u8, usize)> {
    let number = |from: usize, to: usize, radix: u32| {
        let digits = text
            .get(from..to)
            .and_then(|digits| std::str::from_utf8(digits).ok())?;
        digits
            .bytes()
            .all(|digit| digit.is_ascii_alphanumeric())
            .then(|| u8::from_str_radix(digits, radix).ok())?
    };
    match text {
        [b'%', ..] => Some((number(1, 3, 16)?, 3)),
        [b'\\', b'u', b'0', b'0', ..] => Some((number(4, 6, 16)?, 6)),
        [b'\\', b'x', ..] => Some((number(2, 4, 16)?, 4)),
        [b'\\', byte @ (b'"' | b'\\' | b'/'), ..] => Some((*byte, 2)),
        [b'&', b'#', rest @ ..] => {
            let end = rest.iter().take(6).position(|byte| *byte == b';')? + 2;
            let byte = if matches!(rest.first(), Some(b'x' | b'X')) {
                number(3, end, 16)
            } else {
                number(2, end, 10)
            };
            Some((byte?, end + 1))
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const KEY: &str = "sk-proj/a+B_9-41.zXy~0123456789";

    fn hidden(text: &str) -> String {
        Forms::from_key(KEY).replaced(text, "[key]")
    }

    #[test]
    fn a_key_is_hidden_in_every_form() {
        let percent = KEY
            .bytes()
            .map(|byte| format!("%{byte:02x}"))
            .collect::<Vec<_>>()
            .concat();
        let some = KEY.replace('/', "%2F").replace('+', "%2B");
        let json = KEY
            .bytes()
            .map(|byte| format!("\\u{byte:04X}"))
            .collect::<Vec<_>>()
            .concat();
        let html = KEY
            .bytes()
            .map(|byte| format!("&#{byte};"))
            .collect::<Vec<_>>()
            .concat();
        let hex = KEY
            .bytes()
            .map(|byte| format!("{byte:02X}"))
            .collect::<Vec<_>>()
            .concat();
        for form in [
            KEY.to_owned(),
            percent,
            some,
            KEY.replace('/', "\\/"),
            json,
            html,
            hex,
        ] {
            assert_eq!(
                hidden(&format!("é {form}, {form}!")),
                "é [key], [key]!",
                "{form}"
            );
        }
        let with_escape = "sk-proj-%41-zXy0123456789";
        assert_eq!(
            Forms::from_key(with_escape).replaced(with_escape, "[key]"),
            "[key]"
        );
    }

    #[test]
    fn base64_hides_no_key_whatever_stands_around_it() {
        for before in ["", "a", "user", "Bearer ", "user:"] {
            for after in ["", "!", "\n.", "xyz"] {
                let text = format!("{before}{KEY}{after}");
                for encoded in [STANDARD_NO_PAD.encode(&text), URL_SAFE_NO_PAD.encode(&text)] {
                    let shown = hidden(&format!("token {encoded} is wrong"));
                    assert!(shown.contains("[key]"), "{shown}");
                    // What is left decodes to what stood around the key, and to at most two
                    // characters of it.
                    let escaped = encoded.replace('+', "%2B").replace('/', "%2F");
                    assert!(
                        hidden(&escaped).len() <= 5 + (before.len() + after.len()) * 4 / 3 + 6,
                        "{escaped}"
                    );
                }
            }
        }
    }

    #[test]
    fn a_part_that_a_server_cut_is_hidden() {
        for length in MIN_PART..KEY.len() {
            assert_eq!(hidden(&KEY[..length]), "[key]");
            assert_eq!(hidden(&KEY[KEY.len() - length..]), "[key]");
        }
        assert_eq!(hidden(&KEY[..4]), &KEY[..4]);
    }

    #[test]
    fn a_key_of_long_letters_takes_no_text_with_it() {
        const KEY: &str = "\u{e9}0123456789abcdef";
        let shown = |text: &str| Forms::from_key(KEY).replaced(text, "[key]");
        assert_eq!(shown(&format!("a {KEY} z")), "a [key] z");
        // A letter that ends with the same byte.
        assert_eq!(shown("a \u{129}0123456789abcdef z"), "a [key] z");
    }

    #[test]
    fn a_short_key_is_hidden_as_a_word() {
        let forms = Forms::from_key("none");
        assert_eq!(
            forms.replaced("key 'none' in nonesuch, Anone", "[key]"),
            "key '[key]' in nonesuch, Anone"
        );
        assert_eq!(
            hidden("Generate_IDM_Planner(c=ego_lane) %zz \\u00 &#; \\"),
            "Generate_IDM_Planner(c=ego_lane) %zz \\u00 &#; \\"
        );
    }
}
