"""The numbers of an observation of the environments."""

from __future__ import annotations

from typing import NamedTuple

__all__ = ["FEATURES", "Feature"]

#: Points of the route's centerline, and objects.
POINTS, OBJECTS = 10, 8
#: Scales: what a number is multiplied by to have its unit.
METERS, SPEED, ACCELERATION, SIZE = 50.0, 20.0, 5.0, 10.0


class Feature(NamedTuple):
    """A number of an observation.

    Attributes
    ----------
    name : str
        What it is. Positions and velocities are relative to the ego's rear axle: forward (`x`) and left (`y`).
    unit : str
        The unit after scaling; empty for a share, a cosine or a truth value.
    scale : float
        What the number is multiplied by to have its unit.

    Examples
    --------
    >>> import planagent.envs
    >>> len(planagent.envs.FEATURES), planagent.envs.FEATURES[0].name
    (97, 'ego_speed')
    """

    name: str
    unit: str
    scale: float


def _all() -> tuple[Feature, ...]:
    ego = [
        Feature("ego_speed", "m/s", SPEED),
        Feature("ego_acceleration", "m/s^2", ACCELERATION),
        Feature("ego_steering_angle", "rad", 1.0),
        Feature("ego_yaw_rate", "rad/s", 1.0),
        Feature("speed_limit", "m/s", SPEED),
    ]
    path = [Feature(f"path_{point}_{axis}", "m", METERS) for point in range(POINTS) for axis in "xy"]
    of_object = [
        ("present", "", 1.0),
        ("x", "m", METERS),
        ("y", "m", METERS),
        ("cos_heading", "", 1.0),
        ("sin_heading", "", 1.0),
        ("vx", "m/s", SPEED),
        ("vy", "m/s", SPEED),
        ("length", "m", SIZE),
        ("width", "m", SIZE),
    ]
    objects = [Feature(f"object_{number}_{name}", unit, scale) for number in range(OBJECTS) for name, unit, scale in of_object]
    return (*ego, *path, *objects)


#: The numbers of an observation in their order. The points of the path are 5 m apart along the route's centerline, the first 5 m ahead; objects
#: are sorted by distance, and all numbers of one that is not there are 0.
FEATURES: tuple[Feature, ...] = _all()
