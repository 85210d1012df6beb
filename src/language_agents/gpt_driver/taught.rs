//! The answer of GPT-Driver's teacher. Reasons and action follow the rules by which the original
//! labels its training set; the waypoints are those of the plan that a search chose.

use super::grammar::TIMES;
use super::{GptDriver, NamedObject, Observation, nearest_objects};
use crate::oracle;
use crate::teaching::{QuestionTexts, Taught};
use planagent_agent::environment::GraphedScene;
use planagent_agent::reasoning::{PromptError, SeenPlace, WaypointList};
use planagent_agent::simulation::ClosedLoop;
use planagent_controls::search::Candidate;
use planagent_world::{EgoState, PACIFICA};

/// Objects that the grammar lets a chain of reasons name.
const REASONS: usize = 2;
/// Room around an object beside the ego, meters, and along: the original's.
const ROOM: (f64, f64) = (1.0, 3.0);
/// A plan stays in its lane within this distance to a side, meters: the original's.
const SIDE: f64 = 2.0;
/// Farther to a side it turns, meters: the original's.
const TURN: f64 = 4.0;
/// A change of speed up to this is none, meters in half a second: the original's. Twice as much is
/// hard.
const CHANGE: f64 = 0.5;
/// What moves less in half a second stands, meters: 0.2 m/s, as slow as the simulation's standstill.
const STANDING: f64 = 0.1;
/// Length of a half second, seconds.
const HALF_SECOND: f64 = 0.5;

impl Taught for GptDriver {
    fn question(&self, observation: &Observation) -> Result<QuestionTexts, PromptError> {
        self.question_texts(observation, None)
    }

    fn best(&self, simulation: &ClosedLoop<'_>, code: &Candidate) -> Option<WaypointList> {
        oracle::waypoints_of(simulation, code)
    }

    fn words(
        &self,
        waypoints: WaypointList,
        observation: &Observation,
        GraphedScene { scene, .. }: GraphedScene<'_>,
    ) -> String {
        let conflicts: Vec<String> = nearest_objects(scene)
            .filter_map(|named| {
                let time = conflict(scene.ego, &named)?;
                Some(format!("{} after {time} s", named.name))
            })
            .take(REASONS)
            .collect();
        let reasons = if conflicts.is_empty() {
            "none".to_owned()
        } else {
            conflicts.join("; ")
        };
        let now = observation.motion.speed() * HALF_SECOND;
        // The sign of what rounds to zero says nothing that could be learned.
        let places = waypoints.to_string().replace("-0.00", "0.00");
        format!(
            "Reasons: {reasons}\nAction: {}\nTrajectory: {places}",
            action(&waypoints, now)
        )
    }
}

/// When an object comes into the way of an ego that keeps its acceleration; `None` if it does not
/// within three seconds.
fn conflict(ego: &EgoState, named: &NamedObject<'_>) -> Option<&'static str> {
    let (velocity, acceleration) = (ego.center_velocity(), ego.acceleration);
    let shape = &named.object.shape;
    let aside = f64::midpoint(PACIFICA.width, shape.width) + ROOM.0;
    let along = f64::midpoint(PACIFICA.length(), shape.length) + ROOM.1;
    let mut times = named.places.iter().zip(TIMES).enumerate();
    times.find_map(|(step, (&(right, ahead), time))| {
        let t = step as f64 * HALF_SECOND;
        let gone = velocity * t + acceleration * (t * t / 2.0);
        let touches = (right + gone.y).abs() < aside && (ahead - gone.x).abs() < along;
        (ahead > 0.0 && touches).then_some(time)
    })
}

/// The words of a plan for an ego that now moves this far in half a second, meters.
fn action(waypoints: &WaypointList, now: f64) -> String {
    let [.., before, last] = waypoints.0;
    if last.right.hypot(last.ahead) < STANDING {
        return "stop".to_owned();
    }
    let end = (last.right - before.right).hypot(last.ahead - before.ahead);
    format!("{} {}", behavior(waypoints), speed(end - now, end))
}

fn behavior(waypoints: &WaypointList) -> &'static str {
    let inside = |place: &SeenPlace| place.right.abs() < SIDE;
    let [.., last] = waypoints.0;
    if waypoints.0.iter().all(inside) {
        return "move forward";
    }
    match (last.right > 0.0, last.right.abs() > TURN) {
        (false, true) => "turn left",
        (true, true) => "turn right",
        (false, false) => "change to the left lane",
        (true, false) => "change to the right lane",
    }
}

/// The words of a change to this end, both meters in half a second.
fn speed(change: f64, end: f64) -> &'static str {
    if change > 2.0 * CHANGE {
        "accelerating hard"
    } else if change > CHANGE {
        "accelerating"
    } else if change >= -CHANGE {
        "at constant speed"
    } else if end < STANDING {
        "decelerating to a stop"
    } else if change < -2.0 * CHANGE {
        "decelerating hard"
    } else {
        "decelerating"
    }
}
