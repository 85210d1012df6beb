//! The messages to a command that controls the other agents.

use super::messages::{ExecEgo, ExecLight, ExecObject, lights};
use planagent_world::geometry::{OrientedBox, Pose, Vector};
use planagent_world::{EgoState, TrackToken, TrackedObject, TrafficLights};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Largest coordinate of an answer, meters, and speed, m/s: larger ones would overflow in products.
const MAX_COORDINATE: f64 = 1e9;
const MAX_SPEED: f64 = 1e3;

/// An iteration of the other agents.
#[derive(Debug, Clone, Serialize, JsonSchema)]
pub struct ExecAgentsStep {
    /// The iteration that the answer is for, from 1.
    pub iteration: usize,
    /// Time since the iteration before, seconds.
    pub dt_s: f64,
    /// The ego at the iteration before, as in nuPlan.
    pub ego: ExecEgo,
    /// The objects at the iteration before.
    pub objects: Vec<ExecObject>,
    /// Traffic lights at this iteration, by lane connector.
    pub lights: Vec<ExecLight>,
    /// The recorded objects of this iteration.
    pub logged: Vec<ExecObject>,
}

/// The next state of an object: the center of its box.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize, JsonSchema)]
pub struct ExecAgent {
    /// Its track.
    pub track: u32,
    /// East.
    pub x: f64,
    /// North.
    pub y: f64,
    /// Heading.
    pub heading: f64,
    /// Velocity in the map frame, m/s.
    pub velocity: [f64; 2],
}

impl ExecAgentsStep {
    /// The message of an iteration, `dt_s` seconds after the one before.
    pub fn new(
        iteration: usize,
        dt_s: f64,
        ego: &EgoState,
        objects: &[TrackedObject],
        next_lights: &TrafficLights,
        logged: &[TrackedObject],
    ) -> Self {
        let listed =
            |objects: &[TrackedObject]| objects.iter().map(ExecObject::from_object).collect();
        Self {
            iteration,
            dt_s,
            ego: ExecEgo::from_state(ego),
            objects: listed(objects),
            lights: lights(next_lights),
            logged: listed(logged),
        }
    }
}

/// The objects after an answer: those that it names as it says, the others as recorded. Or what is
/// wrong with the answer.
pub fn moved(
    answer: &[ExecAgent],
    objects: &[TrackedObject],
    logged: &[TrackedObject],
) -> Result<Vec<TrackedObject>, String> {
    let mut next: BTreeMap<TrackToken, TrackedObject> = logged
        .iter()
        .map(|object| (object.token, *object))
        .collect();
    let mut named = Vec::with_capacity(answer.len());
    for agent in answer {
        let token = TrackToken(agent.track);
        let before = objects
            .iter()
            .find(|object| object.token == token)
            .or_else(|| next.get(&token));
        let Some(before) = before else {
            return Err(format!("track {token} is neither in objects nor in logged"));
        };
        if named.contains(&token) {
            return Err(format!("track {token} is named twice"));
        }
        let ExecAgent {
            x,
            y,
            heading,
            velocity: [east, north],
            ..
        } = *agent;
        // NaN is within no limit, so this refuses it too.
        let within = |value: f64, limit: f64| value.abs() <= limit;
        let fits = [x, y, heading]
            .into_iter()
            .all(|value| within(value, MAX_COORDINATE))
            && [east, north]
                .into_iter()
                .all(|value| within(value, MAX_SPEED));
        if !fits {
            return Err(format!(
                "the state of track {token} is out of range: {MAX_COORDINATE:e} m and {MAX_SPEED:e} m/s are the limits"
            ));
        }
        let shape = OrientedBox {
            center: Pose::new(x, y, heading),
            ..before.shape
        };
        let moved = TrackedObject {
            shape,
            velocity: Vector::new(east, north),
            ..*before
        };
        named.push(token);
        next.insert(token, moved);
    }
    Ok(next.into_values().collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use planagent_world::ObjectKind;

    fn object(track: u32, x: f64) -> TrackedObject {
        TrackedObject {
            token: TrackToken(track),
            kind: ObjectKind::Vehicle,
            shape: OrientedBox {
                center: Pose::new(x, 0.0, 0.0),
                length: 4.0,
                width: 2.0,
            },
            velocity: Vector::new(1.0, 0.0),
        }
    }

    #[test]
    fn what_an_answer_leaves_out_follows_the_log() {
        let (now, logged) = (
            [object(1, 0.0), object(2, 10.0)],
            [object(1, 0.1), object(3, 30.0)],
        );
        let agent = |track, x| ExecAgent {
            track,
            x,
            y: 1.0,
            heading: 0.5,
            velocity: [2.0, 0.0],
        };
        let places = |objects: &[TrackedObject]| -> Vec<(u32, f64)> {
            objects
                .iter()
                .map(|object| (object.token.0, object.shape.center.x))
                .collect()
        };
        assert_eq!(
            places(&moved(&[], &now, &logged).unwrap()),
            [(1, 0.1), (3, 30.0)]
        );
        let kept = moved(&[agent(2, 10.5), agent(3, 31.0)], &now, &logged).unwrap();
        assert_eq!(places(&kept), [(1, 0.1), (2, 10.5), (3, 31.0)]);
        assert_eq!(
            (kept[1].shape.length, kept[1].velocity),
            (4.0, Vector::new(2.0, 0.0))
        );
        for (answer, problem) in [
            (vec![agent(9, 0.0)], "track 9 is neither"),
            (vec![agent(1, 0.0), agent(1, 0.0)], "named twice"),
            (vec![agent(1, f64::NAN)], "out of range"),
        ] {
            assert!(
                moved(&answer, &now, &logged).unwrap_err().contains(problem),
                "{answer:?}"
            );
        }
    }
}
