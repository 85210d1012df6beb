//! The BEV map: the paper's eight elements seen from above, ego-centered, the ego's heading up.
//!
//! The center of the ego's box lies in the center of the image. Drawn in this order, later over
//! earlier: background, lane and connector areas, crosswalks, centerlines (on lanes with arrowheads
//! in driving direction, 10 m apart), static obstacles, vehicles, bicycles, pedestrians, the ego,
//! and last a red arrow for each moving agent, the ego included: from the center of its box,
//! `ARROW_SECONDS` long at its present velocity. Within an element objects are drawn by track
//! token. Small things are drawn larger than they are, so that they stay visible (see
//! `MIN_SIZE_PX`, `MIN_SIZE_SHARE`); pedestrians are discs; lines are at least a pixel wide.
//! Neither the route nor the traffic lights are drawn.

mod canvas;
mod palette;
mod road;
mod traffic;

pub(crate) use palette::ARROW;
pub use palette::{BACKGROUND, BevElement, Palette, Rgb};

use canvas::Canvas;
use image::RgbImage;
use planagent_world::SceneView;
use planagent_world::geometry::{Point, Pose};

/// A square part of the map and the size of its image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BevView {
    pixels: u32,
    meters: f64,
}

/// Why a view cannot be drawn.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum BevError {
    #[error("a BEV image needs between {min} and {max} pixels a side, got {0}", min = BevView::MIN_PIXELS, max = BevView::MAX_PIXELS)]
    Pixels(u32),
    #[error("a BEV view needs between {min} and {max} meters a side, got {0}", min = BevView::MIN_METERS, max = BevView::MAX_METERS)]
    Meters(f64),
}

impl Default for BevView {
    /// The view of the nano model: 64 m in 128 pixels.
    fn default() -> Self {
        Self {
            pixels: 128,
            meters: Self::DEFAULT_METERS,
        }
    }
}

impl BevView {
    /// Meters.
    pub(crate) const DEFAULT_METERS: f64 = 64.0;
    /// Pixels a side.
    pub const MIN_PIXELS: u32 = 16;
    /// Pixels a side.
    pub const MAX_PIXELS: u32 = 4096;
    /// Meters a side.
    pub const MIN_METERS: f64 = 8.0;
    /// Meters a side.
    pub const MAX_METERS: f64 = 1000.0;

    /// A view of `meters` a side in `pixels` a side.
    pub fn new(pixels: u32, meters: f64) -> Result<Self, BevError> {
        if !(Self::MIN_PIXELS..=Self::MAX_PIXELS).contains(&pixels) {
            return Err(BevError::Pixels(pixels));
        }
        if !(Self::MIN_METERS..=Self::MAX_METERS).contains(&meters) {
            return Err(BevError::Meters(meters));
        }
        Ok(Self { pixels, meters })
    }

    pub fn pixels(&self) -> u32 {
        self.pixels
    }

    pub fn meters(&self) -> f64 {
        self.meters
    }

    /// Pixels per meter.
    pub fn scale(&self) -> f64 {
        f64::from(self.pixels) / self.meters
    }

    /// Whether a point of the map lies in the view around `center` (the ego's box center).
    pub fn holds(&self, center: Pose, point: Point) -> bool {
        let local = center.to_local(point);
        let half = self.meters / 2.0;
        local.x.abs() <= half && local.y.abs() <= half
    }

    /// Position of a map point in the image around `center`: pixels right of and below its top left
    /// corner.
    pub(crate) fn to_pixel(self, center: Pose, point: Point) -> (f64, f64) {
        let local = center.to_local(point);
        let half = f64::from(self.pixels) / 2.0;
        (half - local.y * self.scale(), half - local.x * self.scale())
    }
}

/// Draws the scene as the module says. The same scene and view give the same bytes.
pub fn render(scene: &SceneView<'_>, view: &BevView) -> RgbImage {
    let mut canvas = Canvas::new(*view, scene.ego.center());
    road::draw(&mut canvas, scene.map);
    traffic::draw(&mut canvas, scene);
    canvas.into_image()
}

#[cfg(test)]
mod tests;
