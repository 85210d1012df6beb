//! The left and right borders of a lane, from its area.

use super::{Point, Polygon, Polyline};

/// The two borders of a lane, in driving direction.
#[derive(Debug, Clone, PartialEq)]
pub struct Borders {
    /// The left one.
    pub left: Polyline,
    /// The right one.
    pub right: Polyline,
}

/// Distance of the borders from the centerline where the area does not give them, m.
const HALF_WIDTH: f64 = 1.75;

/// The ring of the area without the edges across the lane's start and end. Where one edge is
/// nearest to both ends, the centerline is offset instead.
pub fn borders(centerline: &Polyline, area: &Polygon) -> Borders {
    from_ring(centerline, area.ring()).unwrap_or_else(|| Borders {
        left: centerline.offset(HALF_WIDTH),
        right: centerline.offset(-HALF_WIDTH),
    })
}

fn from_ring(centerline: &Polyline, ring: &[Point]) -> Option<Borders> {
    let (start, end) = (
        nearest_edge(ring, centerline.start())?,
        nearest_edge(ring, centerline.end())?,
    );
    if start == end {
        return None;
    }
    // From the far vertex of one edge to the near vertex of the other.
    let walk = |from: usize, to: usize| -> Vec<Point> {
        let count = (to + ring.len() - from - 1) % ring.len() + 1;
        (0..count)
            .map(|step| ring[(from + 1 + step) % ring.len()])
            .collect()
    };
    let ahead = Polyline::new(walk(start, end)).ok()?;
    let back = Polyline::new(walk(end, start).into_iter().rev()).ok()?;
    let side = |line: &Polyline| {
        centerline
            .project(line.point_at(line.length() / 2.0))
            .lateral
    };
    Some(if side(&ahead) >= side(&back) {
        Borders {
            left: ahead,
            right: back,
        }
    } else {
        Borders {
            left: back,
            right: ahead,
        }
    })
}

/// Index i of the edge (vertex i to i + 1) whose midpoint is nearest to a point.
fn nearest_edge(ring: &[Point], point: Point) -> Option<usize> {
    let distance =
        |i: usize| (nalgebra::center(&ring[i], &ring[(i + 1) % ring.len()]) - point).norm();
    (0..ring.len()).min_by(|&a, &b| distance(a).total_cmp(&distance(b)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bent_lane_has_its_two_edges() {
        let left = [
            Point::new(0.0, 2.0),
            Point::new(10.0, 2.0),
            Point::new(20.0, 6.0),
        ];
        let right = [
            Point::new(0.0, -2.0),
            Point::new(10.0, -2.0),
            Point::new(21.0, 2.0),
        ];
        let center = Polyline::new([
            Point::new(0.0, 0.0),
            Point::new(10.0, 0.0),
            Point::new(20.5, 4.0),
        ])
        .unwrap();
        let line = |points: &[Point]| Polyline::new(points.iter().copied()).unwrap();
        let area = Polygon::between(&line(&left), &line(&right)).unwrap();
        let found = borders(&center, &area);
        assert_eq!((found.left, found.right), (line(&left), line(&right)));
        let turned = Polygon::new(area.ring().iter().rev().copied()).unwrap();
        assert_eq!(borders(&center, &turned).left, line(&left));
    }
}
