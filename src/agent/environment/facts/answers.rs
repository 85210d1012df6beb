//! The questions of the first round and their possible answers.

use super::traffic::{SAME_SPEED, STOPPED};
use crate::environment::choice::choice;
use crate::environment::lane_graph::Turn;

choice! {
    /// A question; its text is the key in labels and results.
    pub enum Question {
        SceneType = "scene_type",
        /// Next light.
        Light = "light",
        /// Lanes of the own direction.
        LaneCount = "lane_count",
        /// The ego's lane among them.
        LaneIndex = "lane_index",
        Crosswalk = "crosswalk",
        LeadDistance = "lead_distance",
        LeadSpeed = "lead_speed",
        Pedestrian = "pedestrian",
        /// Obstacle in the ego's lane.
        Blocked = "blocked",
        LeftLane = "left_lane",
        RightLane = "right_lane",
        /// Vehicles in view.
        VehicleCount = "vehicle_count",
        /// Lanes of the other direction.
        Oncoming = "oncoming",
        EgoSpeed = "ego_speed",
        /// Turn of the route.
        Turn = "turn",
        /// Vehicle that crosses the path.
        CrossingVehicle = "crossing_vehicle",
        /// Vehicle in the lanes of the other direction.
        OncomingVehicle = "oncoming_vehicle",
        /// Pedestrian on the path, or about to be.
        PersonOnPath = "person_on_path",
    }
}

impl Question {
    /// Number of questions of the first version, which come first: those of the prompt set
    /// `compact`.
    const FIRST: usize = 15;

    /// The questions of the first version.
    pub fn first_version() -> &'static [Self] {
        &Self::ALL[..Self::FIRST]
    }

    /// The texts of the possible answers.
    pub const fn choices(self) -> &'static [&'static str] {
        match self {
            Self::SceneType => SceneType::TEXTS,
            Self::Light => Light::TEXTS,
            Self::LaneCount => LaneCount::TEXTS,
            Self::LaneIndex => LaneIndex::TEXTS,
            Self::Crosswalk
            | Self::LeadDistance
            | Self::Pedestrian
            | Self::Blocked
            | Self::CrossingVehicle
            | Self::OncomingVehicle
            | Self::PersonOnPath => Ahead::TEXTS,
            Self::LeadSpeed => LeadSpeed::TEXTS,
            Self::LeftLane | Self::RightLane => SideLane::TEXTS,
            Self::VehicleCount => VehicleCount::TEXTS,
            Self::Oncoming => Oncoming::TEXTS,
            Self::EgoSpeed => EgoSpeed::TEXTS,
            Self::Turn => Turn::TEXTS,
        }
    }
}

choice! {
    /// Kind of place.
    pub enum SceneType {
        /// None of the others.
        Straight = "straight",
        /// The path turns left by more than `CURVE` within the view.
        CurveLeft = "curve_left",
        /// The path turns right by more than that.
        CurveRight = "curve_right",
        /// The path meets, within the view, an intersection in which connectors cross.
        Intersection = "intersection",
        /// A round cycle of lanes, shorter than `ROUNDABOUT_LENGTH`, begins ahead within
        /// the view.
        Roundabout = "roundabout",
    }
}

choice! {
    /// The next traffic light.
    pub enum Light {
        /// None near.
        None = "none",
        Green = "green",
        Yellow = "yellow",
        Red = "red",
    }
}

choice! {
    /// Number of lanes of one direction.
    pub enum LaneCount {
        One = "1",
        Two = "2",
        Three = "3",
        FourOrMore = "4+",
    }
}

impl LaneCount {
    pub(super) fn from_count(count: usize) -> Self {
        match count {
            0 | 1 => Self::One,
            2 => Self::Two,
            3 => Self::Three,
            _ => Self::FourOrMore,
        }
    }
}

choice! {
    /// Number of a lane of one direction, from the left.
    pub enum LaneIndex {
        First = "1",
        Second = "2",
        Third = "3",
        /// The fourth or one further right.
        FourthOrMore = "4+",
    }
}

impl LaneIndex {
    pub(super) fn from_lanes_to_left(lanes_to_the_left: usize) -> Self {
        match lanes_to_the_left {
            0 => Self::First,
            1 => Self::Second,
            2 => Self::Third,
            _ => Self::FourthOrMore,
        }
    }
}

choice! {
    /// Distance along the path from the ego's front bumper.
    pub enum Ahead {
        /// Nothing within [`Ahead::FAR`], or not in view.
        None = "none",
        /// Nearer than [`Ahead::NEAR`].
        Near = "near",
        /// Nearer than [`Ahead::MID`].
        Mid = "mid",
        /// Up to [`Ahead::FAR`].
        Far = "far",
    }
}

impl Ahead {
    /// End of near, meters.
    pub const NEAR: f64 = 12.0;
    /// End of mid, meters.
    pub const MID: f64 = 24.0;
    /// End of far, meters.
    pub const FAR: f64 = 32.0;

    pub(super) fn from_distance(distance: Option<f64>) -> Self {
        match distance {
            Some(d) if d < Self::NEAR => Self::Near,
            Some(d) if d < Self::MID => Self::Mid,
            Some(d) if d <= Self::FAR => Self::Far,
            _ => Self::None,
        }
    }
}

choice! {
    pub enum LeadSpeed {
        None = "none",
        /// Slower than [`super::STOPPED`].
        Stopped = "stopped",
        /// Slower than the ego by more than [`super::SAME_SPEED`].
        Slower = "slower",
        SameOrFaster = "same_or_faster",
    }
}

impl LeadSpeed {
    pub(super) fn from_speeds(lead: f64, ego: f64) -> Self {
        if lead < STOPPED {
            Self::Stopped
        } else if lead < ego - SAME_SPEED {
            Self::Slower
        } else {
            Self::SameOrFaster
        }
    }
}

choice! {
    /// A lane of the same direction beside the ego's.
    pub enum SideLane {
        None = "none",
        /// No object is beside the ego or near.
        Free = "free",
        /// An object is.
        Occupied = "occupied",
    }
}

choice! {
    /// Vehicles in view without the ego.
    pub enum VehicleCount {
        Zero = "0",
        Few = "1-2",
        Some = "3-5",
        Many = "6+",
    }
}

impl VehicleCount {
    pub(super) fn from_count(count: usize) -> Self {
        match count {
            0 => Self::Zero,
            1 | 2 => Self::Few,
            3..=5 => Self::Some,
            _ => Self::Many,
        }
    }
}

choice! {
    /// Whether there are lanes of the other direction.
    pub enum Oncoming {
        Yes = "yes",
        No = "no",
    }
}

choice! {
    pub enum EgoSpeed {
        /// Slower than [`super::STOPPED`].
        Stopped = "stopped",
        /// Slower than [`EgoSpeed::SLOW`].
        Slow = "slow",
        /// Slower than [`EgoSpeed::MEDIUM`].
        Medium = "medium",
        Fast = "fast",
    }
}

impl EgoSpeed {
    /// End of slow, m/s.
    pub const SLOW: f64 = 5.0;
    /// End of medium, m/s.
    pub const MEDIUM: f64 = 10.0;

    pub(super) fn from_speed(speed: f64) -> Self {
        if speed < STOPPED {
            Self::Stopped
        } else if speed < Self::SLOW {
            Self::Slow
        } else if speed < Self::MEDIUM {
            Self::Medium
        } else {
            Self::Fast
        }
    }
}
