//! The part of a log that is a scenario: nuPlan's scenario types and the window around their tag.

/// The scenario types of nuPlan's scenario mapping, in alphabetical order (devkit
/// `nuplan_scenario_mapping.yaml`; the challenge's mapping is the same).
pub(crate) const MAPPED_TYPES: [&str; 73] = [
    "accelerating_at_crosswalk",
    "accelerating_at_stop_sign",
    "accelerating_at_stop_sign_no_crosswalk",
    "accelerating_at_traffic_light",
    "accelerating_at_traffic_light_with_lead",
    "accelerating_at_traffic_light_without_lead",
    "behind_bike",
    "behind_long_vehicle",
    "behind_pedestrian_on_driveable",
    "behind_pedestrian_on_pickup_dropoff",
    "changing_lane",
    "changing_lane_to_left",
    "changing_lane_to_right",
    "changing_lane_with_lead",
    "changing_lane_with_trail",
    "crossed_by_bike",
    "crossed_by_vehicle",
    "following_lane_with_lead",
    "following_lane_with_slow_lead",
    "following_lane_without_lead",
    "high_lateral_acceleration",
    "high_magnitude_jerk",
    "high_magnitude_speed",
    "low_magnitude_speed",
    "medium_magnitude_speed",
    "near_barrier_on_driveable",
    "near_construction_zone_sign",
    "near_high_speed_vehicle",
    "near_long_vehicle",
    "near_multiple_bikes",
    "near_multiple_pedestrians",
    "near_multiple_vehicles",
    "near_pedestrian_at_pickup_dropoff",
    "near_pedestrian_on_crosswalk",
    "near_pedestrian_on_crosswalk_with_ego",
    "near_trafficcone_on_driveable",
    "on_all_way_stop_intersection",
    "on_carpark",
    "on_intersection",
    "on_pickup_dropoff",
    "on_stopline_crosswalk",
    "on_stopline_stop_sign",
    "on_stopline_traffic_light",
    "on_traffic_light_intersection",
    "starting_high_speed_turn",
    "starting_left_turn",
    "starting_low_speed_turn",
    "starting_protected_cross_turn",
    "starting_protected_noncross_turn",
    "starting_right_turn",
    "starting_straight_stop_sign_intersection_traversal",
    "starting_straight_traffic_light_intersection_traversal",
    "starting_u_turn",
    "starting_unprotected_cross_turn",
    "starting_unprotected_noncross_turn",
    "stationary",
    "stationary_at_crosswalk",
    "stationary_at_traffic_light_with_lead",
    "stationary_at_traffic_light_without_lead",
    "stationary_in_traffic",
    "stopping_at_crosswalk",
    "stopping_at_stop_sign_no_crosswalk",
    "stopping_at_stop_sign_with_lead",
    "stopping_at_stop_sign_without_lead",
    "stopping_at_traffic_light_with_lead",
    "stopping_at_traffic_light_without_lead",
    "stopping_with_lead",
    "traversing_crosswalk",
    "traversing_intersection",
    "traversing_narrow_lane",
    "traversing_pickup_dropoff",
    "traversing_traffic_light_intersection",
    "waiting_for_pedestrian_to_cross",
];

/// Rows per iteration: every second row of 20 Hz (mapping: `subsample_ratio_override` 0.5).
pub(crate) const ROWS_PER_STEP: usize = 2;

/// Nominal time between rows, s (the devkit's database interval).
pub(super) const ROW_S: f64 = 0.05;

/// The part of a log around the tagged row.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Extraction {
    /// From the tagged row to the start, µs; negative for an earlier start.
    pub offset_us: i64,
    /// From the start to the end, µs, both inclusive.
    pub duration_us: i64,
}

impl Extraction {
    /// Of the types in the mapping: 15 s, from 3 s before the tag.
    pub(crate) const MAPPED: Self = Self {
        offset_us: -3_000_000,
        duration_us: 15_000_000,
    };
    /// Of all other types: 20 s, from the row on.
    pub(crate) const UNMAPPED: Self = Self {
        offset_us: 0,
        duration_us: 20_000_000,
    };

    pub fn for_type(scenario_type: &str) -> Self {
        if MAPPED_TYPES.binary_search(&scenario_type).is_ok() {
            Self::MAPPED
        } else {
            Self::UNMAPPED
        }
    }

    /// First and last time of the window of a row at `anchor_us`, µs, both inclusive.
    pub fn window(&self, anchor_us: i64) -> (i64, i64) {
        let start = anchor_us.saturating_add(self.offset_us);
        (start, start.saturating_add(self.duration_us))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::UNKNOWN_TYPE;

    #[test]
    fn the_mapping_covers_its_types_and_no_others() {
        assert!(MAPPED_TYPES.is_sorted(), "binary search needs order");
        assert_eq!(
            Extraction::for_type("changing_lane").window(10_000_000),
            (7_000_000, 22_000_000)
        );
        assert_eq!(
            Extraction::for_type(UNKNOWN_TYPE).window(10_000_000),
            (10_000_000, 30_000_000)
        );
        assert_eq!(Extraction::for_type("changing_lan"), Extraction::UNMAPPED);
    }
}
