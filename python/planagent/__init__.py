"""PlanAgent: a driving agent that plans with a vision-language model, and the closed loop to test it in.

>>> import planagent
>>> simulation = planagent.Simulation("generated/changing_lane/2")
>>> simulation.run("idm").score().value > 0.5
True
"""

from ._arrays import KINDS
from ._core import __version__, set_threads, threads
from ._models import Answer, Model
from ._observation import EgoState, Lane, Observation, Sample, Trajectory, TrajectoryScores
from ._planners import Agent, Planner, planners
from ._runs import Progress, Results, Table, merge, resume, shard_of_environment, simulate
from ._scenario import Scenario, find, open
from ._simulation import Score, Simulation
from .errors import PlanAgentError

__all__ = [
    "KINDS",
    "Agent",
    "Answer",
    "EgoState",
    "Lane",
    "Model",
    "Observation",
    "PlanAgentError",
    "Planner",
    "Progress",
    "Results",
    "Sample",
    "Scenario",
    "Score",
    "Simulation",
    "Table",
    "Trajectory",
    "TrajectoryScores",
    "__version__",
    "find",
    "merge",
    "open",
    "planners",
    "resume",
    "set_threads",
    "shard_of_environment",
    "simulate",
    "threads",
]
