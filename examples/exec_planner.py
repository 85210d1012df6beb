"""A planner in another language: follows the lanes of the route and stops behind what stands on them.

planagent simulate --planner "exec:python3 examples/exec_planner.py"
"""
import json, math, sys

def dense(line):
    for (ax, ay), (bx, by) in zip(line, line[1:]):
        count = max(1, round(math.dist((ax, ay), (bx, by))))
        yield from ((ax + (bx - ax) * i / count, ay + (by - ay) * i / count) for i in range(count))

def path_ahead(x, y, heading):
    lane = min(route, key=lambda id: min(math.dist((x, y), point) for point in points[id]))
    nearest = min(range(len(points[lane])), key=lambda i: math.dist((x, y), points[lane][i]))
    path = [(x, y)] + points[lane][nearest + 3:]
    while lane is not None and len(path) < 100:
        lane = next((id for id in lanes[lane]["outgoing"] if id in route), None)
        path += points.get(lane, [])
    return path + [(path[-1][0] + 5 * math.cos(heading), path[-1][1] + 5 * math.sin(heading))]

def plan(ego, objects):
    path = path_ahead(ego["x"], ego["y"], ego["heading"])
    near = lambda point: any(math.dist(point, (one["x"], one["y"])) < 2.5 for one in objects)
    blocked = next((i for i, point in enumerate(path) if i > 3 and near(point)), len(path) + 50)
    time, speed, heading, states = 0.0, math.hypot(*ego["velocity"]), ego["heading"], []
    for i, (x, y) in enumerate(path[:-1]):
        states.append({"t": time, "x": x, "y": y, "heading": heading, "speed": speed})
        # Points are about a meter apart: stop eight of them before the first that is blocked.
        target = min(8.0, math.sqrt(4.0 * max(0, blocked - 8 - i)))
        if time > 8.0 or (speed < 0.5 and target < 0.5):
            break
        length, (nx, ny) = math.dist((x, y), path[i + 1]), path[i + 1]
        elapsed = length / max(speed, 1.0)
        speed = min(max(target, speed - 3.0 * elapsed, 0.0), speed + 1.5 * elapsed)
        time, heading = time + elapsed, math.atan2(ny - y, nx - x)
    return states + [{**states[-1], "t": states[-1]["t"] + 8.0, "speed": 0.0}]

for message in map(json.loads, sys.stdin):
    if message["type"] == "initialize":
        lanes = {lane["id"]: lane for lane in message["map"]["lanes"]}
        points = {id: list(dense(lane["centerline"])) for id, lane in lanes.items()}
        route = message["route"]["lanes"] or list(lanes)
        print(json.dumps({"type": "ready"}), flush=True)
    else:
        states = plan(message["ego"], message["objects"])
        print(json.dumps({"type": "trajectory", "states": states}), flush=True)
