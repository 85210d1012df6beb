//! The way back from scene text to its facts, which shows that the text loses none:
//! `parse(write(d)) = d` (for the brief form: of the nearest agents; for the compact form: of the
//! reduced description).
//!
//! Unit tests and integration tests share this folder. The module that includes it has
//! `environment` and `world` in scope.

mod compact;
mod lexer;
mod paper;

use super::{environment, world};
use environment::text::{Description, TextForm};
use lexer::TextError;

/// Words of every compact text: 2 for the speed, 2 for the limit, 3 for the light, 2 for the turn,
/// 4 a node, 2 for the rest.
pub(crate) const COMPACT_WORDS: usize = 2 + 2 + 3 + 2 + 4 * 9 + 2;

/// Reads a text back. The errors are all that is not as `write` would have written it, each with
/// its place.
pub(crate) fn parse(text: &str, set: TextForm) -> Result<Description, Vec<TextError>> {
    match set {
        TextForm::Paper => paper::parse(text),
        TextForm::Brief => paper::parse(text).map(|description| description.nearest()),
        TextForm::Compact => compact::parse(text, false),
        TextForm::Compact2 => compact::parse(text, true),
    }
}
