//! Where the predicted agents are along the reference path, and when (`occupancy_adapter.py`).

use super::reference_path::ReferencePath;
use crate::lattice::{MAX_ROWS, ROW};
use planagent_world::PACIFICA;

/// Steps that refinement reads, 0.1 s apart.
pub const STEPS: usize = 30;
/// Cells along the path, 1 m each, and rows of a cell.
pub const CELLS: usize = 120;
const CELL_ROWS: usize = MAX_ROWS / CELLS;
/// Room beside the ego and behind an agent, meters.
const SIDE: f64 = 0.3;
const BEHIND: f64 = 3.0;
/// Columns of an agent's state: length, width.
const LENGTH: usize = 6;
const WIDTH: usize = 7;

/// Occupied cells of each step.
pub type Occupancy = Vec<[bool; CELLS]>;

/// An agent: its present state, eleven columns, and its likeliest future.
#[derive(Debug, Clone, PartialEq)]
pub struct PredictedAgent {
    /// As the features have it.
    pub state: [f32; 11],
    /// x and y at 0.1 s, 0.2 s and so on, meters.
    pub future: Vec<[f32; 2]>,
}

/// The cells that red lights and agents occupy.
pub fn occupancy(path: &ReferencePath, agents: &[PredictedAgent]) -> Occupancy {
    let red: Vec<bool> = path.iter().map(|row| row[5] > 0.0).collect();
    let mut rows = vec![red; STEPS];
    for PredictedAgent { state, future } in agents {
        // As upstream, an agent whose x is exactly 0 counts as none.
        if state[0] == 0.0
            || future
                .first()
                .is_none_or(|&place| along(path, place).0 <= 0.0)
        {
            continue;
        }
        let [length, width] = [LENGTH, WIDTH].map(|column| f64::from(state[column]));
        let reach = 0.5 * width + 0.5 * PACIFICA.width + SIDE;
        for (occupied, &place) in rows.iter_mut().zip(future) {
            let (s, lateral) = along(path, place);
            if s > 0.0 && lateral < reach {
                let row = |s: f64| (s.clamp(0.0, CELLS as f64) * CELL_ROWS as f64) as usize;
                let (from, to) = (row(s - (0.5 * length + BEHIND)), row(s + 0.5 * length));
                occupied
                    .iter_mut()
                    .take(to)
                    .skip(from)
                    .for_each(|row| *row = true);
            }
        }
    }
    let cells = |rows: &Vec<bool>| {
        std::array::from_fn(|cell| {
            rows.iter()
                .skip(cell * CELL_ROWS)
                .take(CELL_ROWS)
                .any(|&row| row)
        })
    };
    rows.iter().map(cells).collect()
}

/// Distance along the path and beside it, meters.
fn along(path: &ReferencePath, place: [f32; 2]) -> (f64, f64) {
    let (row, lateral) = nearest_row(path, place);
    (row as f64 * ROW, lateral)
}

/// The nearest row of a path, the first of equally near ones, and its distance, meters.
pub(super) fn nearest_row(path: &ReferencePath, [x, y]: [f32; 2]) -> (usize, f64) {
    let distance = |row: &[f32; 6]| f64::from(x - row[0]).hypot(f64::from(y - row[1]));
    path.iter()
        .map(distance)
        .enumerate()
        .min_by(|a, b| a.1.total_cmp(&b.1))
        .expect("a reference path has rows at least")
}
