//! Round 2: the longitudinal and lateral motion instruction of the paper, with reasons.

use crate::environment::choice::choice;

choice! {
    /// What to do along the road.
    pub enum Longitudinal {
        /// Go faster.
        Accelerate = "accelerate",
        /// Go slower or stop.
        Decelerate = "decelerate",
        /// Keep the speed.
        Maintain = "maintain",
    }
}

choice! {
    /// What to do across the road.
    pub enum Lateral {
        /// Into the lane to the left.
        ChangeLeft = "change_left",
        /// Into the lane to the right.
        ChangeRight = "change_right",
        /// Stay in the lane.
        Keep = "keep",
    }
}

choice! {
    /// Why the longitudinal instruction was given: what limits the speed most.
    pub enum LongitudinalReason {
        /// Nothing ahead, below the limit.
        FreeRoad = "free_road",
        /// At the speed limit.
        SpeedLimit = "speed_limit",
        /// A slower or stopped vehicle ahead.
        Lead = "lead",
        /// A red or yellow light.
        Light = "light",
        /// Somebody on foot or on a bicycle on the way.
        Person = "person",
        /// An obstacle on the way.
        Obstacle = "obstacle",
    }
}

choice! {
    /// Why the lateral instruction was given.
    pub enum LateralReason {
        /// The lane serves.
        LaneServes = "lane_serves",
        /// Something stands in the lane.
        Blocked = "blocked",
        /// Somebody drives ahead in the lane.
        SlowLead = "slow_lead",
        /// The other lane gets on better.
        FasterLane = "faster_lane",
    }
}

/// The answer of round 2.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize, schemars::JsonSchema)]
pub struct MotionInstruction {
    /// Along the road.
    pub longitudinal: Longitudinal,
    /// Across the road.
    pub lateral: Lateral,
}

impl MotionInstruction {
    /// Reads the two words out of an answer of either form: the first longitudinal and the first lateral word in it.
    pub fn find(answer: &str) -> Option<Self> {
        let words: Vec<String> = answer
            .split(|c: char| !(c.is_alphanumeric() || c == '_'))
            .map(str::to_lowercase)
            .filter(|word| !word.is_empty())
            .collect();
        let longitudinal = words.iter().find_map(|word| word.parse().ok())?;
        let lateral = words.iter().find_map(|word| word.parse().ok())?;
        Some(Self { longitudinal, lateral })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reads_both_forms() {
        let expected = Some(MotionInstruction { longitudinal: Longitudinal::Decelerate, lateral: Lateral::Keep });
        assert_eq!(MotionInstruction::find("lon=decelerate because=light lat=keep because=lane_serves"), expected);
        let sentences = "Longitudinal: decelerate, because the light is red\nLateral: keep, because it serves";
        assert_eq!(MotionInstruction::find(sentences), expected);
        assert_eq!(MotionInstruction::find("slow down"), None);
    }
}
