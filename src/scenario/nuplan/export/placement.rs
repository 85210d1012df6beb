//! Where on Earth the scenario's own coordinates lie, and its shapes as a map package stores them.

use super::valid_area::valid_union;
use crate::nuplan::geometry_blob::{BlobError, StoredShape, encode};
use crate::nuplan::projection::{ProjectionError, Utm, WGS84};
use geo::{Coord, LineString, MapCoords, MultiPolygon};
use planagent_world::geometry::{Point, Polygon, Polyline};

/// Why a shape cannot be written.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message of a variant says what it is")]
pub enum ShapeError {
    #[error(transparent)]
    Projection(#[from] ProjectionError),
    #[error(transparent)]
    Blob(#[from] BlobError),
    #[error("the outline of an area crosses itself and encloses nothing that can be written")]
    Crossing,
}

/// A zone, and the scenario's origin in it.
#[derive(Debug, Clone)]
pub(super) struct Placement {
    pub(super) utm: Utm,
    /// Easting and northing of the scenario's origin, m.
    pub(super) origin: Point,
}

impl Placement {
    pub(super) fn line(&self, line: &Polyline) -> Result<StoredShape, ShapeError> {
        Ok(encode(&self.degrees(line.vertices())?.into(), WGS84)?)
    }

    /// An area with its holes, without crossings.
    pub(super) fn polygon(&self, polygon: &Polygon) -> Result<StoredShape, ShapeError> {
        self.union(std::slice::from_ref(polygon))
    }

    /// Several pieces as one area, without crossings: a single piece unchanged where it has none,
    /// several as their union.
    pub(super) fn union(&self, pieces: &[Polygon]) -> Result<StoredShape, ShapeError> {
        let area = valid_union(pieces, |area| {
            let degrees = self.in_degrees(area)?;
            let meters = degrees.try_map_coords(|c| {
                let (x, y) = self.utm.to_utm(c.x, c.y)?;
                Ok::<_, ShapeError>(Coord { x, y })
            })?;
            Ok([degrees, meters])
        })?;
        let mut placed = self.in_degrees(&area)?.0;
        let only = if placed.len() == 1 {
            placed.pop()
        } else {
            None
        };
        Ok(encode(
            &only.map_or_else(|| MultiPolygon(placed).into(), Into::into),
            WGS84,
        )?)
    }

    fn in_degrees(&self, area: &MultiPolygon<f64>) -> Result<MultiPolygon<f64>, ShapeError> {
        area.try_map_coords(|c| {
            let there = Point::new(c.x, c.y) + self.origin.coords;
            let (x, y) = self.utm.to_geographic(there.x, there.y)?;
            Ok(Coord { x, y })
        })
    }

    fn degrees(&self, points: &[Point]) -> Result<LineString<f64>, ShapeError> {
        let place = |point: &Point| {
            let there = point + self.origin.coords;
            let (x, y) = self.utm.to_geographic(there.x, there.y)?;
            Ok(Coord { x, y })
        };
        points.iter().map(place).collect()
    }
}
