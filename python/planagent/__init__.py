"""PlanAgent: a driving agent that plans with a vision-language model, and the closed loop to test it in.

>>> import planagent
>>> simulation = planagent.Simulation("generated/changing_lane/2")
>>> simulation.run("idm").score().value > 0.5
True
"""

from ._arrays import KINDS
from ._core import __version__
from ._models import Answer, Model
from ._observation import EgoState, Lane, Observation, Sample, Trajectory, TrajectoryScores
from ._planners import Agent, Planner, planners
from ._progress import Progress
from ._results import Results, Table
from ._rewards import Rewards, reward
from ._runs import merge, open_run, resume, shard_of_environment, simulate
from ._scenario import Scenario, find, open, scenario_types
from ._simulation import Score, Simulation
from ._threads import set_threads, threads
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
    "Rewards",
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
    "open_run",
    "planners",
    "resume",
    "reward",
    "scenario_types",
    "set_threads",
    "shard_of_environment",
    "simulate",
    "threads",
]
