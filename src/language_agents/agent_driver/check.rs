//! The last stage, which asks no model: whether the waypoints touch something, and a solver that
//! moves them away.

use super::tools::{Facts, SeenObject};
use planagent_agent::reasoning::{LISTED_WAYPOINTS, SeenPlace, WaypointList};
use planagent_world::PACIFICA;
use planagent_world::geometry::{OrientedBox, Point, Pose, Vector};

/// The last step of the occupancy; later waypoints are checked against it.
const LAST_OCCUPANCY: usize = 4;
/// How far ahead of a waypoint the ego's box is centered in the check of the occupancy, meters.
const BOX_AHEAD: f64 = 0.5;
/// Width of the bumps that push waypoints away, meters,
const SIGMA: f64 = 1.265;
/// their weight beside the distance to the plan,
const ALPHA: f64 = 7.89;
/// and how far from a waypoint occupied cells count, meters. These are the constants of the runs
/// behind the original's results.
const RANGE: f64 = 5.0;
/// Side of a cell of the occupancy, meters.
const CELL: f64 = 0.5;
/// Steps of the solver for a waypoint.
const MAX_STEPS: usize = 200;
/// Halvings of a step of the solver.
const MAX_HALVINGS: usize = 30;

/// The waypoints after the check.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Checked {
    /// The half seconds after which the plan touches something, from 1.
    pub(super) touching: Vec<usize>,
    /// The waypoints that are driven.
    pub(super) waypoints: WaypointList,
}

impl Checked {
    /// What the check found, in words.
    pub(super) fn words(&self) -> String {
        if self.touching.is_empty() {
            return "no waypoint touches anything; the plan is kept".to_owned();
        }
        let steps: Vec<String> = self.touching.iter().map(usize::to_string).collect();
        format!(
            "waypoints {} touch something; the solver moved the plan to {}",
            steps.join(", "),
            self.waypoints
        )
    }
}

/// Checks waypoints, and moves them where one touches something.
pub(super) fn checked(waypoints: &WaypointList, facts: &Facts<'_>) -> Checked {
    let objects = facts.objects();
    let touching: Vec<usize> = waypoints
        .0
        .iter()
        .enumerate()
        .filter(|(i, place)| touches(local(place), i + 1, objects))
        .map(|(i, _)| i + 1)
        .collect();
    if touching.is_empty() {
        return Checked {
            touching,
            waypoints: *waypoints,
        };
    }
    let moved: [SeenPlace; LISTED_WAYPOINTS] = std::array::from_fn(|i| {
        let from = local(&waypoints.0[i]);
        let place = moved_away(from, &cells(from, i + 1, objects));
        SeenPlace {
            right: -place.y,
            ahead: place.x,
        }
    });
    Checked {
        touching,
        waypoints: WaypointList(moved),
    }
}

/// In the frame of the ego's center: ahead, to the left.
fn local(place: &SeenPlace) -> Vector {
    Vector::new(place.ahead, -place.right)
}

/// The ego's box at a place, not turned: the original's.
fn ego_box(place: Vector) -> OrientedBox {
    let center = Pose::new(place.x, place.y, 0.0);
    OrientedBox::new(center, PACIFICA.length(), PACIFICA.width)
}

/// Whether both checks find a collision after a number of half seconds: of the occupancy, and of
/// boxes with their present headings.
fn touches(place: Vector, step: usize, objects: &[SeenObject]) -> bool {
    let ahead = ego_box(place + Vector::new(BOX_AHEAD, 0.0));
    let own = ego_box(place);
    let occupied = objects
        .iter()
        .any(|object| object.box_at(step.min(LAST_OCCUPANCY)).overlaps(&ahead));
    occupied
        && objects
            .iter()
            .any(|object| object.box_at(step).overlaps(&own))
}

/// The occupied cells near a place.
fn cells(place: Vector, step: usize, objects: &[SeenObject]) -> Vec<Vector> {
    let count = (RANGE / CELL) as i32;
    let corner = Vector::new((place.x / CELL).floor(), (place.y / CELL).floor());
    let mut found = Vec::new();
    for row in -count..=count {
        for column in -count..=count {
            let cell = (corner + Vector::new(f64::from(row) + 0.5, f64::from(column) + 0.5)) * CELL;
            let is_near = (cell - place).norm() <= RANGE;
            let at = Point::from(cell);
            let covers = |object: &SeenObject| object.box_at(step.min(LAST_OCCUPANCY)).contains(at);
            if is_near && objects.iter().any(covers) {
                found.push(cell);
            }
        }
    }
    found
}

/// The least of the squared distance to the plan and a bump at each cell, from the plan downhill.
fn moved_away(from: Vector, cells: &[Vector]) -> Vector {
    let height = ALPHA / ((std::f64::consts::TAU).sqrt() * SIGMA);
    let bump = |place: Vector, cell: &Vector| {
        let squared = (place - cell).norm_squared();
        height * (-squared / (2.0 * SIGMA * SIGMA)).exp()
    };
    let cost = |place: Vector| {
        let bumps: f64 = cells.iter().map(|cell| bump(place, cell)).sum();
        (place - from).norm_squared() + bumps
    };
    let slope = |place: Vector| {
        let bumps = cells.iter().fold(Vector::zeros(), |sum, cell| {
            sum + (cell - place) * (bump(place, cell) / (SIGMA * SIGMA))
        });
        (place - from) * 2.0 + bumps
    };
    let mut place = from;
    for _ in 0..MAX_STEPS {
        let downhill = -slope(place);
        if downhill.norm() < 1e-9 {
            break;
        }
        let now = cost(place);
        // Armijo's rule with its usual constant: the bumps are steep, and a whole step may jump
        // over one.
        let lower = (0..MAX_HALVINGS)
            .map(|halving| place + downhill * 0.5_f64.powi(halving as i32))
            .find(|&next| cost(next) < now - 1e-4 * (next - place).norm() * downhill.norm());
        match lower {
            Some(next) => place = next,
            None => break,
        }
    }
    place
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_without_cells_stays_and_others_move_away_from_them() {
        let from = Vector::new(10.0, 0.0);
        assert_eq!(moved_away(from, &[]), from);
        let cells = [Vector::new(11.0, 0.25), Vector::new(11.0, -0.25)];
        let moved = moved_away(from, &cells);
        assert!(moved.x < from.x - 0.2 && moved.y.abs() < 1e-6, "{moved}");
        let aside = moved_away(from, &[Vector::new(10.0, 0.5)]);
        assert!(aside.y < -0.2 && (aside.x - 10.0).abs() < 1e-6, "{aside}");
    }
}
