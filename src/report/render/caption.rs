//! The caption below a picture.

use embedded_graphics::Drawable;
use embedded_graphics::draw_target::DrawTarget;
use embedded_graphics::geometry::{OriginDimensions, Point, Size};
use embedded_graphics::mono_font::iso_8859_1::{FONT_6X13, FONT_8X13, FONT_9X18};
use embedded_graphics::mono_font::{MonoFont, MonoTextStyle};
use embedded_graphics::pixelcolor::{Rgb888, RgbColor};
use embedded_graphics::prelude::Pixel;
use embedded_graphics::text::{Baseline, Text};
use image::{GenericImage, RgbImage};
use std::convert::Infallible;

/// Minimum number of characters in a line: half a planner code.
const COLUMNS: u32 = 66;
/// Lines of a caption; a planner code may take two.
const LINES: u32 = 5;
/// Space around the text, pixels.
const MARGIN: u32 = 8;
/// Colors of the background, the first lines and the plan.
const PAPER: [u8; 3] = [255, 255, 255];
const INK: Rgb888 = Rgb888::new(28, 34, 38);
const SOFT: Rgb888 = Rgb888::new(102, 112, 122);

/// The text of a frame.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Caption {
    /// Scenario, planner and challenge.
    pub(super) title: String,
    /// Time, speed and score.
    pub(super) now: String,
    /// The plan, two lines at most.
    pub(super) plan: Vec<String>,
}

/// The picture with its caption below. Both sides are even, as H.264 requires.
pub(super) fn below(picture: &RgbImage, caption: &Caption) -> RgbImage {
    let (width, height) = picture.dimensions();
    let font = font(width);
    let line = font.character_size.height + 2;
    let even = |side: u32| side + side % 2;
    let mut page = RgbImage::from_pixel(even(width), even(height + LINES * line + 2 * MARGIN), image::Rgb(PAPER));
    // The picture fits by construction.
    let _ = page.copy_from(picture, 0, 0);
    let mut canvas = Page(page);
    let columns = (width.saturating_sub(2 * MARGIN) / font.character_size.width).max(1) as usize;
    let paragraphs =
        [(&caption.title, INK), (&caption.now, INK)].into_iter().chain(caption.plan.iter().map(|l| (l, SOFT)));
    let lines = paragraphs.flat_map(|(text, color)| wrapped(text, columns).into_iter().map(move |line| (line, color)));
    for (i, (text, color)) in lines.take(LINES as usize).enumerate() {
        let at = Point::new(MARGIN as i32, (height + MARGIN + i as u32 * line) as i32);
        let Ok(_) = Text::with_baseline(&text, at, MonoTextStyle::new(font, color), Baseline::Top).draw(&mut canvas);
    }
    canvas.0
}

/// A text in lines of `columns` characters.
fn wrapped(text: &str, columns: usize) -> Vec<String> {
    let letters: Vec<char> = text.chars().collect();
    letters.chunks(columns).map(|line| line.iter().collect()).collect()
}

/// The largest font with [`COLUMNS`] characters in a line.
fn font(width: u32) -> &'static MonoFont<'static> {
    let fonts: [&MonoFont<'_>; 3] = [&FONT_9X18, &FONT_8X13, &FONT_6X13];
    let fits = |font: &&&MonoFont<'_>| font.character_size.width * COLUMNS + 2 * MARGIN <= width;
    fonts.iter().find(fits).copied().unwrap_or(&FONT_6X13)
}

/// An image as a target of `embedded-graphics`.
struct Page(RgbImage);

impl OriginDimensions for Page {
    fn size(&self) -> Size {
        Size::new(self.0.width(), self.0.height())
    }
}

impl DrawTarget for Page {
    type Color = Rgb888;
    type Error = Infallible;

    fn draw_iter<I: IntoIterator<Item = Pixel<Rgb888>>>(&mut self, pixels: I) -> Result<(), Infallible> {
        for Pixel(at, color) in pixels {
            let place = u32::try_from(at.x).ok().zip(u32::try_from(at.y).ok());
            if let Some(pixel) = place.and_then(|(x, y)| self.0.get_pixel_mut_checked(x, y)) {
                *pixel = image::Rgb([color.r(), color.g(), color.b()]);
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_caption_stands_below_the_picture_and_within_its_width() {
        let picture = RgbImage::from_pixel(321, 321, image::Rgb([1, 2, 3]));
        let caption = Caption { title: "x".repeat(500), now: "now é".to_owned(), plan: vec!["plan".to_owned(); 5] };
        let page = below(&picture, &caption);
        assert!(page.width() == 322 && page.height().is_multiple_of(2) && page.height() > 380);
        assert_eq!(page.get_pixel(320, 320).0, [1, 2, 3]);
        let inked = page.enumerate_pixels().filter(|(_, y, pixel)| *y > 321 && pixel.0 != PAPER).count();
        assert!(inked > 500, "{inked}");
        assert_eq!(wrapped("abcde", 2), ["ab", "cd", "e"]);
    }
}
