//! The card of a model: what it is worth as the source of an agent's planner codes, on one page.
//!
//! Its scores are those of the closed loop, beside the same loop with codes that no model wrote.
//! What cannot be seen in scores is asked at states that a search drives to: whether probable codes
//! are good ones, whether the picture matters, and whether the code follows from the answers before
//! it. Measured times stand apart, so that all else is the same bytes each time.

mod calibration;
mod calls;
mod changes;
mod content;
mod error;
mod estimate;
mod given;
mod make;
mod measured;
mod outcome;
mod page;
mod pictures;
mod plot;
mod questions;
mod reasoning;
mod scores;
mod sections;
mod simulations;
mod state_record;
mod states;

pub use make::{CardMade, CardRequest, DEFAULT_LIMIT, make};
pub use page::{CARD_PAGE, card_text};
pub use sections::Section;
