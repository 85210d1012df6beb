//! The colors of a GIF's frame, which has at most 256.

use super::colors::{COLORS, Rgb};
use gif::{DisposalMethod, Frame};
use image::RgbImage;
use std::cmp::Reverse;
use std::collections::HashMap;

/// Index of the pixels that did not change.
const UNCHANGED: u8 = 0;
/// Colors of a frame, with the transparent one.
const MAX_COLORS: usize = 256;

/// A frame of the pixels that differ from the last one. The colors of the theme are exact, however
/// few pixels have them, so that the legend has the colors of the scene; the others are the most
/// frequent shades between them.
pub(super) fn frame(
    last: Option<&RgbImage>,
    picture: &RgbImage,
    (width, height): (u16, u16),
) -> Frame<'static> {
    let is_same = |x: u32, y: u32, pixel: &image::Rgb<u8>| {
        last.is_some_and(|last| last.get_pixel(x, y) == pixel)
    };
    let mut counts: HashMap<Rgb, usize> = HashMap::new();
    for (x, y, pixel) in picture.enumerate_pixels() {
        if !is_same(x, y, pixel) {
            *counts.entry(pixel.0).or_default() += 1;
        }
    }
    let palette = palette(&counts);
    let indices: HashMap<Rgb, u8> = counts
        .keys()
        .map(|color| (*color, nearest(&palette, *color)))
        .collect();
    let index = |x: u32, y: u32, pixel: &image::Rgb<u8>| {
        if is_same(x, y, pixel) {
            UNCHANGED
        } else {
            indices.get(&pixel.0).copied().unwrap_or(UNCHANGED)
        }
    };
    let pixels: Vec<u8> = picture
        .enumerate_pixels()
        .map(|(x, y, pixel)| index(x, y, pixel))
        .collect();
    let mut frame =
        Frame::from_palette_pixels(width, height, pixels, palette.concat(), Some(UNCHANGED));
    // Transparent pixels show the previous frame.
    frame.dispose = DisposalMethod::Keep;
    frame
}

/// The colors of a frame; the first is transparent.
fn palette(counts: &HashMap<Rgb, usize>) -> Vec<Rgb> {
    let mut palette = vec![COLORS.panel];
    palette.extend(
        COLORS
            .all()
            .into_iter()
            .filter(|color| counts.contains_key(color)),
    );
    let others = counts
        .iter()
        .filter(|(color, _)| !COLORS.all().contains(color));
    let mut others: Vec<(Reverse<usize>, Rgb)> = others
        .map(|(color, count)| (Reverse(*count), *color))
        .collect();
    others.sort_unstable();
    let room = MAX_COLORS - palette.len();
    palette.extend(others.into_iter().map(|(_, color)| color).take(room));
    palette
}

/// The index of the color that is nearest to one.
fn nearest(palette: &[Rgb], color: Rgb) -> u8 {
    let distance = |other: &Rgb| -> u32 {
        other
            .iter()
            .zip(color)
            .map(|(a, b)| u32::from(a.abs_diff(b)).pow(2))
            .sum()
    };
    let opaque = palette.iter().enumerate().skip(usize::from(UNCHANGED) + 1);
    opaque
        .min_by_key(|(_, other)| distance(other))
        .map_or(UNCHANGED, |(index, _)| index as u8)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_colors_of_the_theme_survive_among_many_shades() {
        let shade = |x: u32, y: u32| image::Rgb([x as u8, y as u8, (x + y) as u8]);
        let mut picture = RgbImage::from_fn(64, 64, shade);
        for (x, color) in [(3, COLORS.red), (9, COLORS.tried), (20, COLORS.pedestrian)] {
            picture.put_pixel(x, 5, image::Rgb(color));
        }
        let first = frame(None, &picture, (64, 64));
        let palette = first.palette.clone().unwrap();
        assert!(palette.len() <= 3 * MAX_COLORS && first.transparent == Some(UNCHANGED));
        let color = |frame: &Frame<'_>, palette: &[u8], x: usize, y: usize| {
            let index = usize::from(frame.buffer[64 * y + x]);
            assert_ne!(index, usize::from(UNCHANGED));
            [
                palette[3 * index],
                palette[3 * index + 1],
                palette[3 * index + 2],
            ]
        };
        assert_eq!(color(&first, &palette, 3, 5), COLORS.red);
        assert_eq!(color(&first, &palette, 9, 5), COLORS.tried);
        assert_eq!(color(&first, &palette, 20, 5), COLORS.pedestrian);
        let far = color(&first, &palette, 40, 40);
        assert!(
            far.iter()
                .zip([40, 40, 80])
                .all(|(a, b): (&u8, u8)| a.abs_diff(b) < 40),
            "{far:?}"
        );
        // Only what changes is drawn again.
        let mut next = picture.clone();
        next.put_pixel(30, 30, image::Rgb(COLORS.ego));
        let second = frame(Some(&picture), &next, (64, 64));
        assert_eq!(
            second
                .buffer
                .iter()
                .filter(|index| **index != UNCHANGED)
                .count(),
            1
        );
        assert_eq!(
            color(&second, &second.palette.clone().unwrap(), 30, 30),
            COLORS.ego
        );
    }
}
