"""Opens an exported folder with public readers, as nuPlan's devkit opens its own data, and compares it with EXPECTED.json.

    python check_with_geopandas.py FOLDER EXPECTED.json
    python check_with_geopandas.py FOLDER

Without EXPECTED.json only the maps are checked: every shape is valid, every baseline dense.
The map is read by geopandas and pyogrio (GDAL), with the two calls that the devkit makes; the log by Python's sqlite3, with the
devkit's queries in our words. Every difference is an assertion error; the last line says what was compared.
"""
import json
import math
import pathlib
import sqlite3
import sys

import geopandas
import numpy
import pyogrio
import shapely

LAYERS = {
    "lanes_polygons": "Polygon",
    "lane_connectors": "LineString",
    "gen_lane_connectors_scaled_width_polygons": "Polygon",
    "baseline_paths": "LineString",
    "boundaries": "LineString",
    "lane_groups_polygons": "Polygon",
    "lane_group_connectors": "Polygon",
    "intersections": "Polygon",
    "stop_polygons": "Polygon",
    "crosswalks": "Polygon",
    "walkways": "Polygon",
    "carpark_areas": "Polygon",
    "road_segments": "Polygon",
    "generic_drivable_areas": "Polygon",
    "dubins_nodes": "Point",
    "traffic_lights": "Point",
}
CLOSE = 1e-6
# Maximum distance of two vertices of a baseline, m, with the rounding of degrees.
SPACING = 0.5 + 2e-6

folder = pathlib.Path(sys.argv[1])
compared = {"shapes": 0, "features": 0, "vertices": 0, "boxes": 0, "lights": 0}


def load_layers(path):
    """The devkit's way: the projection from layer `meta`, then each layer moved to it."""
    meta = geopandas.read_file(path, layer="meta", engine="pyogrio")
    crs = meta[meta["key"] == "projectedCoordSystem"]["value"].iloc[0]
    layers = {}
    for name in LAYERS:
        layer = pyogrio.read_dataframe(path, layer=name, fid_as_index=True)
        assert layer.crs is not None and layer.crs.to_epsg() == 4326, (name, layer.crs)
        layer = layer.to_crs(crs)
        layer.index = layer.index.map(str)
        layer["fid"] = layer.index
        layers[name] = layer
    return crs, layers


def close(points, wanted, what):
    points, wanted = numpy.asarray(points), numpy.asarray(wanted)
    assert points.shape == wanted.shape, (what, points.shape, wanted.shape)
    worst = numpy.abs(points - wanted).max()
    assert worst < CLOSE, (what, worst)
    compared["vertices"] += len(points)


def ring(polygon):
    return numpy.asarray(polygon.exterior.coords)[:-1]


def same_shapes(layer, shapes, what, key="fid"):
    """Each expected shape against the row with its id."""
    rows = {str(int(value)): shape for value, shape in zip(layer[key], layer.geometry) if value == value}
    assert sorted(rows) == sorted(shapes), (what, sorted(rows)[:5], sorted(shapes)[:5])
    for fid, wanted in shapes.items():
        shape = rows[fid]
        close(ring(shape) if shape.geom_type == "Polygon" else shape.coords, wanted, f"{what} {fid}")
        compared["features"] += 1


def check_shapes(name, layers):
    """The devkit asks polygons what they contain, which fails for crossing outlines, and goes from vertex to vertex of a path."""
    for layer, rows in layers.items():
        faults = {fid: shapely.is_valid_reason(shape) for fid, shape in rows.geometry.items() if not shape.is_valid}
        assert not faults, (name, layer, faults)
        compared["shapes"] += len(rows)
    for fid, path in layers["baseline_paths"].geometry.items():
        steps = numpy.hypot(*numpy.diff(shapely.get_coordinates(path), axis=0).T)
        assert steps.max() < SPACING, (name, fid, steps.max())


def check_map(wanted):
    index = json.loads((folder / "maps" / "nuplan-maps-v1.0.json").read_text())
    version = index[wanted["location"]]["version"]
    path = folder / "maps" / wanted["location"] / version / "map.gpkg"
    listed = {name: kind for name, kind in pyogrio.list_layers(path)}
    assert set(LAYERS) | {"meta"} == set(listed), sorted(set(LAYERS) ^ set(listed))
    assert all(listed[name] == kind for name, kind in LAYERS.items()), listed
    crs, layers = load_layers(path)
    assert crs == f"epsg:{wanted['epsg']}", crs
    for name, layer in layers.items():
        assert layer.geometry.notna().all() and not layer.geometry.is_empty.any(), name
        kinds = set(layer.geom_type)
        multiple = {LAYERS[name], "Multi" + LAYERS[name]}
        assert kinds <= (multiple if name in ("lane_groups_polygons", "lane_group_connectors") else {LAYERS[name]}), (name, kinds)
        assert layer.index.is_unique, name
    check_shapes(wanted["location"], layers)
    lanes, connectors = layers["lanes_polygons"], layers["lane_connectors"]
    same_shapes(lanes, wanted["lanes"], "lane")
    same_shapes(layers["gen_lane_connectors_scaled_width_polygons"], wanted["connectors"], "connector", "lane_connector_fid")
    baselines = layers["baseline_paths"]
    same_shapes(baselines[baselines["lane_fid"].notna()], wanted["lane_paths"], "path of lane", "lane_fid")
    same_shapes(connectors, wanted["connector_paths"], "line of connector")
    of_connectors = baselines[baselines["lane_connector_fid"].notna()]
    same_shapes(of_connectors, wanted["connector_paths"], "path of connector", "lane_connector_fid")
    assert (baselines.length > 0).all() and (layers["boundaries"].length > 0).all()
    for layer, shapes in [("intersections", "intersections"), ("crosswalks", "crosswalks"), ("stop_polygons", "stop_lines"),
                          ("road_segments", "road_segments"), ("generic_drivable_areas", "generic_drivable"),
                          ("carpark_areas", "carparks")]:
        numbered = {str(place + 1): shape for place, shape in enumerate(wanted[shapes])}
        same_shapes(layers[layer], numbered, layer)
    check_relations(layers, wanted)


def check_relations(layers, wanted):
    """Foreign keys compare as integers, as in the devkit; each leads somewhere."""
    def ids(name):
        return set(layers[name].index.astype(int))

    def keys(name, column):
        return set(layers[name][column].astype(int))

    # A NULL would make the column floating point, and the devkit looks the number up as text.
    crossings = set(map(str, layers["lane_group_connectors"]["intersection_fid"])) - {"0"}
    assert crossings <= set(layers["intersections"].index), crossings
    lanes, connectors = layers["lanes_polygons"], layers["lane_connectors"]
    assert (lanes["lane_fid"].astype(int) == lanes.index.astype(int)).all()
    assert keys("lanes_polygons", "lane_group_fid") <= ids("lane_groups_polygons")
    for end in ("exit_lane_fid", "entry_lane_fid"):
        assert keys("lane_connectors", end) <= ids("lanes_polygons"), end
    assert keys("lane_connectors", "lane_group_connector_fid") <= ids("lane_group_connectors")
    for end in ("from_lane_group_fid", "to_lane_group_fid"):
        assert keys("lane_group_connectors", end) <= ids("lane_groups_polygons"), end
    assert not ids("lane_groups_polygons") & ids("lane_group_connectors"), "a route could not tell them apart"
    for layer in ("lanes_polygons", "gen_lane_connectors_scaled_width_polygons"):
        for side in ("left_boundary_fid", "right_boundary_fid"):
            assert keys(layer, side) <= ids("boundaries"), (layer, side)
    edges = {fid: [[], []] for fid in wanted["lanes"]}
    for fid, row in connectors.iterrows():
        edges[str(int(row["exit_lane_fid"]))][0].append(int(fid))
        edges[str(int(row["entry_lane_fid"]))][1].append(int(fid))
        stops = [int(stop) for stop in row["traffic_light_stop_line_fids"].replace(" ", "").split(",") if stop]
        assert (len(stops) > 0) == (int(fid) in wanted["lit"]), fid
        assert set(stops) <= ids("stop_polygons")
    for fid, (outgoing, incoming) in edges.items():
        assert sorted(outgoing) == wanted["outgoing"][fid] and sorted(incoming) == wanted["incoming"][fid], fid
    limits = {fid: limit for fid, limit in lanes["speed_limit_mps"].items()}
    for fid, limit in wanted["speed_limits"].items():
        assert limits[fid] == limit if limit is not None else math.isnan(limits[fid]), fid
    left = {(row["lane_group_fid"], row["lane_index"] + 1): int(fid) for fid, row in lanes.iterrows()}
    for fid, row in lanes.iterrows():
        assert left.get((row["lane_group_fid"], row["lane_index"])) == wanted["left"][fid], fid
    drivable = ["road_segments", "intersections", "generic_drivable_areas", "carpark_areas"]
    area = shapely.union_all([shape for name in drivable for shape in layers[name].geometry.buffer(0)])
    for x, y in wanted["on_road"]:
        assert area.covers(shapely.Point(x, y)), (x, y)
    for x, y in wanted["off_road"]:
        assert not area.covers(shapely.Point(x, y)), (x, y)


# The rows that may be scenarios: those in scenes with two before and two after them, each with the last of its tags.
SCENARIOS = """
WITH ordered AS (SELECT token, ROW_NUMBER() OVER (ORDER BY name ASC) AS row_num FROM scene),
     count AS (SELECT COUNT(*) AS n FROM scene),
     valid AS (SELECT o.token FROM ordered AS o CROSS JOIN count WHERE o.row_num >= 3 AND o.row_num < count.n - 1)
SELECT lp.token, lp.timestamp, l.map_version AS map_name, MAX(st.type) AS scenario_type
FROM lidar_pc AS lp
LEFT OUTER JOIN scenario_tag AS st ON lp.token = st.lidar_pc_token
INNER JOIN lidar AS ld ON ld.token = lp.lidar_token
INNER JOIN log AS l ON ld.log_token = l.token
INNER JOIN valid AS v ON lp.scene_token = v.token
GROUP BY lp.token, lp.timestamp, l.map_version
ORDER BY lp.timestamp ASC
"""
WINDOW = """
SELECT lp.token, lp.timestamp, ep.x, ep.y, ep.qw, ep.qx, ep.qy, ep.qz, ep.vx, ep.vy, ep.acceleration_x, ep.acceleration_y
FROM lidar_pc AS lp
INNER JOIN ego_pose AS ep ON lp.ego_pose_token = ep.token
INNER JOIN lidar AS ld ON ld.token = lp.lidar_token
WHERE lp.timestamp >= ? AND lp.timestamp <= ? AND ld.channel = 'MergedPointCloud'
ORDER BY lp.timestamp ASC
"""
BOXES = """
SELECT c.name, lb.x, lb.y, lb.yaw, lb.width, lb.length, lb.height, lb.vx, lb.vy, lb.token, lb.track_token, lp.timestamp
FROM lidar_box AS lb
INNER JOIN track AS t ON t.token = lb.track_token
INNER JOIN category AS c ON c.token = t.category_token
INNER JOIN lidar_pc AS lp ON lp.token = lb.lidar_pc_token
WHERE lp.token = ?
ORDER BY lb.rowid
"""
LIGHTS = "SELECT lane_connector_id, status FROM traffic_light_status WHERE lidar_pc_token = ? ORDER BY lane_connector_id"
ROUTE = """
SELECT s.roadblock_ids, ep.x, ep.y, ep.qw, ep.qz
FROM scene AS s
INNER JOIN lidar_pc AS lp ON lp.scene_token = s.token
LEFT OUTER JOIN ego_pose AS ep ON s.goal_ego_pose_token = ep.token
WHERE lp.token = ?
"""


def near(a, b):
    return abs(a - b) < CLOSE


def yaw(w, z):
    return math.atan2(2 * w * z, 1 - 2 * z * z)


def check_log(wanted, map_wanted):
    connection = sqlite3.connect(folder / "data" / f"{wanted['log']}.db")
    connection.row_factory = sqlite3.Row
    found = connection.execute(SCENARIOS).fetchall()
    assert [row["token"].hex() for row in found] == [wanted["token"]], found
    anchor = found[0]
    assert (anchor["scenario_type"] or "unknown") == wanted["scenario_type"] and anchor["map_name"] == map_wanted["location"]
    start = anchor["timestamp"] + wanted["offset_us"]
    rows = connection.execute(WINDOW, (start, start + wanted["duration_us"])).fetchall()[::2]
    assert [row["timestamp"] for row in rows] == [frame["time_us"] for frame in wanted["frames"]]
    for row, frame in zip(rows, wanted["frames"]):
        x, y, heading, vx, vy, ax, ay = frame["ego"]
        assert near(row["x"], x) and near(row["y"], y) and near(yaw(row["qw"], row["qz"]), heading)
        assert (row["vx"], row["vy"], row["acceleration_x"], row["acceleration_y"]) == (vx, vy, ax, ay)
        boxes = connection.execute(BOXES, (row["token"],)).fetchall()
        assert len(boxes) == len(frame["objects"])
        for box, (kind, x, y, heading, length, width, vx, vy) in zip(boxes, frame["objects"]):
            assert box["name"] == kind and near(box["x"], x) and near(box["y"], y) and box["yaw"] == heading
            assert (box["length"], box["width"], box["vx"], box["vy"]) == (length, width, vx, vy) and box["height"] > 0
            compared["boxes"] += 1
        lights = [tuple(light) for light in connection.execute(LIGHTS, (row["token"],))]
        assert lights == [tuple(light) for light in frame["lights"]]
        compared["lights"] += len(lights)
    past = connection.execute(
        "SELECT timestamp FROM lidar_pc WHERE timestamp < ? ORDER BY timestamp DESC", (rows[0]["timestamp"],)).fetchall()
    assert [row["timestamp"] for row in past[1::2]] == wanted["past_us"]
    route = connection.execute(ROUTE, (anchor["token"],)).fetchone()
    assert [int(word) for word in route["roadblock_ids"].split(" ")] == wanted["route"]
    x, y, heading = wanted["goal"]
    assert near(route["x"], x) and near(route["y"], y) and near(yaw(route["qw"], route["qz"]), heading)
    for prev, following in connection.execute("SELECT prev_token, next_token FROM lidar_pc"):
        assert len(prev) == 8 and len(following) == 8
    assert all(len(row[0]) == 8 for table in ("track", "lidar_box", "scene") for row in connection.execute(f"SELECT token FROM {table}"))
    assert connection.execute("PRAGMA integrity_check").fetchone()[0] == "ok"


if len(sys.argv) > 2:
    checked = json.loads(pathlib.Path(sys.argv[2]).read_text())
    for one in checked:
        check_map(one["map"])
        check_log(one["drive"], one["map"])
else:
    checked = sorted((folder / "maps").glob("*/*/map.gpkg"))
    for path in checked:
        check_shapes(path.parent.parent.name, load_layers(path)[1])
versions = f"geopandas {geopandas.__version__}, pyogrio {pyogrio.__version__}, GDAL {pyogrio.__gdal_version_string__}"
what = "scenarios" if len(sys.argv) > 2 else "maps"
print(f"ok: {len(checked)} {what}, {compared} compared ({versions})")
