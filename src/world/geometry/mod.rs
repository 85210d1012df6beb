//! Poses, polylines, boxes, polygons, corridors and a spatial index, all in local meters (f64).
//!
//! Plain data without meaning on a road; [`crate`] gives it one. Angles are radians,
//! counter-clockwise; lateral offsets are positive to the left.

mod angle;
mod borders;
mod corridor;
mod index;
mod locator;
mod oriented_box;
mod polygon;
mod polyline;
mod pose;
mod simplify;

pub use angle::{unwrap_angles, wrap_angle};
pub use borders::{Borders, borders};
pub use corridor::Corridor;
pub use index::{Bounds, SpatialIndex};
pub use locator::PointLocator;
pub use oriented_box::OrientedBox;
pub use polygon::Polygon;
pub use polyline::{Polyline, Projection};
pub use pose::Pose;
pub use simplify::simplified;

/// A position in meters.
pub type Point = nalgebra::Point2<f64>;
/// A displacement, velocity or acceleration.
pub type Vector = nalgebra::Vector2<f64>;

/// Why coordinates make no shape.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the message of a variant says what it is")]
#[non_exhaustive]
pub enum GeometryError {
    #[error("vertex {index} has a NaN or infinite coordinate: ({x}, {y})")]
    NotFinite { index: usize, x: f64, y: f64 },
    #[error("{shape} needs at least {needed} distinct vertices, got {got}")]
    TooFewVertices {
        shape: &'static str,
        needed: usize,
        got: usize,
    },
}

pub(crate) fn check_finite(points: &[Point]) -> Result<(), GeometryError> {
    match points
        .iter()
        .position(|p| !p.x.is_finite() || !p.y.is_finite())
    {
        Some(index) => Err(GeometryError::NotFinite {
            index,
            x: points[index].x,
            y: points[index].y,
        }),
        None => Ok(()),
    }
}
