//! The grammar of a list of waypoints.

use super::{Motion, SPACING_S};
use planagent_agent::reasoning::LISTED_WAYPOINTS;
use planagent_mllm::Constraint;

/// Acceleration up to which places are offered, m/s².
const ACCELERATION: f64 = 3.0;
/// Places beside the ego's heading are offered up to this share of those along it.
const ASIDE: f64 = 0.5;
/// Room around what the ego's motion explains, meters.
const ROOM: f64 = 1.0;

/// One of these texts.
pub(crate) fn any_of<S: Into<String>>(texts: impl IntoIterator<Item = S>) -> Constraint {
    Constraint::Choice(texts.into_iter().map(Into::into).collect())
}

/// This text.
pub(crate) fn text(text: impl Into<String>) -> Constraint {
    any_of([text.into()])
}

/// A list of as many places as are asked for, with two decimals: places that the ego can reach in
/// time, none behind it.
pub(crate) fn waypoints(motion: Motion) -> Constraint {
    let mut parts = vec![text("[")];
    for waypoint in 1..=LISTED_WAYPOINTS {
        let time_s = waypoint as f64 * SPACING_S;
        let ahead = motion.speed() * time_s + ACCELERATION * time_s * time_s / 2.0 + ROOM;
        let aside = (ahead * ASIDE + ROOM).floor() as i64;
        let negative = (0..=aside).rev().map(|meters| format!("-{meters}"));
        let positive = (0..=aside).map(|meters| meters.to_string());
        parts.push(text(if waypoint == 1 { "(" } else { ", (" }));
        parts.push(any_of(negative.chain(positive)));
        parts.push(decimals());
        parts.push(text(","));
        parts.push(any_of(
            (0..=ahead.floor() as i64).map(|meters| meters.to_string()),
        ));
        parts.push(decimals());
        parts.push(text(")"));
    }
    parts.push(text("]"));
    Constraint::Sequence(parts)
}

/// The point and two digits.
fn decimals() -> Constraint {
    Constraint::Regex(r"\.[0-9][0-9]".to_owned())
}
