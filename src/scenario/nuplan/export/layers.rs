//! The layers of a map package with their columns, as nuPlan's maps have them.

/// A feature layer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Layer {
    /// Its name.
    pub(super) name: &'static str,
    /// Type of its geometries in the words of the `GeoPackage` standard.
    pub(super) geometry: &'static str,
    /// Columns beside `fid` and `geom`, with their types.
    pub(super) columns: &'static [(&'static str, &'static str)],
}

/// Lanes.
pub(super) const LANES: Layer = Layer {
    name: "lanes_polygons",
    geometry: "POLYGON",
    columns: &[
        ("creator_id", "INTEGER"),
        ("name", "TEXT"),
        ("road_type_fid", "INTEGER"),
        ("lane_type_fid", "INTEGER"),
        ("lane_fid", "INTEGER"),
        ("lane_group_fid", "INTEGER"),
        ("lane_index", "INTEGER"),
        ("left_boundary_fid", "INTEGER"),
        ("right_boundary_fid", "INTEGER"),
        ("speed_limit_mps", "REAL"),
        ("width", "REAL"),
        ("left_offset", "REAL"),
        ("right_offset", "REAL"),
        ("min_speed", "REAL"),
        ("max_speed", "REAL"),
        ("stops", "TEXT"),
        ("left_has_reflectors", "BOOLEAN"),
        ("right_has_reflectors", "BOOLEAN"),
        ("from_edge_fid", "INTEGER"),
        ("to_edge_fid", "INTEGER"),
    ],
};

/// Lane connectors; their geometry is their baseline path.
pub(super) const LANE_CONNECTORS: Layer = Layer {
    name: "lane_connectors",
    geometry: "LINESTRING",
    columns: &[
        ("creator_id", "INTEGER"),
        ("exit_lane_fid", "INTEGER"),
        ("entry_lane_fid", "INTEGER"),
        ("exit_lane_group_fid", "INTEGER"),
        ("entry_lane_group_fid", "INTEGER"),
        ("lane_group_connector_fid", "INTEGER"),
        ("intersection_fid", "INTEGER"),
        ("turn_type_fid", "INTEGER"),
        ("speed_limit_mps", "REAL"),
        ("traffic_light_stop_line_fids", "TEXT"),
        ("bulb_fids", "TEXT"),
        ("overlap", "INTEGER"),
        ("reflector_side_fid", "INTEGER"),
        ("left_has_reflectors", "BOOLEAN"),
        ("right_has_reflectors", "BOOLEAN"),
    ],
};

/// Areas of lane connectors.
pub(super) const CONNECTOR_AREAS: Layer = Layer {
    name: "gen_lane_connectors_scaled_width_polygons",
    geometry: "POLYGON",
    columns: &[
        ("lane_connector_fid", "INTEGER"),
        ("left_boundary_fid", "INTEGER"),
        ("right_boundary_fid", "INTEGER"),
        ("baseline_path_fid", "INTEGER"),
        ("from_edge_fid", "INTEGER"),
        ("to_edge_fid", "INTEGER"),
    ],
};

/// Centrelines of lanes and lane connectors.
pub(super) const BASELINE_PATHS: Layer = Layer {
    name: "baseline_paths",
    geometry: "LINESTRING",
    columns: &[
        ("lane_fid", "INTEGER"),
        ("lane_connector_fid", "INTEGER"),
        ("path_type_fid", "INTEGER"),
        ("creator_id", "INTEGER"),
        ("dubins_node_fids", "TEXT"),
    ],
};

/// Left and right borders of lanes and lane connectors.
pub(super) const BOUNDARIES: Layer = Layer {
    name: "boundaries",
    geometry: "LINESTRING",
    columns: &[
        ("boundary_type_fid", "INTEGER"),
        ("boundary_segment_fids", "TEXT"),
        ("has_reflectors", "BOOLEAN"),
        ("creator_id", "INTEGER"),
    ],
};

/// Roadblocks.
pub(super) const LANE_GROUPS: Layer = Layer {
    name: "lane_groups_polygons",
    geometry: "POLYGON",
    columns: &[
        ("creator_id", "INTEGER"),
        ("left_boundary_fid", "INTEGER"),
        ("right_boundary_fid", "INTEGER"),
        ("from_edge_fid", "INTEGER"),
        ("to_edge_fid", "INTEGER"),
    ],
};

/// Roadblock connectors.
pub(super) const LANE_GROUP_CONNECTORS: Layer = Layer {
    name: "lane_group_connectors",
    geometry: "POLYGON",
    columns: &[
        ("creator_id", "INTEGER"),
        ("intersection_fid", "INTEGER"),
        ("from_lane_group_fid", "INTEGER"),
        ("to_lane_group_fid", "INTEGER"),
        ("left_boundary_fid", "INTEGER"),
        ("right_boundary_fid", "INTEGER"),
        ("from_edge_fid", "INTEGER"),
        ("to_edge_fid", "INTEGER"),
    ],
};

/// Intersections.
pub(super) const INTERSECTIONS: Layer = Layer {
    name: "intersections",
    geometry: "POLYGON",
    columns: &[("intersection_type_fid", "INTEGER"), ("is_mini", "BOOLEAN"), ("creator_id", "INTEGER")],
};

/// Stop lines.
pub(super) const STOP_POLYGONS: Layer = Layer {
    name: "stop_polygons",
    geometry: "POLYGON",
    columns: &[
        ("stop_polygon_type_fid", "INTEGER"),
        ("lane_group_fid", "INTEGER"),
        ("lane_fids", "TEXT"),
        ("lane_connector_fids", "TEXT"),
        ("traffic_light_fids", "TEXT"),
        ("crosswalk_fids", "TEXT"),
        ("precedence_area_fids", "TEXT"),
        ("creator_id", "INTEGER"),
    ],
};

/// Crosswalks.
pub(super) const CROSSWALKS: Layer = Layer {
    name: "crosswalks",
    geometry: "POLYGON",
    columns: &[
        ("intersection_fids", "TEXT"),
        ("lane_fids", "TEXT"),
        ("is_marked", "BOOLEAN"),
        ("creator_id", "INTEGER"),
    ],
};

/// Car parks.
pub(super) const CARPARK_AREAS: Layer =
    Layer { name: "carpark_areas", geometry: "POLYGON", columns: &[("heading", "REAL"), ("creator_id", "INTEGER")] };

/// The road itself.
pub(super) const ROAD_SEGMENTS: Layer =
    Layer { name: "road_segments", geometry: "POLYGON", columns: &[("lane_group_fids", "TEXT")] };

/// Drivable area beside the road.
pub(super) const GENERIC_DRIVABLE_AREAS: Layer =
    Layer { name: "generic_drivable_areas", geometry: "POLYGON", columns: &[("creator_id", "INTEGER")] };

/// Layers that nuPlan's maps have and a scenario's map has nothing for; they are written empty.
pub(super) const EMPTY: [Layer; 3] = [
    Layer { name: "walkways", geometry: "POLYGON", columns: &[("creator_id", "INTEGER")] },
    Layer {
        name: "dubins_nodes",
        geometry: "POINT",
        columns: &[("radius", "REAL"), ("heading", "REAL"), ("creator_id", "INTEGER")],
    },
    Layer { name: "traffic_lights", geometry: "POINT", columns: &[("creator_id", "INTEGER")] },
];
