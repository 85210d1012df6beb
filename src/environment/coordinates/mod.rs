//! Scene texts in coordinates, as earlier language-model planners write them: to be counted beside the lane graph's text, and
//! to be shown to LLM-ASSIST's planners. Which facts they state is published in part; where it is not, the choice is ours and
//! said so. All sentences are ours. Every number has two decimals.

mod gpt_driver;
mod llm_assist;

pub use gpt_driver::GptDriverText;
pub use llm_assist::llm_assist_text;

use crate::geometry::{Point, Pose};

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
    if text == "-0.00" { "0.00".to_owned() } else { text }
}
