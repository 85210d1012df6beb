//! The nodes of a lane graph: pieces of equal length of its centerlines.

use super::CenterlineName;
use crate::environment::choice::choice;
use planagent_world::LaneId;

choice! {
    /// Position of a node relative to the ego, in the order of the text.
    pub enum NodePlace {
        /// Under the ego, from its rear bumper on.
        Ego = "ego",
        /// Ahead in the ego's lane.
        Front = "front",
        /// Behind in the ego's lane.
        Back = "back",
        /// Beside on the left.
        Left = "left",
        FrontLeft = "front_left",
        BackLeft = "back_left",
        /// Beside on the right.
        Right = "right",
        FrontRight = "front_right",
        BackRight = "back_right",
    }
}

impl NodePlace {
    pub fn centerline(self) -> CenterlineName {
        match self {
            Self::Ego | Self::Front | Self::Back => CenterlineName::EgoLane,
            Self::Left | Self::FrontLeft | Self::BackLeft => CenterlineName::LeftLane,
            Self::Right | Self::FrontRight | Self::BackRight => CenterlineName::RightLane,
        }
    }

    /// The nodes of a centerline: beside (or under) the ego, ahead, behind. The oncoming lane has
    /// none.
    pub fn on(centerline: CenterlineName) -> Option<[Self; 3]> {
        match centerline {
            CenterlineName::EgoLane => Some([Self::Ego, Self::Front, Self::Back]),
            CenterlineName::LeftLane => Some([Self::Left, Self::FrontLeft, Self::BackLeft]),
            CenterlineName::RightLane => Some([Self::Right, Self::FrontRight, Self::BackRight]),
            CenterlineName::OncomingLane => None,
        }
    }
}

choice! {
    /// How a node is connected with the node under the ego or, for the corners, with the node ahead
    /// or behind.
    pub enum Connection {
        /// The node under the ego itself.
        Itself = "itself",
        /// The ego's lane leads on to it.
        Successor = "successor",
        /// It leads to the ego's lane.
        Predecessor = "predecessor",
        /// Side by side with the ego's lane: a change is possible there.
        Neighbor = "neighbor",
        /// Its lane goes another way there.
        Apart = "apart",
    }
}

/// A piece of a centerline.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LaneNode {
    pub place: NodePlace,
    /// The lane that holds its middle.
    pub lane: LaneId,
    pub connection: Connection,
    /// Start on the path of its centerline, meters.
    pub from_s: f64,
    /// End, meters; the last node of a path may be shorter than the others.
    pub to_s: f64,
}
