//! Scene texts in coordinates, as earlier language-model planners write them: for token counts
//! beside the lane graph's text, and for LLM-ASSIST's planners. Their facts are published in part;
//! the docs name our choices. All sentences are ours. Every number has two decimals.

mod gpt_driver;
mod llm_assist;

pub use gpt_driver::{EgoFacts, GptDriverText, seen_objects};
pub use llm_assist::llm_assist_text;

use planagent_world::geometry::{Point, Pose};

/// A place in a frame, meters.
fn place(x: f64, y: f64) -> String {
    format!("({},{})", decimal(x), decimal(y))
}

/// A point as seen from a pose: meters ahead, meters to the left.
fn seen_from(from: &Pose, point: Point) -> String {
    let local = from.to_local(point);
    place(local.x, local.y)
}

/// Two decimals; zero has no sign.
fn decimal(value: f64) -> String {
    let text = format!("{value:.2}");
    if text == "-0.00" {
        "0.00".to_owned()
    } else {
        text
    }
}
