"""A planner in another language: follows the lanes of the route and stops behind what stands on them.

planagent simulate --planner "exec:python3 examples/exec_planner.py"
"""
import json, math, sys

def points_ahead(x, y, heading):
    """Points of the route from here on, at least a meter apart."""
    lane = min(route, key=lambda id: min(math.dist((x, y), point) for point in lanes[id]["centerline"]))
    line = lanes[lane]["centerline"]
    nearest = min(range(len(line)), key=lambda i: math.dist((x, y), line[i]))
    ahead, path = line[nearest:], [(x, y)]
    while lane is not None and len(ahead) < 300:
        lane = next((id for id in lanes[lane]["outgoing"] if id in route), None)
        ahead = ahead + (lanes[lane]["centerline"] if lane is not None else [])
    for point in ahead:
        is_behind = (point[0] - x) * math.cos(heading) + (point[1] - y) * math.sin(heading) < 2.0 and len(path) == 1
        if not is_behind and math.dist(path[-1], point) >= 1.0:
            path.append(tuple(point))
    return path + [(path[-1][0] + 5 * math.cos(heading), path[-1][1] + 5 * math.sin(heading))]

def plan(ego, objects):
    path = points_ahead(ego["x"], ego["y"], ego["heading"])
    on_path = lambda point, one: math.dist(point, (one["x"], one["y"])) < 2.5
    stops = [i - 7 - one["length"] / 2 for i, point in enumerate(path) if i > 2 for one in objects if on_path(point, one)]
    stop = min(stops, default=math.inf)
    time, speed, heading, states = 0.0, math.hypot(*ego["velocity"]), ego["heading"], []
    for i, (x, y) in enumerate(path[:-1]):
        states.append({"t": time, "x": x, "y": y, "heading": heading, "speed": speed})
        target = min(8.0, math.sqrt(4.0 * max(0.0, stop - i)))
        if time > 8.0 or (speed < 0.5 and target < 0.5):
            break
        (nx, ny), length = path[i + 1], math.dist((x, y), path[i + 1])
        elapsed = length / max(speed, 1.0)
        speed = min(max(target, speed - 3.0 * elapsed, 0.0), speed + 1.5 * elapsed)
        time, heading = time + elapsed, math.atan2(ny - y, nx - x)
    return states + [{**states[-1], "t": states[-1]["t"] + 8.0, "speed": 0.0}]

for message in map(json.loads, sys.stdin):
    if message["type"] == "initialize":
        lanes = {lane["id"]: lane for lane in message["map"]["lanes"]}
        route = message["route"]["lanes"] or list(lanes)
        print(json.dumps({"type": "ready"}), flush=True)
    else:
        states = plan(message["ego"], message["objects"])
        print(json.dumps({"type": "trajectory", "states": states}), flush=True)
