//! Argoverse 2's categories as nuPlan's kinds of objects.
//!
//! * nuPlan's bicycles include motorcycles, its generic objects permanent poles and animals.
//! * A rider and the vehicle are two annotated boxes, hence two objects that overlap.
//! * nuPlan's trailers are vehicles, also those that carry signs.
//! * `EGO_VEHICLE` is a row of `annotations_with_ego.feather`: the recording car at the origin of
//!   its own frame. Stop signs belong to the map, not to nuPlan's objects.

use planagent_world::ObjectKind;

/// A category in nuPlan's terms.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Meaning {
    Object(ObjectKind),
    NoObject,
}

/// A category of the sensor dataset; `None` if unknown.
pub(super) fn of_annotation(word: &str) -> Option<Meaning> {
    let kind = match word {
        "REGULAR_VEHICLE"
        | "LARGE_VEHICLE"
        | "BUS"
        | "ARTICULATED_BUS"
        | "SCHOOL_BUS"
        | "BOX_TRUCK"
        | "TRUCK"
        | "TRUCK_CAB"
        | "VEHICULAR_TRAILER"
        | "RAILED_VEHICLE"
        | "MESSAGE_BOARD_TRAILER"
        | "TRAFFIC_LIGHT_TRAILER" => ObjectKind::Vehicle,
        "PEDESTRIAN" | "OFFICIAL_SIGNALER" | "STROLLER" | "WHEELCHAIR" => ObjectKind::Pedestrian,
        "BICYCLE" | "BICYCLIST" | "MOTORCYCLE" | "MOTORCYCLIST" | "WHEELED_DEVICE"
        | "WHEELED_RIDER" => ObjectKind::Bicycle,
        "CONSTRUCTION_CONE" | "CONSTRUCTION_BARREL" => ObjectKind::TrafficCone,
        "MOBILE_PEDESTRIAN_CROSSING_SIGN" => ObjectKind::CzoneSign,
        "BOLLARD" | "SIGN" | "ANIMAL" | "DOG" => ObjectKind::GenericObject,
        "EGO_VEHICLE" | "STOP_SIGN" => return Some(Meaning::NoObject),
        _ => return None,
    };
    Some(Meaning::Object(kind))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn signs_on_poles_stand_still_and_the_ego_is_no_object() {
        let static_kinds = [
            "SIGN",
            "BOLLARD",
            "CONSTRUCTION_BARREL",
            "MOBILE_PEDESTRIAN_CROSSING_SIGN",
            "DOG",
        ];
        for word in static_kinds {
            assert!(
                matches!(of_annotation(word), Some(Meaning::Object(kind)) if !kind.is_agent()),
                "{word}"
            );
        }
        for word in ["STROLLER", "WHEELCHAIR", "BICYCLIST", "MOTORCYCLE"] {
            assert!(
                matches!(of_annotation(word), Some(Meaning::Object(kind)) if kind.is_vulnerable()),
                "{word}"
            );
        }
        assert_eq!(of_annotation("EGO_VEHICLE"), Some(Meaning::NoObject));
        assert_eq!(of_annotation("SPACESHIP"), None);
    }
}
