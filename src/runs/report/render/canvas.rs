//! An antialiased drawing surface in pixels.

use super::colors::Rgb;
use super::lettering::Lettering;
use image::RgbImage;
use tiny_skia::{
    Color, FillRule, FilterQuality, LineCap, LineJoin, Paint, Path, PathBuilder, Pattern, Pixmap,
    Rect, SpreadMode, Stroke, StrokeDash, Transform,
};

/// Right of and below the top left corner, pixels.
pub(super) type Pixel = (f32, f32);

/// Farthest place from the corner, pixels: no picture is as large. The drawing library computes in
/// whole numbers, which places of a wild replay would overflow.
const FAR: f32 = 20_000.0;

/// A stroke.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Pen {
    pub(super) color: Rgb,
    /// Pixels.
    pub(super) width: f32,
    /// Lengths of dashes and gaps, pixels.
    pub(super) dash: Option<[f32; 2]>,
    /// 0 to 1.
    pub(super) opacity: f32,
}

impl Pen {
    /// A solid opaque stroke; the width in pixels.
    pub(super) fn solid(color: Rgb, width: f32) -> Self {
        Self {
            color,
            width,
            dash: None,
            opacity: 1.0,
        }
    }

    /// A dashed one; lengths in pixels.
    pub(super) fn dashed(color: Rgb, width: f32, dash: [f32; 2]) -> Self {
        Self {
            dash: Some(dash),
            ..Self::solid(color, width)
        }
    }
}

/// An image under construction.
pub(super) struct Canvas {
    /// None if the size is beyond all limits; the image is then plain.
    pixmap: Option<Pixmap>,
    size: (u32, u32),
    ground: Rgb,
}

impl Canvas {
    /// A plain image.
    pub(super) fn new(size: (u32, u32), ground: Rgb) -> Self {
        let mut pixmap = Pixmap::new(size.0, size.1);
        if let Some(pixmap) = &mut pixmap {
            pixmap.fill(opaque(ground));
        }
        Self {
            pixmap,
            size,
            ground,
        }
    }

    /// Fills rings by the even-odd rule.
    pub(super) fn rings(&mut self, rings: &[Vec<Pixel>], fill: Rgb) {
        self.fill(
            outline(rings.iter().map(Vec::as_slice), true),
            FillRule::EvenOdd,
            &paint(fill, 1.0),
        );
    }

    /// Fills the union of polygons, so that no seam shows between neighbors.
    pub(super) fn areas(&mut self, polygons: &[Vec<Pixel>], fill: Rgb) {
        let oriented: Vec<Vec<Pixel>> =
            polygons.iter().map(|ring| counterclockwise(ring)).collect();
        self.fill(
            outline(oriented.iter().map(Vec::as_slice), true),
            FillRule::Winding,
            &paint(fill, 1.0),
        );
    }

    /// Fills a polygon with stripes: `period` in pixels, at an angle in radians.
    pub(super) fn stripes(
        &mut self,
        ring: &[Pixel],
        fill: Rgb,
        period: f32,
        angle: f32,
        origin: Pixel,
    ) {
        // A pattern and no lines of its own: the edge of the polygon then cuts the stripes.
        /// Side of a tile of the pattern and its filled rows, pixels: a stripe is a little wider
        /// than a gap.
        const TILE: u32 = 16;
        const FILLED: f32 = 9.0;
        let (Some(mut tile), Some(bar)) = (
            Pixmap::new(TILE, TILE),
            Rect::from_xywh(0.0, 0.0, TILE as f32, FILLED),
        ) else {
            return;
        };
        tile.fill_rect(bar, &paint(fill, 1.0), Transform::identity(), None);
        let scale = period / TILE as f32;
        let place = Transform::from_translate(origin.0, origin.1)
            .pre_concat(Transform::from_rotate(angle.to_degrees()))
            .pre_scale(scale, scale);
        let shader = Pattern::new(
            tile.as_ref(),
            SpreadMode::Repeat,
            FilterQuality::Bilinear,
            1.0,
            place,
        );
        let striped = Paint {
            shader,
            anti_alias: true,
            ..Paint::default()
        };
        self.fill(
            outline([ring].into_iter(), true),
            FillRule::Winding,
            &striped,
        );
    }

    /// Fills a circle.
    pub(super) fn disc(&mut self, (x, y): Pixel, radius: f32, fill: Rgb) {
        self.fill(
            PathBuilder::from_circle(within(x), within(y), within(radius)),
            FillRule::Winding,
            &paint(fill, 1.0),
        );
    }

    /// Fills a rectangle of a width and a height around a center, turned by an angle; with an
    /// opacity.
    pub(super) fn rectangle(
        &mut self,
        (x, y): Pixel,
        (width, height): Pixel,
        angle: f32,
        fill: Rgb,
        opacity: f32,
    ) {
        let (sin, cos) = angle.sin_cos();
        let corner = |(right, down): Pixel| {
            let (right, down) = (right * width / 2.0, down * height / 2.0);
            (x + cos * right - sin * down, y + sin * right + cos * down)
        };
        let ring = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(corner);
        self.fill(
            outline([&ring[..]].into_iter(), true),
            FillRule::Winding,
            &paint(fill, opacity),
        );
    }

    /// Draws lines.
    pub(super) fn lines<'a>(&mut self, lines: impl Iterator<Item = &'a [Pixel]>, pen: Pen) {
        let stroke = Stroke {
            width: pen.width,
            line_cap: LineCap::Butt,
            line_join: LineJoin::Round,
            dash: pen
                .dash
                .and_then(|dash| StrokeDash::new(dash.to_vec(), 0.0)),
            ..Stroke::default()
        };
        if let (Some(pixmap), Some(path)) = (&mut self.pixmap, outline(lines, false)) {
            pixmap.stroke_path(
                &path,
                &paint(pen.color, pen.opacity),
                &stroke,
                Transform::identity(),
                None,
            );
        }
    }

    /// Draws one line.
    pub(super) fn line(&mut self, line: &[Pixel], pen: Pen) {
        self.lines([line].into_iter(), pen);
    }

    /// Writes a text whose baseline starts at a pixel.
    pub(super) fn text(&mut self, text: &str, at: Pixel, letters: Lettering, color: Rgb) {
        let at = (within(at.0), within(at.1));
        self.fill(
            letters.outline(text, at),
            FillRule::Winding,
            &paint(color, 1.0),
        );
    }

    /// Writes a text with a halo, so that it is legible on the scene.
    pub(super) fn label(
        &mut self,
        text: &str,
        at: Pixel,
        letters: Lettering,
        color: Rgb,
        halo: Rgb,
    ) {
        let at = (within(at.0), within(at.1));
        let stroke = Stroke {
            width: letters.size / 4.0,
            line_join: LineJoin::Round,
            ..Stroke::default()
        };
        if let (Some(pixmap), Some(path)) = (&mut self.pixmap, letters.outline(text, at)) {
            pixmap.stroke_path(
                &path,
                &paint(halo, 1.0),
                &stroke,
                Transform::identity(),
                None,
            );
        }
        self.text(text, at, letters, color);
    }

    /// The finished image. Everything on it is opaque, so dropping alpha loses nothing.
    pub(super) fn into_image(self) -> RgbImage {
        let mut image = RgbImage::from_pixel(self.size.0, self.size.1, image::Rgb(self.ground));
        if let Some(pixmap) = self.pixmap {
            for (pixel, source) in image.pixels_mut().zip(pixmap.pixels()) {
                pixel.0 = [source.red(), source.green(), source.blue()];
            }
        }
        image
    }

    fn fill(&mut self, path: Option<Path>, rule: FillRule, paint: &Paint<'_>) {
        if let (Some(pixmap), Some(path)) = (&mut self.pixmap, path) {
            pixmap.fill_path(&path, paint, rule, Transform::identity(), None);
        }
    }
}

/// A coordinate that can be drawn. One that is no number is far away.
fn within(pixel: f32) -> f32 {
    if pixel.is_nan() {
        FAR
    } else {
        pixel.clamp(-FAR, FAR)
    }
}

fn outline<'a>(lines: impl Iterator<Item = &'a [Pixel]>, closed: bool) -> Option<Path> {
    let mut builder = PathBuilder::new();
    for line in lines {
        for (i, &(x, y)) in line.iter().enumerate() {
            let (x, y) = (within(x), within(y));
            if i == 0 {
                builder.move_to(x, y);
            } else {
                builder.line_to(x, y);
            }
        }
        if closed && !line.is_empty() {
            builder.close();
        }
    }
    builder.finish()
}

/// A ring in one sense of rotation, so that overlaps add up under the winding rule.
fn counterclockwise(ring: &[Pixel]) -> Vec<Pixel> {
    let next = ring.iter().cycle().skip(1);
    let area: f32 = ring
        .iter()
        .zip(next)
        .map(|(a, b)| a.0 * b.1 - b.0 * a.1)
        .sum();
    let mut ring = ring.to_vec();
    if area < 0.0 {
        ring.reverse();
    }
    ring
}

fn opaque([r, g, b]: Rgb) -> Color {
    Color::from_rgba8(r, g, b, 255)
}

fn paint([r, g, b]: Rgb, opacity: f32) -> Paint<'static> {
    let mut paint = Paint {
        anti_alias: true,
        ..Paint::default()
    };
    paint.set_color_rgba8(r, g, b, (255.0 * opacity).round() as u8);
    paint
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numbers that no scene of a simulation has.
    const WILD: [f32; 8] = [
        f32::NAN,
        f32::INFINITY,
        f32::NEG_INFINITY,
        f32::MAX,
        f32::MIN,
        1e20,
        -1e10,
        2_147_483_648.0,
    ];

    #[test]
    fn any_number_can_be_drawn() {
        for wild in WILD {
            for places in [
                [(1.0, 1.0), (wild, 5.0), (3.0, wild)],
                [(wild, wild), (9.0, 9.0), (wild, -wild)],
            ] {
                let mut canvas = Canvas::new((64, 64), [255; 3]);
                canvas.line(&places, Pen::solid([0; 3], 2.0));
                canvas.line(&places, Pen::dashed([0; 3], 2.0, [1.0, 1.0]));
                canvas.areas(&[places.to_vec()], [9; 3]);
                canvas.rings(&[places.to_vec()], [9; 3]);
                let [first, second, _] = places;
                canvas.stripes(&places, [9; 3], 4.0, wild, first);
                canvas.disc(first, wild, [9; 3]);
                canvas.rectangle(second, (wild, 3.0), wild, [9; 3], 1.0);
                canvas.label("a", first, Lettering::regular(12.0), [0; 3], [255; 3]);
                assert_eq!(canvas.into_image().dimensions(), (64, 64));
            }
        }
    }

    #[test]
    fn a_line_to_a_far_point_is_drawn_as_far_as_the_picture() {
        let mut canvas = Canvas::new((64, 64), [255; 3]);
        canvas.line(&[(32.0, 32.0), (1e12, 32.0)], Pen::solid([0; 3], 4.0));
        let image = canvas.into_image();
        assert_eq!(image.get_pixel(60, 32).0, [0; 3]);
        assert_eq!(image.get_pixel(4, 32).0, [255; 3]);
    }
}
