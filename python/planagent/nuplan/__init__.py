"""Inside nuplan-devkit: planners of the library for its simulations, and its planners for ours.

This package needs nuplan-devkit. Its hydra configurations are found with
`hydra.searchpath=[pkg://planagent.nuplan.config]`: `planner=plan_agent`, `planner=pdm_closed_rust`, `planner=idm_rust`.
"""

from ._adapter import adapted
from ._planner import PlanAgentPlanner

__all__ = ["PlanAgentPlanner", "adapted"]
