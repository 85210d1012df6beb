//! The types of drives that the generator makes.

use std::fmt;
use std::str::FromStr;

macro_rules! scenario_types {
    (
        types { $($(#[$doc:meta])* $variant:ident = $name:literal,)* }
        cases { $($(#[$case_doc:meta])* $case:ident = $case_name:literal,)* }
    ) => {
        /// Type of a generated drive: nuPlan's fourteen, two for junctions without lights, and two cases of the paper.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub enum ScenarioType {
            $($(#[$doc])* $variant,)*
            $($(#[$case_doc])* $case,)*
        }

        impl ScenarioType {
            /// All types; suites and data sets are made of these.
            pub const ALL: [Self; [$($name),*].len()] = [$(Self::$variant),*];
            /// The cases: driven by name alone.
            pub const CASES: [Self; [$($case_name),*].len()] = [$(Self::$case),*];

            /// Its name as nuPlan writes it.
            pub fn name(self) -> &'static str {
                match self {
                    $(Self::$variant => $name,)*
                    $(Self::$case => $case_name,)*
                }
            }
        }
    };
}

scenario_types! {
    types {
    /// Turns left at a crossing.
    StartingLeftTurn = "starting_left_turn",
    /// Turns right at a crossing.
    StartingRightTurn = "starting_right_turn",
    /// Crosses a signalled crossing straight on.
    StartingStraightTrafficLightIntersectionTraversal = "starting_straight_traffic_light_intersection_traversal",
    /// Comes to a stop behind a lead.
    StoppingWithLead = "stopping_with_lead",
    /// Drives through a bend with noticeable lateral acceleration.
    HighLateralAcceleration = "high_lateral_acceleration",
    /// Drives fast.
    HighMagnitudeSpeed = "high_magnitude_speed",
    /// Creeps.
    LowMagnitudeSpeed = "low_magnitude_speed",
    /// Passes a kerb-side bay where people get in and out.
    TraversingPickupDropoff = "traversing_pickup_dropoff",
    /// Gives way to a pedestrian.
    WaitingForPedestrianToCross = "waiting_for_pedestrian_to_cross",
    /// Follows a truck or bus.
    BehindLongVehicle = "behind_long_vehicle",
    /// Stands among other vehicles.
    StationaryInTraffic = "stationary_in_traffic",
    /// Drives among many vehicles.
    NearMultipleVehicles = "near_multiple_vehicles",
    /// Changes lanes.
    ChangingLane = "changing_lane",
    /// Follows a lead.
    FollowingLaneWithLead = "following_lane_with_lead",
    /// Crosses a crossing without lights (nuPlan: `traversing_intersection`).
    TraversingIntersection = "traversing_intersection",
    /// Drives through a roundabout; nuPlan has no type of its own for it.
    TraversingRoundabout = "traversing_roundabout",
    }
    cases {
    /// The paper's first: at the entry of a roundabout somebody waits in the ego's lane, and the lane beside is free.
    CaseRoundabout = "case_roundabout",
    /// The paper's second: a light turns red before the ego, with people at the crosswalk behind its stop line.
    CaseRedLight = "case_red_light",
    }
}

impl ScenarioType {
    /// The fourteen types of nuPlan's benchmarks (Val14, Test14).
    pub fn nuplan14() -> impl Iterator<Item = Self> {
        let extra = [Self::TraversingIntersection, Self::TraversingRoundabout];
        Self::ALL.into_iter().filter(move |kind| !extra.contains(kind))
    }
}

impl fmt::Display for ScenarioType {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for ScenarioType {
    type Err = super::GeneratorError;

    fn from_str(name: &str) -> Result<Self, Self::Err> {
        let known = Self::ALL.into_iter().chain(Self::CASES).find(|kind| kind.name() == name);
        known.ok_or_else(|| super::GeneratorError::UnknownType(name.to_owned()))
    }
}
