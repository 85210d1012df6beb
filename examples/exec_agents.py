"""Other agents in another language: vehicles drive their recorded paths, but wait while the ego is in front of them.

planagent simulate --planner pdm-closed --agents "exec:python3 examples/exec_agents.py"
"""
import json, math, sys
from collections import deque

TIME_GAP_S, SHORTEST_M, HALF_LANE_M = 1.0, 6.0, 1.5

def held_up(agent, ego):
    """Whether the ego is in front of a vehicle, nearer than the vehicle may come."""
    east, north = ego["x"] - agent["x"], ego["y"] - agent["y"]
    cos, sin = math.cos(agent["heading"]), math.sin(agent["heading"])
    distance, side = east * cos + north * sin, north * cos - east * sin
    room = SHORTEST_M + agent["length"] / 2 + TIME_GAP_S * math.hypot(*agent["velocity"])
    return agent["kind"] == "vehicle" and 0.0 < distance < room and abs(side) < HALF_LANE_M

for message in map(json.loads, sys.stdin):
    if message["type"] == "initialize":
        to_drive = {}  # The recorded states that a track has not driven yet.
        print(json.dumps({"type": "ready"}), flush=True)
        continue
    present = {agent["track"]: agent for agent in message["objects"]}
    for state in message["logged"]:
        to_drive.setdefault(state["track"], deque()).append(state)
    states = []
    for track, left in to_drive.items():
        if track not in present:
            left.clear()  # A new object begins where it is recorded.
        elif held_up(present[track], message["ego"]):
            states.append({**present[track], "velocity": [0.0, 0.0]})
        elif left:
            states.append(left.popleft())
    keys = ("track", "x", "y", "heading", "velocity")
    answer = [{key: state[key] for key in keys} for state in states]
    print(json.dumps({"type": "agents", "objects": answer}), flush=True)
