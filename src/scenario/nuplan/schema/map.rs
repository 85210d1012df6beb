//! The layers of a map package, as nuPlan's maps have them.

use super::Table;

/// A layer: its name, type of its geometries in the words of the `GeoPackage` standard, whether
/// they are read, and its other columns.
macro_rules! layer {
    ($name:literal, $geometry:literal, $columns:literal) => {
        Table::new(
            $name,
            concat!(
                "*fid INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL, ",
                $geometry,
                ", ",
                $columns
            ),
        )
    };
}

pub(in super::super) const LANES: Table = layer!(
    "lanes_polygons",
    "*geom POLYGON",
    "creator_id INTEGER, name TEXT, road_type_fid INTEGER, lane_type_fid INTEGER, *lane_fid INTEGER, *lane_group_fid INTEGER,
    *lane_index INTEGER, left_boundary_fid INTEGER, right_boundary_fid INTEGER, *speed_limit_mps REAL, width REAL,
    left_offset REAL, right_offset REAL, min_speed REAL, max_speed REAL, stops TEXT, left_has_reflectors BOOLEAN,
    right_has_reflectors BOOLEAN, from_edge_fid INTEGER, to_edge_fid INTEGER"
);
/// Lane connectors; their geometry is their baseline path.
pub(in super::super) const LANE_CONNECTORS: Table = layer!(
    "lane_connectors",
    "geom LINESTRING",
    "creator_id INTEGER, *exit_lane_fid INTEGER, *entry_lane_fid INTEGER, exit_lane_group_fid INTEGER,
    entry_lane_group_fid INTEGER, *lane_group_connector_fid INTEGER, intersection_fid INTEGER, turn_type_fid INTEGER,
    *speed_limit_mps REAL, *traffic_light_stop_line_fids TEXT, bulb_fids TEXT, overlap INTEGER, reflector_side_fid INTEGER,
    left_has_reflectors BOOLEAN, right_has_reflectors BOOLEAN"
);
/// Areas of lane connectors.
pub(in super::super) const CONNECTOR_AREAS: Table = layer!(
    "gen_lane_connectors_scaled_width_polygons",
    "*geom POLYGON",
    "*lane_connector_fid INTEGER, left_boundary_fid INTEGER, right_boundary_fid INTEGER, baseline_path_fid INTEGER,
    from_edge_fid INTEGER, to_edge_fid INTEGER"
);
/// Centerlines of lanes and lane connectors.
pub(in super::super) const BASELINE_PATHS: Table = layer!(
    "baseline_paths",
    "*geom LINESTRING",
    "*lane_fid INTEGER, *lane_connector_fid INTEGER, path_type_fid INTEGER, creator_id INTEGER, dubins_node_fids TEXT"
);
/// Left and right borders of lanes and lane connectors.
pub(in super::super) const BOUNDARIES: Table = layer!(
    "boundaries",
    "geom LINESTRING",
    "boundary_type_fid INTEGER, boundary_segment_fids TEXT, has_reflectors BOOLEAN, creator_id INTEGER"
);
/// Roadblocks.
pub(in super::super) const LANE_GROUPS: Table = layer!(
    "lane_groups_polygons",
    "*geom POLYGON",
    "creator_id INTEGER, left_boundary_fid INTEGER, right_boundary_fid INTEGER, from_edge_fid INTEGER, to_edge_fid INTEGER"
);
/// Roadblock connectors.
pub(in super::super) const LANE_GROUP_CONNECTORS: Table = layer!(
    "lane_group_connectors",
    "*geom POLYGON",
    "creator_id INTEGER, intersection_fid INTEGER, *from_lane_group_fid INTEGER, *to_lane_group_fid INTEGER,
    left_boundary_fid INTEGER, right_boundary_fid INTEGER, from_edge_fid INTEGER, to_edge_fid INTEGER"
);
pub(in super::super) const INTERSECTIONS: Table = layer!(
    "intersections",
    "*geom POLYGON",
    "intersection_type_fid INTEGER, is_mini BOOLEAN, creator_id INTEGER"
);
/// Stop lines.
pub(in super::super) const STOP_POLYGONS: Table = layer!(
    "stop_polygons",
    "*geom POLYGON",
    "*stop_polygon_type_fid INTEGER, lane_group_fid INTEGER, lane_fids TEXT, *lane_connector_fids TEXT,
    traffic_light_fids TEXT, crosswalk_fids TEXT, precedence_area_fids TEXT, creator_id INTEGER"
);
pub(in super::super) const CROSSWALKS: Table = layer!(
    "crosswalks",
    "*geom POLYGON",
    "intersection_fids TEXT, lane_fids TEXT, is_marked BOOLEAN, creator_id INTEGER"
);
pub(in super::super) const CARPARK_AREAS: Table = layer!(
    "carpark_areas",
    "*geom POLYGON",
    "heading REAL, creator_id INTEGER"
);
pub(in super::super) const ROAD_SEGMENTS: Table =
    layer!("road_segments", "*geom POLYGON", "lane_group_fids TEXT");
/// Drivable area beside the road.
pub(in super::super) const GENERIC_DRIVABLE_AREAS: Table = layer!(
    "generic_drivable_areas",
    "*geom POLYGON",
    "creator_id INTEGER"
);
/// Facts about the map.
pub(in super::super) const META: Table = Table::new(
    "meta",
    "fid INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL, *key TEXT, *value TEXT",
);

/// The list of locations in a maps folder.
pub const MAPS_INDEX: &str = "nuplan-maps-v1.0.json";

/// The row of [`META`] that names the projection.
pub(in super::super) const PROJECTION_KEY: &str = "projectedCoordSystem";

/// The layers that are read.
pub(in super::super) const READ_LAYERS: [Table; 13] = [
    LANES,
    LANE_CONNECTORS,
    CONNECTOR_AREAS,
    BASELINE_PATHS,
    LANE_GROUPS,
    LANE_GROUP_CONNECTORS,
    STOP_POLYGONS,
    INTERSECTIONS,
    CROSSWALKS,
    ROAD_SEGMENTS,
    GENERIC_DRIVABLE_AREAS,
    CARPARK_AREAS,
    META,
];

/// Layers of nuPlan's maps for which a scenario's map has nothing; they are written empty.
pub(in super::super) const EMPTY_LAYERS: [Table; 3] = [
    layer!("walkways", "geom POLYGON", "creator_id INTEGER"),
    layer!(
        "dubins_nodes",
        "geom POINT",
        "radius REAL, heading REAL, creator_id INTEGER"
    ),
    layer!("traffic_lights", "geom POINT", "creator_id INTEGER"),
];
