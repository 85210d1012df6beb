//! Round 2: the longitudinal and lateral motion instruction of the paper, with reasons.

use crate::environment::choice::choice;

choice! {
    /// The longitudinal instruction.
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
    /// The lateral instruction.
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
    /// The reason for the longitudinal instruction: the strongest limit on the speed.
    pub enum LongitudinalReason {
        /// Nothing ahead, below the limit.
        FreeRoad = "free_road",
        /// At the speed limit.
        SpeedLimit = "speed_limit",
        /// A slower or stopped vehicle ahead.
        Lead = "lead",
        /// A red or yellow light.
        Light = "light",
        /// A pedestrian or bicycle on the path.
        Person = "person",
        /// An obstacle on the path.
        Obstacle = "obstacle",
    }
}

choice! {
    /// The reason for the lateral instruction.
    pub enum LateralReason {
        /// The lane follows the route without hindrance.
        LaneServes = "lane_serves",
        /// The lane is blocked.
        Blocked = "blocked",
        /// There is a slower lead agent.
        SlowLead = "slow_lead",
        /// The other lane is faster.
        FasterLane = "faster_lane",
        /// The goal is in the other lane.
        GoalLane = "goal_lane",
    }
}

/// The answer of round 2.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize, schemars::JsonSchema,
)]
pub struct MotionInstruction {
    pub longitudinal: Longitudinal,
    pub lateral: Lateral,
}

impl MotionInstruction {
    /// Reads the first longitudinal and the first lateral word in an answer of either form.
    pub fn find(answer: &str) -> Option<Self> {
        let words: Vec<String> = answer
            .split(|c: char| !(c.is_alphanumeric() || c == '_'))
            .map(str::to_lowercase)
            .filter(|word| !word.is_empty())
            .collect();
        let longitudinal = words.iter().find_map(|word| word.parse().ok())?;
        let lateral = words.iter().find_map(|word| word.parse().ok())?;
        Some(Self {
            longitudinal,
            lateral,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reads_both_forms() {
        let expected = Some(MotionInstruction {
            longitudinal: Longitudinal::Decelerate,
            lateral: Lateral::Keep,
        });
        assert_eq!(
            MotionInstruction::find("lon=decelerate because=light lat=keep because=lane_serves"),
            expected
        );
        let sentences =
            "Longitudinal: decelerate, because the light is red\nLateral: keep, because it serves";
        assert_eq!(MotionInstruction::find(sentences), expected);
        assert_eq!(MotionInstruction::find("slow down"), None);
    }
}
