"""Our program's three rules where it leaves nuplan-devkit and tuplan_garage on purpose, put into the two in memory.

With them a simulation that differs should agree, which shows that nothing else differs. docs/devkit.md names the rules.
"""

import math

import numpy
from shapely.geometry import Point, Polygon
from shapely.ops import unary_union

# A line that deviates less than this from the direction of its first segment is straight, meters.
STRAIGHT = 1e-3
# Bends sharper than this are rounded on their outside, radians.
ROUNDED_BEND = 0.05
# Chords of a quarter of a circle. The chords of a bend of 1 m lie within 0.1 mm of the circle.
CHORDS = 64
# Scores of proposals that differ by less are equal.
EQUAL_SCORES = 1e-8


def apply() -> None:
    """Changes the imported modules of this process."""
    from nuplan.planning.simulation.observation.idm import idm_agent, idm_agent_manager, utils

    idm_agent.path_to_linestring = Line
    idm_agent_manager.path_to_linestring = Line
    utils.get_agent_relative_angle = relative_angle
    try:
        from tuplan_garage.planning.simulation.planner.pdm_planner import abstract_pdm_closed_planner
        from tuplan_garage.planning.simulation.planner.pdm_planner.utils import pdm_emergency_brake
    except ImportError:
        return
    abstract_pdm_closed_planner.np = FirstOfEquals()
    pdm_emergency_brake.np = FirstOfEquals()


class Line:
    """The path of a reactive agent. Its `buffer` is the strip of `Footprint::of_strip`, without GEOS's simplification."""

    def __init__(self, poses):
        self.points = [(pose.x, pose.y) for pose in poses]

    def buffer(self, half_width, cap_style=None):
        pieces, last = [], None
        for (x, y), (to_x, to_y) in straight_runs(self.points):
            heading = math.atan2(to_y - y, to_x - x)
            if last is not None and abs((heading - last + math.pi) % math.tau - math.pi) > ROUNDED_BEND:
                pieces.append(Point(x, y).buffer(half_width, CHORDS))
            last = heading
            left = (-math.sin(heading) * half_width, math.cos(heading) * half_width)
            corners = [(x, y, 1), (to_x, to_y, 1), (to_x, to_y, -1), (x, y, -1)]
            pieces.append(Polygon([(a + side * left[0], b + side * left[1]) for a, b, side in corners]))
        return unary_union(pieces)


def straight_runs(points):
    """The segments of a line; straight runs are joined."""
    runs, direction = [], (0.0, 0.0)
    for (x, y), end in zip(points, points[1:]):
        along = (end[0] - x, end[1] - y)
        length = math.hypot(*along)
        if length <= numpy.finfo(float).eps:
            continue
        if runs and direction[0] * along[0] + direction[1] * along[1] > 0:
            start = runs[-1][0]
            if abs(direction[0] * (end[1] - start[1]) - direction[1] * (end[0] - start[0])) <= STRAIGHT:
                runs[-1] = (start, end)
                continue
        direction = (along[0] / length, along[1] / length)
        runs.append(((x, y), end))
    return runs


def relative_angle(ego, agent) -> float:
    """The angle by an arc tangent: exactly ahead is 0 and not NaN."""
    x, y = agent.x - ego.x, agent.y - ego.y
    cos, sin = math.cos(ego.heading), math.sin(ego.heading)
    return abs(math.atan2(cos * y - sin * x, cos * x + sin * y))


class FirstOfEquals:
    """numpy, but for `argmax` of scores: the first of those that are equal but for rounding."""

    def __getattr__(self, name):
        return getattr(numpy, name)

    def argmax(self, scores):
        return numpy.argmax(numpy.asarray(scores) >= numpy.max(scores) - EQUAL_SCORES)
