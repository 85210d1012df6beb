//! Where on Earth a scenario's own coordinates lie, and its shapes as a map package stores them.

use crate::geometry::{Point, Polygon, Polyline};
use crate::scenario::nuplan::geometry_blob::{BlobError, encode_line, encode_polygon, encode_polygons};
use crate::scenario::nuplan::projection::{ProjectionError, Utm, WGS84};
use geo::orient::Direction;
use geo::{Coord, LineString, Orient};

/// Why a shape cannot be written.
#[derive(Debug, thiserror::Error)]
pub enum ShapeError {
    /// It does not lie on Earth.
    #[error(transparent)]
    Projection(#[from] ProjectionError),
    /// It cannot be encoded.
    #[error(transparent)]
    Blob(#[from] BlobError),
}

/// A zone, and the scenario's origin in it.
#[derive(Debug, Clone)]
pub(super) struct Placement {
    /// The projection.
    pub(super) utm: Utm,
    /// Easting and northing of the scenario's origin, metres.
    pub(super) origin: Point,
}

/// A shape as it is stored, and its smallest and largest longitude and latitude: west, south, east, north.
pub(super) type StoredShape = (Vec<u8>, [f64; 4]);

impl Placement {
    /// A line, stored.
    ///
    /// # Errors
    /// When it lies outside the projection.
    pub(super) fn line(&self, line: &Polyline) -> Result<StoredShape, ShapeError> {
        let line = self.degrees(line.vertices())?;
        let bounds = bounds(line.coords());
        Ok((encode_line(line, WGS84)?, bounds))
    }

    /// An area with its holes, stored.
    ///
    /// # Errors
    /// When it lies outside the projection.
    pub(super) fn polygon(&self, polygon: &Polygon) -> Result<StoredShape, ShapeError> {
        self.outline(&to_geo(polygon))
    }

    /// Several pieces as one area: a single piece as it is, several joined where they touch.
    ///
    /// # Errors
    /// When it lies outside the projection.
    pub(super) fn union(&self, pieces: &[Polygon]) -> Result<StoredShape, ShapeError> {
        if let [only] = pieces {
            return self.polygon(only);
        }
        // Rings that run opposite ways would cut each other out.
        let pieces: Vec<geo::Polygon<f64>> = pieces.iter().map(|p| to_geo(p).orient(Direction::Default)).collect();
        let joined = geo::unary_union(&pieces).0;
        if let [only] = joined.as_slice() {
            return self.outline(only);
        }
        let placed = joined.iter().map(|piece| self.degrees_of(piece)).collect::<Result<Vec<_>, _>>()?;
        let bounds = bounds(placed.iter().flat_map(|piece| piece.exterior().coords()));
        Ok((encode_polygons(placed, WGS84)?, bounds))
    }

    fn outline(&self, polygon: &geo::Polygon<f64>) -> Result<StoredShape, ShapeError> {
        let placed = self.degrees_of(polygon)?;
        let bounds = bounds(placed.exterior().coords());
        Ok((encode_polygon(placed, WGS84)?, bounds))
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

fn bounds<'a>(coords: impl Iterator<Item = &'a Coord<f64>>) -> [f64; 4] {
    let none = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
    coords.fold(none, |[west, south, east, north], c| [west.min(c.x), south.min(c.y), east.max(c.x), north.max(c.y)])
}
