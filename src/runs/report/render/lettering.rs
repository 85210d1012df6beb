//! Antialiased text: the outlines of `DejaVu` Sans.

use std::sync::LazyLock;
use tiny_skia::{Path, PathBuilder, Transform};
use ttf_parser::{Face, OutlineBuilder};

/// The typefaces. Both files are part of the program.
static REGULAR: LazyLock<Option<Face<'static>>> =
    LazyLock::new(|| Face::parse(dejavu::sans::regular(), 0).ok());
static BOLD: LazyLock<Option<Face<'static>>> =
    LazyLock::new(|| Face::parse(dejavu::sans::bold(), 0).ok());

/// Longest text that is drawn, characters. Texts of a run may come from elsewhere, and a picture
/// grows with them.
const MAX_LETTERS: usize = 1_000;

/// A size and weight of type.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Lettering {
    /// Height of an em, pixels.
    pub(super) size: f32,
    pub(super) bold: bool,
}

impl Lettering {
    /// A regular weight of this size, pixels.
    pub(super) fn regular(size: f32) -> Self {
        Self { size, bold: false }
    }

    /// A bold weight of this size, pixels.
    pub(super) fn bold(size: f32) -> Self {
        Self { size, bold: true }
    }

    /// Distance between two baselines, pixels.
    pub(super) fn line(self) -> f32 {
        (1.35 * self.size).round()
    }

    /// Width of a text, pixels.
    pub(super) fn width(self, text: &str) -> f32 {
        let Some(face) = self.face() else { return 0.0 };
        text.chars().map(|letter| self.advance(face, letter)).sum()
    }

    /// The outlines of a text whose baseline starts at `(x, y)`; none without a visible letter.
    pub(super) fn outline(self, text: &str, (mut x, y): (f32, f32)) -> Option<Path> {
        let face = self.face()?;
        let mut pen = Pen(PathBuilder::new());
        let mut whole = PathBuilder::new();
        for letter in text.chars() {
            if let Some(glyph) = face.glyph_index(letter) {
                face.outline_glyph(glyph, &mut pen);
                let scale = self.scale(face);
                let placed = std::mem::replace(&mut pen.0, PathBuilder::new()).finish();
                // Outlines are in font units, y up.
                let placed = placed
                    .and_then(|p| p.transform(Transform::from_row(scale, 0.0, 0.0, -scale, x, y)));
                if let Some(path) = placed {
                    whole.push_path(&path);
                }
            }
            x += self.advance(face, letter);
        }
        whole.finish()
    }

    /// The text in lines of at most `width` pixels, broken between words, and inside a word only
    /// where it is wider than a line. A longer text than anybody reads is cut.
    pub(super) fn wrapped(self, text: &str, width: f32) -> Vec<String> {
        let cut = text.char_indices().nth(MAX_LETTERS).map(|(at, _)| at);
        let shown = cut.map(|at| format!("{}…", &text[..at]));
        let text = shown.as_deref().unwrap_or(text);
        let mut lines: Vec<String> = Vec::new();
        let mut line = String::new();
        for word in text.split_whitespace() {
            let longer = if line.is_empty() {
                word.to_owned()
            } else {
                format!("{line} {word}")
            };
            if self.width(&longer) <= width {
                line = longer;
                continue;
            }
            if !line.is_empty() {
                lines.push(std::mem::take(&mut line));
            }
            // Letter by letter: only a word that is wider than a line breaks here.
            for letter in word.chars() {
                if !line.is_empty()
                    && self.width(&line) + self.width(letter.encode_utf8(&mut [0; 4])) > width
                {
                    lines.push(std::mem::take(&mut line));
                }
                line.push(letter);
            }
        }
        if !line.is_empty() {
            lines.push(line);
        }
        lines
    }

    fn face(self) -> Option<&'static Face<'static>> {
        if self.bold {
            BOLD.as_ref()
        } else {
            REGULAR.as_ref()
        }
    }

    fn scale(self, face: &Face<'_>) -> f32 {
        self.size / f32::from(face.units_per_em())
    }

    fn advance(self, face: &Face<'_>, letter: char) -> f32 {
        let units = face
            .glyph_index(letter)
            .and_then(|glyph| face.glyph_hor_advance(glyph))
            .unwrap_or(0);
        f32::from(units) * self.scale(face)
    }
}

/// Draws a glyph into a path.
struct Pen(PathBuilder);

impl OutlineBuilder for Pen {
    fn move_to(&mut self, x: f32, y: f32) {
        self.0.move_to(x, y);
    }

    fn line_to(&mut self, x: f32, y: f32) {
        self.0.line_to(x, y);
    }

    fn quad_to(&mut self, x1: f32, y1: f32, x: f32, y: f32) {
        self.0.quad_to(x1, y1, x, y);
    }

    fn curve_to(&mut self, x1: f32, y1: f32, x2: f32, y2: f32, x: f32, y: f32) {
        self.0.cubic_to(x1, y1, x2, y2, x, y);
    }

    fn close(&mut self) {
        self.0.close();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_breaks_between_words_and_keeps_all_of_them() {
        let letters = Lettering::regular(12.0);
        let text =
            "Generate_IDM_Planner(c=ego_lane, la=bicycle1, v0=16, acc=1.5, dec=3) and more words";
        let lines = letters.wrapped(text, 200.0);
        assert!(lines.len() > 2, "{lines:?}");
        assert!(
            lines.iter().all(|line| letters.width(line) <= 200.0),
            "{lines:?}"
        );
        let bare = |text: &str| text.replace(' ', "");
        assert_eq!(bare(&lines.concat()), bare(text));
        let long = letters.wrapped(&"x".repeat(100), 120.0);
        assert!(long.len() > 3 && long.concat().len() == 100, "{long:?}");
        let cut = letters.wrapped(&"ä".repeat(2_000_000), 120.0).concat();
        assert_eq!(cut.chars().count(), MAX_LETTERS + 1);
        assert!(cut.ends_with('…'));
    }

    #[test]
    fn letters_have_outlines_and_bold_ones_are_wider() {
        let (regular, bold) = (Lettering::regular(20.0), Lettering::bold(20.0));
        assert!(
            bold.width("Planner") > regular.width("Planner") && regular.width("Planner") > 40.0
        );
        let bounds = regular.outline("H", (10.0, 50.0)).unwrap().bounds();
        assert!(
            bounds.left() > 10.0
                && bounds.bottom() <= 50.1
                && bounds.top() > 30.0
                && bounds.top() < 40.0
        );
        assert!(
            regular.outline("≥ λ", (0.0, 20.0)).is_some()
                && regular.outline(" ", (0.0, 20.0)).is_none()
        );
    }
}
