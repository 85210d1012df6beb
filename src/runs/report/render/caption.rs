//! The caption below a scene, in lines that break between words.

use super::canvas::Canvas;
use super::colors::COLORS;
use super::lettering::Lettering;

/// The text of a picture.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(super) struct Caption {
    /// The first line: scenario, planner and challenge.
    pub(super) title: String,
    /// Time, speed and score.
    pub(super) now: String,
    /// The decision of the last planning call, and the planner code.
    pub(super) plan: Vec<String>,
}

impl Caption {
    /// Its height in a width, both in pixels.
    pub(super) fn height(&self, letters: Lettering, width: f32) -> f32 {
        self.lines(letters, width).len() as f32 * letters.line()
    }

    /// Draws it with its upper left corner at a pixel.
    pub(super) fn draw(
        &self,
        canvas: &mut Canvas,
        (left, top): (f32, f32),
        letters: Lettering,
        width: f32,
    ) {
        for (i, (line, style, color)) in self.lines(letters, width).into_iter().enumerate() {
            let baseline = top + i as f32 * letters.line() + letters.size;
            canvas.text(&line, (left, baseline), style, color);
        }
    }

    fn lines(&self, letters: Lettering, width: f32) -> Vec<(String, Lettering, [u8; 3])> {
        let bold = Lettering::bold(letters.size);
        let head = [
            (&self.title, bold, COLORS.ink),
            (&self.now, letters, COLORS.ink),
        ];
        let plan = self
            .plan
            .iter()
            .map(|text| (text, letters, COLORS.ink_soft));
        head.into_iter()
            .chain(plan)
            .flat_map(|(text, style, color)| {
                style
                    .wrapped(text, width)
                    .into_iter()
                    .map(move |line| (line, style, color))
            })
            .collect()
    }
}
