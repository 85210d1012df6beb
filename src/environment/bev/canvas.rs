//! Shapes in map metres onto pixels, anti-aliased.

use super::{BACKGROUND, BevView, Rgb};
use crate::geometry::{Point, Polygon, Pose};
use image::RgbImage;
use tiny_skia::{Color, FillRule, LineCap, LineJoin, Paint, Path, PathBuilder, Pixmap, Stroke, Transform};

/// Vertices nearer than this to their predecessor are left out, pixels: they change no visible coverage.
const DETAIL_PX: f32 = 0.4;
/// Lines are followed this far beyond the image, pixels: more than half of any line's width.
const MARGIN_PX: f32 = 8.0;

type Pixel = (f32, f32);

/// An image in the making.
pub(super) struct Canvas {
    pixmap: Option<Pixmap>,
    view: BevView,
    center: Pose,
}

impl Canvas {
    /// A plain image around the ego's box centre.
    pub(super) fn new(view: BevView, center: Pose) -> Self {
        // `BevView` allows only sizes for which there is a pixmap.
        let mut pixmap = Pixmap::new(view.pixels(), view.pixels());
        if let Some(pixmap) = &mut pixmap {
            pixmap.fill(color(BACKGROUND));
        }
        Self { pixmap, view, center }
    }

    /// The view that is drawn.
    pub(super) fn view(&self) -> &BevView {
        &self.view
    }

    /// The pose in the centre of the image.
    pub(super) fn center(&self) -> Pose {
        self.center
    }

    /// Radius of a circle around the centre that holds the whole view, metres.
    pub(super) fn reach(&self) -> f64 {
        self.view.metres() * std::f64::consts::FRAC_1_SQRT_2
    }

    fn pixel(&self, point: Point) -> Pixel {
        let (x, y) = self.view.to_pixel(self.center, point);
        (x as f32, y as f32)
    }

    fn pixels(&self, points: &[Point]) -> Vec<Pixel> {
        let mut kept: Vec<Pixel> = Vec::with_capacity(points.len());
        for (i, &point) in points.iter().enumerate() {
            let at = self.pixel(point);
            let near = kept.last().is_some_and(|last| (at.0 - last.0).hypot(at.1 - last.1) < DETAIL_PX);
            if near && i + 1 < points.len() {
                continue;
            }
            kept.push(at);
        }
        kept
    }

    /// Fills the union of areas in one go, so that no seam shows between neighbours.
    pub(super) fn areas<'a>(&mut self, polygons: impl IntoIterator<Item = &'a Polygon>, fill: Rgb) {
        let mut builder = PathBuilder::new();
        for polygon in polygons {
            let mut ring = self.pixels(polygon.ring());
            // One sense of rotation for all, so that overlaps add up under the winding rule.
            if signed_area(&ring) < 0.0 {
                ring.reverse();
            }
            push_line(&mut builder, &ring);
            builder.close();
        }
        self.fill(builder.finish(), fill);
    }

    /// Fills one area given in map coordinates.
    pub(super) fn area(&mut self, ring: &[Point], fill: Rgb) {
        let ring: Vec<Pixel> = ring.iter().map(|&p| self.pixel(p)).collect();
        let mut builder = PathBuilder::new();
        push_line(&mut builder, &ring);
        builder.close();
        self.fill(builder.finish(), fill);
    }

    /// Fills a circle of a diameter in metres.
    pub(super) fn disc(&mut self, center: Point, diameter: f64, fill: Rgb) {
        let (x, y) = self.pixel(center);
        let radius = diameter * self.view.scale() / 2.0;
        self.fill(PathBuilder::from_circle(x, y, radius as f32), fill);
    }

    /// Draws lines of a width in pixels; the parts outside the image are left out.
    pub(super) fn lines<'a>(&mut self, lines: impl IntoIterator<Item = &'a [Point]>, width_px: f64, stroke: Rgb) {
        let mut builder = PathBuilder::new();
        for line in lines {
            let line = self.pixels(line);
            let mut drawing = false;
            for pair in line.windows(2) {
                if !self.may_show(pair[0], pair[1]) {
                    drawing = false;
                    continue;
                }
                if !drawing {
                    builder.move_to(pair[0].0, pair[0].1);
                }
                builder.line_to(pair[1].0, pair[1].1);
                drawing = true;
            }
        }
        let pen =
            Stroke { width: width_px as f32, line_cap: LineCap::Butt, line_join: LineJoin::Round, ..Stroke::default() };
        if let (Some(pixmap), Some(path)) = (&mut self.pixmap, builder.finish()) {
            pixmap.stroke_path(&path, &paint(stroke), &pen, Transform::identity(), None);
        }
    }

    fn may_show(&self, a: Pixel, b: Pixel) -> bool {
        let end = self.view.pixels() as f32 + MARGIN_PX;
        a.0.max(b.0) >= -MARGIN_PX && a.0.min(b.0) <= end && a.1.max(b.1) >= -MARGIN_PX && a.1.min(b.1) <= end
    }

    fn fill(&mut self, path: Option<Path>, fill: Rgb) {
        if let (Some(pixmap), Some(path)) = (&mut self.pixmap, path) {
            pixmap.fill_path(&path, &paint(fill), FillRule::Winding, Transform::identity(), None);
        }
    }

    /// The finished image. Everything on it is opaque, so dropping alpha loses nothing.
    pub(super) fn into_image(self) -> RgbImage {
        let side = self.view.pixels();
        let mut image = RgbImage::from_pixel(side, side, image::Rgb(BACKGROUND));
        if let Some(pixmap) = self.pixmap {
            for (pixel, source) in image.pixels_mut().zip(pixmap.pixels()) {
                pixel.0 = [source.red(), source.green(), source.blue()];
            }
        }
        image
    }
}

fn push_line(builder: &mut PathBuilder, line: &[Pixel]) {
    for (i, &(x, y)) in line.iter().enumerate() {
        if i == 0 {
            builder.move_to(x, y);
        } else {
            builder.line_to(x, y);
        }
    }
}

fn signed_area(ring: &[Pixel]) -> f32 {
    (0..ring.len())
        .map(|i| {
            let (a, b) = (ring[i], ring[(i + 1) % ring.len()]);
            a.0 * b.1 - b.0 * a.1
        })
        .sum()
}

fn color([r, g, b]: Rgb) -> Color {
    Color::from_rgba8(r, g, b, 255)
}

fn paint(rgb: Rgb) -> Paint<'static> {
    let mut paint = Paint { anti_alias: true, ..Paint::default() };
    paint.set_color(color(rgb));
    paint
}
