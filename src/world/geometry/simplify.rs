//! Simplification of lines for display.

use super::Point;
use geo::Simplify;

/// The line without the vertices that lie within `tolerance` meters of the line through those that
/// stay (Ramer, Douglas and Peucker); its ends stay.
pub fn simplified(points: &[Point], tolerance: f64) -> Vec<Point> {
    let line: geo::LineString<f64> = points.iter().map(|p| (p.x, p.y)).collect();
    line.simplify(tolerance)
        .coords()
        .map(|c| Point::new(c.x, c.y))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_lies_on_the_way_is_left_out() {
        let points =
            [(0.0, 0.0), (1.0, 0.01), (2.0, 0.0), (2.0, 3.0)].map(|(x, y)| Point::new(x, y));
        assert_eq!(simplified(&points, 0.05), [points[0], points[2], points[3]]);
        assert_eq!(simplified(&points, 0.001), points);
        assert_eq!(simplified(&points[..1], 0.05), points[..1]);
    }
}
