//! The answers of LLM-ASSIST that its oracles try out: waypoints around PDM-Closed's path, and
//! parameters of PDM-Closed.

use planagent_agent::reasoning::{
    ACCELERATIONS, AssistParameters, DECELERATIONS, WAYPOINT_SECONDS, Waypoint, Waypoints,
};
use planagent_score::pdm::{PdmParameters, PdmPlan, ReferencePath};
use planagent_world::geometry::Pose;
use planagent_world::{EgoState, SceneView};

/// Steps of 0.1 s between two waypoints.
const STEPS: usize = 10;
/// Accelerations of the waypoints along the path, m/s²: from one that gains speed to a hard brake.
const WAYPOINT_ACCELERATIONS: [f64; 5] = [1.0, 0.0, -1.5, -3.0, -6.0];
/// Distances from the path at the last waypoint, meters: PDM-Closed's own, and a lane's width.
const OFFSETS: [f64; 5] = [0.0, 1.0, -1.0, 3.5, -3.5];
/// Share of the way to the side at each waypoint: it begins and ends gently.
const ASIDE: [f64; WAYPOINT_SECONDS] = [0.16, 0.5, 0.84, 1.0];
/// Speeds of PDM-Closed's fastest proposal, as shares of the limit.
const CAPS: [f64; 4] = [0.2, 0.4, 0.7, 1.0];
/// Limit if the map has none, m/s.
const FALLBACK_LIMIT: f64 = 15.0;
/// Smallest and largest speed of an answer, m/s. No limit reaches the largest: it caps nothing.
const SPEEDS: (f64, f64) = (1.0, 40.0);
/// Gaps, meters, and headways, seconds: those that the grammar offers.
const GAPS: [f64; 4] = [0.5, 1.0, 2.0, 4.0];
const HEADWAYS: [f64; 4] = [0.8, 1.2, 1.5, 2.5];

/// Waypoints around PDM-Closed's path; its own plan comes first.
pub(crate) fn waypoints(
    scene: &SceneView<'_>,
    path: &ReferencePath,
    rules: &PdmPlan,
) -> Vec<Waypoints> {
    let line = path.centerline().line();
    let ego = scene.ego;
    let from = ego.center();
    let on = line.project(from.position());
    let speed = ego.velocity.x.max(0.0);
    let around = |acceleration: f64, offset: f64| {
        Waypoints(std::array::from_fn(|waypoint| {
            let s = on.s + driven(speed, acceleration, (waypoint + 1) as f64);
            let lateral = on.lateral + (offset - on.lateral) * ASIDE[waypoint];
            // Behind the end of the path the way goes straight on.
            let beyond = (s - line.length()).max(0.0);
            seen(from, line.pose_at(s - beyond).translated(beyond, lateral))
        }))
    };
    let grid = WAYPOINT_ACCELERATIONS
        .into_iter()
        .flat_map(|acceleration| OFFSETS.map(|offset| around(acceleration, offset)));
    own(from, &rules.simulated[rules.best])
        .into_iter()
        .chain(grid)
        .collect()
}

/// The waypoints of a simulated proposal; `None` for one that is too short.
fn own(from: Pose, states: &[EgoState]) -> Option<Waypoints> {
    let at = |second: usize| Some(seen(from, states.get(second * STEPS)?.center()));
    let [a, b, c, d] = [1, 2, 3, 4].map(at);
    Some(Waypoints([a?, b?, c?, d?]))
}

fn seen(from: Pose, place: Pose) -> Waypoint {
    let local = from.to_local(place.position());
    Waypoint {
        ahead: local.x,
        left: local.y,
    }
}

/// Meters after a time at a constant acceleration, at most to a standstill.
fn driven(speed: f64, acceleration: f64, seconds: f64) -> f64 {
    let moving = if acceleration < 0.0 {
        seconds.min(speed / -acceleration)
    } else {
        seconds
    };
    speed * moving + 0.5 * acceleration * moving * moving
}

/// PDM-Closed's own parameters.
pub(crate) fn own_parameters() -> AssistParameters {
    let PdmParameters {
        speed_cap: _,
        min_gap,
        headway,
        accel_max,
        decel_max,
        emergency_brake,
    } = PdmParameters::default();
    AssistParameters {
        speed_cap: SPEEDS.1,
        min_gap,
        headway,
        accel_max,
        decel_max,
        emergency_brake,
    }
}

/// What a parameter of some others may be instead; the limit is in m/s.
pub(crate) type Variations = fn(AssistParameters, f64) -> Vec<AssistParameters>;

/// The variations of each parameter, in the order of the answer.
pub(crate) const VARIATIONS: [Variations; 6] = [
    |from, limit| {
        let capped = |share: f64| AssistParameters {
            speed_cap: (share * limit).clamp(SPEEDS.0, SPEEDS.1),
            ..from
        };
        CAPS.map(capped).to_vec()
    },
    |from, _| {
        GAPS.map(|min_gap| AssistParameters { min_gap, ..from })
            .to_vec()
    },
    |from, _| {
        HEADWAYS
            .map(|headway| AssistParameters { headway, ..from })
            .to_vec()
    },
    |from, _| {
        ACCELERATIONS
            .map(|accel_max| AssistParameters { accel_max, ..from })
            .to_vec()
    },
    |from, _| {
        DECELERATIONS
            .map(|decel_max| AssistParameters { decel_max, ..from })
            .to_vec()
    },
    |from, _| {
        vec![AssistParameters {
            emergency_brake: !from.emergency_brake,
            ..from
        }]
    },
];

/// The speed limit of a path at the ego, m/s.
pub(crate) fn limit(scene: &SceneView<'_>, path: &ReferencePath) -> f64 {
    path.speed_limit(scene.map, scene.ego)
        .unwrap_or(FALLBACK_LIMIT)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_brake_ends_at_a_standstill() {
        for (speed, acceleration, seconds, meters) in [
            (6.0, -3.0, 1.0, 4.5),
            (6.0, -3.0, 2.0, 6.0),
            (6.0, -3.0, 4.0, 6.0),
            (6.0, 1.0, 2.0, 14.0),
            (0.0, -3.0, 2.0, 0.0),
        ] {
            assert!((driven(speed, acceleration, seconds) - meters).abs() < 1e-12);
        }
    }

    #[test]
    fn every_variation_changes_one_parameter_to_what_can_be_answered() {
        let own = own_parameters();
        for vary in VARIATIONS {
            let varied = vary(own, 0.5);
            assert!(varied.iter().any(|other| *other != own));
            for other in varied {
                let changed = [
                    other.speed_cap.to_bits() != own.speed_cap.to_bits(),
                    other.min_gap.to_bits() != own.min_gap.to_bits(),
                    other.headway.to_bits() != own.headway.to_bits(),
                    other.accel_max.to_bits() != own.accel_max.to_bits(),
                    other.decel_max.to_bits() != own.decel_max.to_bits(),
                    other.emergency_brake != own.emergency_brake,
                ];
                assert!(changed.into_iter().filter(|&changed| changed).count() <= 1);
                assert!((SPEEDS.0..=SPEEDS.1).contains(&other.speed_cap));
            }
        }
    }
}
