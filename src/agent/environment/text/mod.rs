//! The lane graph in words.
//!
//! A [`Description`] holds the facts that are put into words, already rounded as the words have
//! them. Numbers are whole meters and whole meters per second, both at most [`MAX_NUMBER`].
//! [`TextForm::Paper`] puts all of it into short English lines for general models;
//! [`TextForm::Compact`] says its [`Description::reduced`] part in words at fixed places for a
//! small model. Tests read either text back (`tests/scene_text`).
//!
//! **Paper set**, four lines; every agent on the nine nodes is named, and the next light of every
//! lane:
//!
//! ```text
//! Ego: 9 m/s, limit 13 m/s, route straight, light red in 24 m.
//! ego_lane: ego free; front vehicle1 12 m 5 m/s; back free.
//! left_lane: light green in 24 m; left free; front_left vehicle2 8 m 9 m/s, vehicle3 20 m 9 m/s; back_left free.
//! right_lane: none.
//! ```
//!
//! There is a fifth line where something that stands permanently blocks the ego's lane and the
//! oncoming one leads past it: `oncoming_lane: past 12 m to 17 m; next vehicle 46 m 8 m/s.` or
//! `oncoming_lane: past 12 m to 17 m; free.` Where the score asks for a goal's lane, the first line
//! ends with it: `Goal: 2 lanes to the left, in 180 m.` or `Goal: this lane, in 180 m.`
//!
//! `limit unknown, about 13 m/s`: the map has none; the number is an estimate by lanes and traffic.
//! `free`: nobody is on the node. `none`: there is no such node. `(apart)` before what is on it:
//! its lane goes another way there. `crossing` or `oncoming` after a speed: the agent moves across
//! or against the lane.
//!
//! **Brief set**: the same lines with the nearest agent of each node ([`Description::nearest`]); `2
//! more` after the light counts the others.
//!
//! **Compact set**, one line of 47 words, whatever the scene. It begins with ego speed, limit (`-`
//! if unknown), light and distance to its stop line (`none -`), and the turn of the route. For each
//! of the nine nodes follow its name, the nearest agent on it, its distance and its speed (or
//! `crossing`, `oncoming`); or `free - -`, or `none - -`. The line ends with the number of agents
//! left out. The second version writes `~11` where the limit is unknown and may be 11 m/s. It ends
//! in `oncoming 12 17 46 8` where the oncoming lane leads past what blocks the ego's. Then comes
//! `goal left 2 60` where the goal is 2 lanes to the left, or `goal ego 0 60` where it is in this
//! lane. So at most the nearest on the ego's node and the nearest on the one ahead are named in the
//! ego's lane.

mod compact;
mod description;
mod paper;

pub use description::{
    AgentDescription, Description, GoalDescription, LightDescription, MAX_NUMBER, NodeDescription,
    OncomingDescription,
};

use super::choice::choice;

choice! {
    /// The ways of putting a scene into words.
    pub enum TextForm {
        /// Readable English, for general models.
        Paper = "paper",
        /// The same with the nearest agents alone.
        Brief = "brief",
        /// Few words at fixed places, for a small model of our own.
        Compact = "compact",
        /// The same with an estimate of an unknown limit, the oncoming lane, and the goal's.
        Compact2 = "compact-2",
    }
}

impl TextForm {
    /// Whether it names the oncoming lane where that leads past what blocks the ego's. The first
    /// compact text is that of a trained model and stays as it is.
    pub fn names_oncoming_lane(self) -> bool {
        self != Self::Compact
    }

    /// Whether it names the goal's lane.
    pub fn names_goal(self) -> bool {
        self != Self::Compact
    }

    /// Whether it is one of the forms for small models.
    pub fn is_for_small_models(self) -> bool {
        matches!(self, Self::Compact | Self::Compact2)
    }

    /// Whether a text is a compact one: only these begin with the word `speed` and its number.
    pub fn is_compact(text: &str) -> bool {
        let mut words = text.split(' ');
        words.next() == Some(compact::SPEED)
            && words
                .next()
                .is_some_and(|number| number.parse::<u32>().is_ok())
    }
}

/// The description in words; ends without a newline.
pub fn write(description: &Description, set: TextForm) -> String {
    match set {
        TextForm::Paper => paper::write(description),
        TextForm::Brief => paper::write(&description.nearest()),
        TextForm::Compact => compact::write(description),
        TextForm::Compact2 => compact::write_with_estimate(description),
    }
}

#[cfg(test)]
mod tests;
