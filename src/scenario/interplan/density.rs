//! Dense traffic on one lane after another (interPlan `agents_modifier.py`, `spawn_agents`).

use super::python_random::PythonRandom;

/// How close together vehicles drive.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Density {
    Low,
    Medium,
    High,
}

impl Density {
    /// Gaps from front to front: from 10 m to this, which is excluded.
    fn max_gap(self) -> u64 {
        match self {
            Self::Low => 100,
            Self::Medium => 50,
            Self::High => 33,
        }
    }
}

/// Smallest gap from front to front, meters.
const MIN_GAP: u64 = 10;
/// A place this near to the ego becomes the ego's, meters.
const NEAR_EGO: f64 = 10.0;
/// Speed of a first vehicle on a lane without a limit, m/s.
const FALLBACK_SPEED: f64 = 10.0;

/// A lane that gets vehicles.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Row {
    /// Length of the lane as it was extended, meters.
    pub length: f64,
    /// The ego's progress on it, meters.
    pub ego_s: f64,
    /// Whether it is the ego's lane.
    pub is_ego_lane: bool,
    /// Limit of the lane, m/s.
    pub limit: Option<f64>,
    /// Whether the ego's roadblock has exactly one successor: the first vehicle then drives at the
    /// limit.
    pub leads_on: bool,
    /// Maximum acceleration and deceleration of interPlan's drivers, m/s².
    pub accelerations: (f64, f64),
}

/// A place of the row.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct PlacedCar {
    /// Progress on the lane, meters.
    pub s: f64,
    /// m/s.
    pub speed: f64,
    /// Whether it is the ego's place.
    pub is_ego: bool,
}

/// The places of a row, from its far end back.
pub(crate) fn fill_row(random: &mut PythonRandom, density: Density, row: &Row) -> Vec<PlacedCar> {
    let (accel, decel) = row.accelerations;
    let alpha = (accel + decel) / (2.0 * decel);
    let mut places: Vec<PlacedCar> = Vec::new();
    let mut s = row.length;
    while s > 0.0 {
        let mut gap = random.range(MIN_GAP, density.max_gap()) as f64;
        s -= gap;
        if s < 0.0 {
            break;
        }
        if row.is_ego_lane && (s - row.ego_s).abs() < NEAR_EGO {
            gap += s - row.ego_s;
            s = row.ego_s;
        }
        // interPlan compares the progress alone: a place exactly beside the ego, on any lane,
        // counts as the ego's.
        let is_ego = s.total_cmp(&row.ego_s).is_eq();
        let mut speed = match places.last() {
            None if row.leads_on => row.limit.unwrap_or(FALLBACK_SPEED),
            None => (2.0 / 3.0 * (row.length - s) * accel).sqrt(),
            Some(lead) => {
                let t = random.gauss(0.25, 0.05).max(0.1);
                let root = (t * t + 4.0 * alpha * (alpha * lead.speed * lead.speed + gap)).sqrt();
                (gap / 2.0).min((root - t) / (2.0 * alpha))
            }
        };
        speed += random.gauss(0.0, 1.0);
        speed = row.limit.map_or(speed, |limit| speed.min(limit)).max(0.0);
        places.push(PlacedCar { s, speed, is_ego });
    }
    places
}
