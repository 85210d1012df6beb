//! Anti-aliased drawing of shapes given in map meters.

use super::{BACKGROUND, BevView, Rgb};
use image::RgbImage;
use planagent_world::geometry::{Point, Polygon, Pose, Vector};
use tiny_skia::{
    Color, FillRule, LineCap, LineJoin, Paint, Path, PathBuilder, Pixmap, Stroke, Transform,
};

/// Vertices nearer than this to the line past them are left out, pixels: they change no visible
/// coverage.
const DETAIL_PX: f32 = 0.04;
/// Lines are followed this far beyond the image, pixels: more than half of any line's width.
const MARGIN_PX: f32 = 8.0;

type Pixel = (f32, f32);

/// An image under construction.
pub(super) struct Canvas {
    pixmap: Option<Pixmap>,
    view: BevView,
    center: Pose,
    /// Map to pixels, rows (x, y, 1); computed once, because every vertex uses it.
    to_pixel: [[f64; 3]; 2],
}

impl Canvas {
    /// A plain image around the ego's box center.
    pub(super) fn new(view: BevView, center: Pose) -> Self {
        // `BevView` allows only sizes for which there is a pixmap.
        let mut pixmap = Pixmap::new(view.pixels(), view.pixels());
        if let Some(pixmap) = &mut pixmap {
            pixmap.fill(color(BACKGROUND));
        }
        let (at_origin, at_x, at_y) = (
            view.to_pixel(center, center.position()),
            view.to_pixel(center, center.position() + Vector::x()),
            view.to_pixel(center, center.position() + Vector::y()),
        );
        let (xx, xy) = (at_x.0 - at_origin.0, at_y.0 - at_origin.0);
        let (yx, yy) = (at_x.1 - at_origin.1, at_y.1 - at_origin.1);
        let to_pixel = [[xx, xy, at_origin.0], [yx, yy, at_origin.1]];
        Self {
            pixmap,
            view,
            center,
            to_pixel,
        }
    }

    pub(super) fn view(&self) -> &BevView {
        &self.view
    }

    /// The pose in the center of the image.
    pub(super) fn center(&self) -> Pose {
        self.center
    }

    /// Radius of a circle around the center that holds the whole view, meters.
    pub(super) fn reach(&self) -> f64 {
        self.view.meters() * std::f64::consts::FRAC_1_SQRT_2
    }

    fn pixel(&self, point: Point) -> Pixel {
        let d = point - self.center.position();
        let [x, y] = self
            .to_pixel
            .map(|[by_x, by_y, offset]| by_x * d.x + by_y * d.y + offset);
        (x as f32, y as f32)
    }

    /// The points in pixels, without those that lie on the way from the last kept one to the next.
    fn pixels(&self, points: &[Point]) -> Vec<Pixel> {
        let mut kept: Vec<Pixel> = Vec::with_capacity(points.len());
        let mut points = points.iter().map(|&p| self.pixel(p)).peekable();
        while let Some(at) = points.next() {
            let needless = match (kept.last(), points.peek()) {
                (Some(&last), Some(&next)) => offset_from(at, last, next) < DETAIL_PX,
                _ => false,
            };
            if !needless {
                kept.push(at);
            }
        }
        kept
    }

    /// Fills the union of areas at once, so that no seam shows between neighbors.
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

    /// Fills outlines in map coordinates at once; all have the same orientation.
    pub(super) fn outlines<const N: usize>(
        &mut self,
        rings: impl IntoIterator<Item = [Point; N]>,
        fill: Rgb,
    ) {
        let mut builder = PathBuilder::new();
        for ring in rings {
            push_line(&mut builder, &ring.map(|p| self.pixel(p)));
            builder.close();
        }
        self.fill(builder.finish(), fill);
    }

    /// Fills a circle of a diameter in meters.
    pub(super) fn disc(&mut self, center: Point, diameter: f64, fill: Rgb) {
        let (x, y) = self.pixel(center);
        let radius = diameter * self.view.scale() / 2.0;
        self.fill(PathBuilder::from_circle(x, y, radius as f32), fill);
    }

    /// Draws lines of a width in pixels; the parts outside the image are left out.
    pub(super) fn lines<'a>(
        &mut self,
        lines: impl IntoIterator<Item = &'a [Point]>,
        width_px: f64,
        stroke: Rgb,
    ) {
        let mut builder = PathBuilder::new();
        for line in lines {
            let line = self.pixels(line);
            let mut drawing = false;
            for pair in line.windows(2) {
                // A long line far outside takes time and gives pixels that nobody sees.
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
        let pen = Stroke {
            width: width_px as f32,
            line_cap: LineCap::Butt,
            line_join: LineJoin::Bevel,
            ..Stroke::default()
        };
        if let (Some(pixmap), Some(path)) = (&mut self.pixmap, builder.finish()) {
            pixmap.stroke_path(&path, &paint(stroke), &pen, Transform::identity(), None);
        }
    }

    fn may_show(&self, a: Pixel, b: Pixel) -> bool {
        let end = self.view.pixels() as f32 + MARGIN_PX;
        a.0.max(b.0) >= -MARGIN_PX
            && a.0.min(b.0) <= end
            && a.1.max(b.1) >= -MARGIN_PX
            && a.1.min(b.1) <= end
    }

    fn fill(&mut self, path: Option<Path>, fill: Rgb) {
        if let (Some(pixmap), Some(path)) = (&mut self.pixmap, path) {
            pixmap.fill_path(
                &path,
                &paint(fill),
                FillRule::Winding,
                Transform::identity(),
                None,
            );
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

/// Distance of a point from the straight line between two others; from the first where they are
/// one, pixels.
fn offset_from(point: Pixel, from: Pixel, to: Pixel) -> f32 {
    let (along, off) = (
        (to.0 - from.0, to.1 - from.1),
        (point.0 - from.0, point.1 - from.1),
    );
    let length = along.0.hypot(along.1);
    let ahead = off.0 * along.0 + off.1 * along.1;
    if length <= f32::EPSILON || ahead < 0.0 || ahead > length * length {
        return off.0.hypot(off.1);
    }
    (along.0 * off.1 - along.1 * off.0).abs() / length
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
    let mut paint = Paint {
        anti_alias: true,
        ..Paint::default()
    };
    paint.set_color(color(rgb));
    paint
}
