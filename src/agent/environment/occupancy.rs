//! The occupancy grid: which cells of the BEV map's area an object touches.

use super::bev::BevView;
use planagent_world::TrackedObject;
use planagent_world::geometry::{OrientedBox, Pose};
use std::fmt;

/// Cells of a side.
pub const CELLS: usize = 16;

/// A grid over the area of a BEV map: row 0 at the top of the picture, column 0 at its left. The
/// ego is no object.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct OccupancyGrid {
    /// Row by row; column 0 is the highest bit.
    rows: [u16; CELLS],
}

impl OccupancyGrid {
    /// The cells that the boxes of objects touch, in the picture around `center` (the ego's box
    /// center).
    pub fn from_objects(objects: &[TrackedObject], view: &BevView, center: Pose) -> Self {
        let cell = view.meters() / CELLS as f64;
        let reach = view.meters() * std::f64::consts::FRAC_1_SQRT_2;
        let mut grid = Self::default();
        for object in objects {
            let diagonal = object.shape.diagonal() / 2.0;
            let local = center.to_local(object.shape.center.position());
            if local.coords.norm() > reach + diagonal {
                continue;
            }
            for (row, bits) in grid.rows.iter_mut().enumerate() {
                let forward = view.meters() / 2.0 - (row as f64 + 0.5) * cell;
                if (local.x - forward).abs() > cell + diagonal {
                    continue;
                }
                for column in 0..CELLS {
                    let left = view.meters() / 2.0 - (column as f64 + 0.5) * cell;
                    let area = OrientedBox::new(center.translated(forward, left), cell, cell);
                    if object.shape.overlaps(&area) {
                        *bits |= 1 << (CELLS - 1 - column);
                    }
                }
            }
        }
        grid
    }

    /// Whether an object touches a cell; not outside the grid.
    #[cfg(test)]
    pub(crate) fn is_occupied(&self, row: usize, column: usize) -> bool {
        column < CELLS
            && self
                .rows
                .get(row)
                .is_some_and(|bits| bits >> (CELLS - 1 - column) & 1 == 1)
    }
}

/// 64 hexadecimal digits, four a row.
impl fmt::Display for OccupancyGrid {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.rows.iter().try_for_each(|row| write!(f, "{row:04x}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use planagent_world::geometry::Vector;
    use planagent_world::{ObjectKind, TrackToken};

    fn car(x: f64, y: f64, heading: f64) -> TrackedObject {
        let shape = OrientedBox::new(Pose::new(x, y, heading), 3.8, 1.8);
        TrackedObject {
            token: TrackToken(1),
            kind: ObjectKind::Vehicle,
            shape,
            velocity: Vector::zeros(),
        }
    }

    #[test]
    fn the_top_row_is_ahead_and_the_first_column_left() {
        let ego = Pose::new(100.0, 50.0, std::f64::consts::FRAC_PI_2);
        // 30 m ahead and 30 m to the left of an ego that looks along y.
        let grid = OccupancyGrid::from_objects(&[car(70.0, 80.0, 0.0)], &BevView::default(), ego);
        assert!(grid.is_occupied(0, 0) && !grid.is_occupied(0, 1) && !grid.is_occupied(15, 0));
        assert_eq!(grid.to_string(), format!("8000{}", "0".repeat(60)));
        let right = OccupancyGrid::from_objects(&[car(130.0, 80.0, 0.0)], &BevView::default(), ego);
        assert_eq!(right.to_string(), format!("0001{}", "0".repeat(60)));
    }

    #[test]
    fn a_box_on_a_border_touches_all_its_cells_and_one_outside_none() {
        let ego = Pose::new(0.0, 0.0, 0.0);
        let touched = |object: TrackedObject| {
            let grid = OccupancyGrid::from_objects(&[object], &BevView::default(), ego);
            let cells = (0..CELLS).flat_map(|row| (0..CELLS).map(move |column| (row, column)));
            cells
                .filter(|&(row, column)| grid.is_occupied(row, column))
                .collect::<Vec<_>>()
        };
        assert_eq!(
            touched(car(4.0, 4.0, 0.0)),
            [(6, 6), (6, 7), (7, 6), (7, 7)]
        );
        assert!(touched(car(40.0, 0.0, 0.0)).is_empty());
    }
}
