//! The three lines of a crosswalk: those of the smallest rectangle around it.

use planagent_world::geometry::{Point, Polygon};

/// The middle line and the two edges beside it, each from start to end: the corners of the
/// rectangle, taken as upstream takes them. Which corner comes first depends on shapely; this is
/// its version 2.0 with GEOS 3.11, whose rounding decides between rectangles of equal size.
pub(super) fn crosswalk_edges(area: &Polygon) -> Option<[[Point; 2]; 3]> {
    let [a, b, c, d] = smallest_rectangle(&hull(area.ring()))?;
    let (first, second) = ([d, a], [c, b]);
    let middle = [nalgebra::center(&d, &c), nalgebra::center(&a, &b)];
    Some([middle, second, first])
}

/// The corners of the smallest rectangle around a convex ring with one side along an edge; of equal
/// ones the first.
fn smallest_rectangle(hull: &[Point]) -> Option<[Point; 4]> {
    let mut best: Option<(f64, [Point; 4])> = None;
    for (i, from) in hull.iter().enumerate() {
        let to = hull[(i + 1) % hull.len()];
        let (dx, dy) = (to.x - from.x, to.y - from.y);
        let length = (dx * dx + dy * dy).sqrt();
        let (ux, uy) = (dx / length, dy / length);
        let turned = hull
            .iter()
            .map(|point| (ux * point.x + uy * point.y, -uy * point.x + ux * point.y));
        let none = (f64::INFINITY, f64::NEG_INFINITY);
        let (x, y) = turned.fold((none, none), |((x0, x1), (y0, y1)), (x, y)| {
            ((x0.min(x), x1.max(x)), (y0.min(y), y1.max(y)))
        });
        let area = ((x.1 - x.0) * (y.0 - y.1) + (x.1 - x.0) * (y.0 - y.1)).abs() / 2.0;
        if best.as_ref().is_none_or(|(least, _)| area < *least) {
            let corners = [(x.0, y.0), (x.1, y.0), (x.1, y.1), (x.0, y.1)];
            best = Some((
                area,
                corners.map(|(x, y)| Point::new(ux * x + -uy * y, uy * x + ux * y)),
            ));
        }
    }
    best.map(|(_, corners)| corners)
}

/// The convex hull, clockwise from its lowest point as GEOS gives it.
fn hull(ring: &[Point]) -> Vec<Point> {
    let mut points = ring.to_vec();
    points.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    points.dedup();
    let chain = |points: &mut dyn Iterator<Item = &Point>| {
        let mut chain: Vec<Point> = Vec::new();
        for &point in points {
            while let [.., before, last] = chain[..]
                && (last - before).perp(&(point - last)) >= 0.0
            {
                chain.pop();
            }
            chain.push(point);
        }
        chain.pop();
        chain
    };
    let mut hull = chain(&mut points.iter());
    hull.extend(chain(&mut points.iter().rev()));
    let below = |a: &Point, b: &Point| a.y.total_cmp(&b.y).then(a.x.total_cmp(&b.x));
    let lowest = (0..hull.len())
        .min_by(|&a, &b| below(&hull[a], &hull[b]))
        .unwrap_or(0);
    hull.rotate_left(lowest);
    hull
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_middle_runs_between_the_edges() {
        let ring = [(0.0, 0.0), (3.0, 0.0), (3.0, 13.0), (0.0, 13.0), (0.0, 5.0)];
        let area = Polygon::new(ring.map(|(x, y)| Point::new(x, y))).unwrap();
        let [middle, second, first] = crosswalk_edges(&area).unwrap();
        for end in [0, 1] {
            assert!((nalgebra::center(&first[end], &second[end]) - middle[end]).norm() < 1e-12);
        }
        let lengths = [(first[1] - first[0]).norm(), (first[0] - second[0]).norm()];
        assert!(
            (lengths[0] * lengths[1] - 39.0).abs() < 1e-9 && (lengths[0] - 8.0).abs() > 4.9,
            "{lengths:?}"
        );
    }

    #[test]
    fn the_hull_is_clockwise_from_the_lowest_point() {
        let ring = [(2.0, 2.0), (0.0, 1.0), (1.0, 0.0), (1.0, 1.0), (2.0, 0.0)]
            .map(|(x, y)| Point::new(x, y));
        let expected =
            [(1.0, 0.0), (0.0, 1.0), (2.0, 2.0), (2.0, 0.0)].map(|(x, y)| Point::new(x, y));
        assert_eq!(hull(&ring), expected);
    }
}
