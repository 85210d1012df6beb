"""Inside nuplan-devkit: planners of the library for its simulations, and its planners for ours.

This package needs nuplan-devkit. Its hydra configurations are found with
`hydra.searchpath=[pkg://planagent.nuplan.config]`: `planner=plan_agent`, `planner=pdm_closed_rust`, `planner=idm_rust`.
"""

from .._extras import installed

installed("nuplan", "planagent.nuplan")
from ._adapter import adapted  # noqa: E402
from ._planner import PlanAgentPlanner  # noqa: E402

__all__ = ["PlanAgentPlanner", "adapted"]
