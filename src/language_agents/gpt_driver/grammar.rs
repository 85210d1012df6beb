//! The grammar of GPT-Driver's answer: reasons, action, trajectory.

use crate::waypoints::{Motion, any_of, text, waypoint_grammar};
use planagent_mllm::Constraint;

/// When an object comes into the ego's way, seconds.
pub(super) const TIMES: [&str; 7] = ["0.0", "0.5", "1.0", "1.5", "2.0", "2.5", "3.0"];
/// What the ego does apart from stopping,
const BEHAVIORS: [&str; 5] = [
    "move forward",
    "turn left",
    "turn right",
    "change to the left lane",
    "change to the right lane",
];
/// and how fast.
const SPEEDS: [&str; 6] = [
    "at constant speed",
    "accelerating",
    "accelerating hard",
    "decelerating",
    "decelerating hard",
    "decelerating to a stop",
];

/// The whole answer: up to two objects that matter, an action, six waypoints.
pub(super) fn answer(objects: &[String], motion: Motion) -> Constraint {
    Constraint::Sequence(vec![
        text("Reasons: "),
        reasons(objects),
        text("\nAction: "),
        action(),
        text("\nTrajectory: "),
        waypoint_grammar(motion),
    ])
}

/// The objects that matter with the time of the conflict.
pub(crate) fn reasons(objects: &[String]) -> Constraint {
    if objects.is_empty() {
        return text("none");
    }
    let one = || {
        vec![
            any_of(objects.iter().cloned()),
            text(" after "),
            any_of(TIMES),
            text(" s"),
        ]
    };
    let two = [one(), vec![text("; ")], one()].concat();
    Constraint::OneOf(vec![
        text("none"),
        Constraint::Sequence(one()),
        Constraint::Sequence(two),
    ])
}

/// The words of what the ego does; shared by the agents that write waypoints.
pub(crate) fn action() -> Constraint {
    let moving = Constraint::Sequence(vec![any_of(BEHAVIORS), text(" "), any_of(SPEEDS)]);
    Constraint::OneOf(vec![text("stop"), moving])
}
