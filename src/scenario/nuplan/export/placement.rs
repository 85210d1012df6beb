//! Where on Earth the scenario's own coordinates lie, and its shapes as a map package stores them.

use crate::geometry::{Point, Polygon, Polyline};
use crate::scenario::nuplan::geometry_blob::{BlobError, StoredShape, encode};
use crate::scenario::nuplan::projection::{ProjectionError, Utm, WGS84};
use geo::orient::Direction;
use geo::{Coord, LineString, MultiPolygon, Orient};

/// Why a shape cannot be written.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum ShapeError {
    #[error(transparent)]
    Projection(#[from] ProjectionError),
    #[error(transparent)]
    Blob(#[from] BlobError),
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

    /// An area with its holes.
    pub(super) fn polygon(&self, polygon: &Polygon) -> Result<StoredShape, ShapeError> {
        Ok(encode(&self.degrees_of(&to_geo(polygon))?.into(), WGS84)?)
    }

    /// Several pieces as one area: a single piece unchanged, several as their union.
    pub(super) fn union(&self, pieces: &[Polygon]) -> Result<StoredShape, ShapeError> {
        if let [only] = pieces {
            return self.polygon(only);
        }
        // Rings of opposite orientation would cancel each other.
        let pieces: Vec<geo::Polygon<f64>> = pieces.iter().map(|p| to_geo(p).orient(Direction::Default)).collect();
        let joined = geo::unary_union(&pieces).0;
        let mut placed = joined.iter().map(|piece| self.degrees_of(piece)).collect::<Result<Vec<_>, _>>()?;
        let only = if placed.len() == 1 { placed.pop() } else { None };
        Ok(encode(&only.map_or_else(|| MultiPolygon(placed).into(), Into::into), WGS84)?)
    }

    fn degrees_of(&self, polygon: &geo::Polygon<f64>) -> Result<geo::Polygon<f64>, ShapeError> {
        let ring = |line: &LineString<f64>| {
            let points: Vec<Point> = line.coords().map(|c| Point::new(c.x, c.y)).collect();
            self.degrees(&points)
        };
        let holes = polygon.interiors().iter().map(ring).collect::<Result<Vec<_>, _>>()?;
        Ok(geo::Polygon::new(ring(polygon.exterior())?, holes))
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

fn to_geo(polygon: &Polygon) -> geo::Polygon<f64> {
    let line = |ring: &[Point]| LineString::from(ring.iter().map(|p| (p.x, p.y)).collect::<Vec<_>>());
    geo::Polygon::new(line(polygon.ring()), polygon.holes().iter().map(|hole| line(hole)).collect())
}
