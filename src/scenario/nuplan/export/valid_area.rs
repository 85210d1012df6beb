//! Areas without crossings, as nuPlan's maps have them: the devkit's geometry library fails on
//! others.
//!
//! Crossings have two sources. The borders of a recorded lane cross each other. And the pieces of a
//! roadblock meet so closely that corners of their union change sides when they are rounded to
//! degrees and back.

use super::placement::ShapeError;
use geo::algorithm::buffer::{BufferStyle, LineJoin};
use geo::bool_ops::FillRule;
use geo::orient::Direction;
use geo::{
    BooleanOps, Buffer, Coord, CoordsIter, LineString, LinesIter, MultiPolygon, Orient, Validation,
};
use planagent_world::geometry::{Point, Polygon};

/// Widths by which the outline of an invalid area is moved outward, m, until it is valid: slits
/// close, and parts that meet in a point join.
const MARGINS: [f64; 4] = [1e-5, 1e-4, 1e-3, 1e-2];
/// A vertex nearer than this to an edge of another vertex's may be on its other side after
/// rounding, m: several times the rounding of coordinates in meters and degrees.
const CLEARANCE: f64 = 1e-8;
/// Half the width of an area without extent, m.
const STRIP: f64 = 1e-3;

/// The union of pieces. `stored` gives an area as readers will see it, in degrees and in meters. A
/// valid union stays as it is, a single piece with its vertices. Another is replaced by what its
/// crossing outline encloses, moved outward as little as makes it valid.
pub(super) fn valid_union(
    pieces: &[Polygon],
    stored: impl Fn(&MultiPolygon<f64>) -> Result<[MultiPolygon<f64>; 2], ShapeError>,
) -> Result<MultiPolygon<f64>, ShapeError> {
    let drawn: Vec<geo::Polygon<f64>> = pieces.iter().map(to_geo).collect();
    let joined = match drawn.as_slice() {
        [only] => MultiPolygon(vec![only.clone()]),
        // Rings of opposite orientation would cancel each other.
        several => geo::unary_union(
            &several
                .iter()
                .map(|p| p.orient(Direction::Default))
                .collect::<Vec<_>>(),
        ),
    };
    let is_valid = |area: &MultiPolygon<f64>| -> Result<bool, ShapeError> {
        Ok(area.is_valid() && is_clear(area) && stored(area)?.iter().all(Validation::is_valid))
    };
    if !joined.0.is_empty() && is_valid(&joined)? {
        return Ok(joined);
    }
    let enclosed = drawn
        .iter()
        .map(enclosed)
        .reduce(|a, b| a.union_with_fill_rule(&b, FillRule::NonZero));
    let enclosed = enclosed.unwrap_or_else(|| MultiPolygon(Vec::new()));
    for margin in MARGINS {
        // Rounded corners would have vertices closer than rounding.
        let moved =
            enclosed.buffer_with_style(BufferStyle::new(margin).line_join(LineJoin::Miter(1.0)));
        if is_valid(&moved)? {
            return Ok(moved);
        }
    }
    Err(ShapeError::Crossing)
}

/// Whether all vertices keep [`CLEARANCE`] from the edges that do not end in them.
fn is_clear(area: &MultiPolygon<f64>) -> bool {
    let mut vertices: Vec<Coord> = area.coords_iter().collect();
    vertices.sort_by(|a, b| a.x.total_cmp(&b.x));
    area.lines_iter()
        .filter(|edge| edge.start != edge.end)
        .all(|edge| {
            let (low, high) = (
                edge.start.x.min(edge.end.x) - CLEARANCE,
                edge.start.x.max(edge.end.x) + CLEARANCE,
            );
            let (from, to) = (
                vertices.partition_point(|v| v.x < low),
                vertices.partition_point(|v| v.x <= high),
            );
            vertices[from..to].iter().all(|&vertex| {
                vertex == edge.start
                    || vertex == edge.end
                    || distance(vertex, edge.start, edge.end) >= CLEARANCE
            })
        })
}

/// Distance from a point to the edge between two others, m.
fn distance(point: Coord, from: Coord, to: Coord) -> f64 {
    let along = to - from;
    let share = ((point - from).x * along.x + (point - from).y * along.y)
        / (along.x * along.x + along.y * along.y);
    let off = point - (from + along * share.clamp(0.0, 1.0));
    off.x.hypot(off.y)
}

/// What the outline of a piece encloses; a strip around an outline that encloses nothing.
fn enclosed(piece: &geo::Polygon<f64>) -> MultiPolygon<f64> {
    let area = piece.union_with_fill_rule(&MultiPolygon(Vec::new()), FillRule::NonZero);
    if area.0.is_empty() {
        piece.exterior().buffer(STRIP)
    } else {
        area
    }
}

fn to_geo(polygon: &Polygon) -> geo::Polygon<f64> {
    let line =
        |ring: &[Point]| LineString::from(ring.iter().map(|p| (p.x, p.y)).collect::<Vec<_>>());
    geo::Polygon::new(
        line(polygon.ring()),
        polygon.holes().iter().map(|hole| line(hole)).collect(),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use geo::Area;

    fn polygon(points: &[(f64, f64)]) -> Polygon {
        Polygon::new(points.iter().map(|&(x, y)| Point::new(x, y))).unwrap()
    }

    /// Without rounding.
    fn union(pieces: &[Polygon]) -> MultiPolygon<f64> {
        valid_union(pieces, |area| Ok([area.clone(), area.clone()])).unwrap()
    }

    #[test]
    fn a_valid_piece_keeps_its_vertices() {
        let lane = polygon(&[(0.0, 0.0), (10.0, 0.0), (10.0, 3.0), (0.0, 3.0)]);
        assert_eq!(
            union(std::slice::from_ref(&lane)),
            MultiPolygon(vec![to_geo(&lane)])
        );
    }

    #[test]
    fn crossing_borders_enclose_one_valid_area() {
        // The borders of a lane of 10 m cross at 8 m.
        let lane = polygon(&[
            (0.0, 0.0),
            (8.0, 1.6),
            (10.0, 2.0),
            (10.0, 1.2),
            (8.0, 1.6),
            (0.0, 3.2),
        ]);
        let area = union(std::slice::from_ref(&lane));
        assert!(area.is_valid() && area.0.len() == 1, "{area:?}");
        assert!(
            (area.unsigned_area() - (12.8 + 0.8)).abs() < 1e-3,
            "{}",
            area.unsigned_area()
        );
    }

    #[test]
    fn a_hair_slit_closes() {
        // Two pieces that meet along an edge but for a nanometer, as the roundings of one corner
        // do.
        let left = polygon(&[(0.0, 0.0), (5.0, 0.0), (5.0, 3.0), (0.0, 3.0)]);
        let right = polygon(&[(5.0 + 1e-9, 0.0), (9.0, 0.0), (9.0, 3.0), (5.0, 3.0)]);
        let rounds = |area: &MultiPolygon<f64>| {
            // A reader that moves every second vertex by a few nanometers.
            use geo::MapCoords;
            let moved = area.map_coords(|c| geo::Coord {
                x: c.x + 4e-9 * (c.y * 1e3).sin(),
                y: c.y,
            });
            Ok([area.clone(), moved])
        };
        let area = valid_union(&[left, right], rounds).unwrap();
        assert!(
            area.is_valid() && (area.unsigned_area() - 27.0).abs() < 1e-3,
            "{area:?}"
        );
    }

    #[test]
    fn a_hole_that_touches_the_border_moves_off_it() {
        // Valid as it stands; a reader's rounding may move the corner of the hole across the
        // border.
        let border = polygon(&[(0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0)]);
        let touching = border
            .with_hole([(4.0, 4.0), (6.0, 4.0), (5.0, 1e-10)].map(|(x, y)| Point::new(x, y)))
            .unwrap();
        assert!(MultiPolygon(vec![to_geo(&touching)]).is_valid());
        let area = union(std::slice::from_ref(&touching));
        assert!(area.is_valid() && is_clear(&area), "{area:?}");
        assert!(
            (area.unsigned_area() - 96.0).abs() < 0.01,
            "{}",
            area.unsigned_area()
        );
    }

    #[test]
    fn an_outline_without_extent_becomes_a_strip() {
        let flat = polygon(&[(0.0, 0.0), (4.0, 0.0), (2.0, 0.0)]);
        let area = union(std::slice::from_ref(&flat));
        assert!(area.is_valid() && !area.0.is_empty());
        assert!(area.unsigned_area() < 0.02, "{}", area.unsigned_area());
    }
}
