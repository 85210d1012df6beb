"""Exceptions of the package. Each is also the builtin exception that one would expect."""

from __future__ import annotations

__all__ = [
    "ArgumentError",
    "InternalError",
    "MissingPackageError",
    "ModelError",
    "ModelNotFoundError",
    "PlanAgentError",
    "PlannerError",
    "RunError",
    "RunLockedError",
    "RunNotFoundError",
    "RunStoppedError",
    "ScenarioError",
    "ScenarioNotFoundError",
    "SceneError",
    "SimulationError",
    "SimulationsFailedWarning",
]


class PlanAgentError(Exception):
    """What all exceptions of the package have in common."""


class ArgumentError(PlanAgentError, ValueError):
    """An argument or a setting that cannot be used."""


class ScenarioError(PlanAgentError, ValueError):
    """A scenario that cannot be read, or a name that stands for none or for several."""


class ScenarioNotFoundError(ScenarioError, FileNotFoundError):
    """A scenario whose file does not exist."""


class SceneError(PlanAgentError, ValueError):
    """A scene that has no lane graph or no score, for example with an ego off the road."""


class ModelError(PlanAgentError, RuntimeError):
    """A model that cannot be loaded or asked."""


class ModelNotFoundError(ModelError, FileNotFoundError):
    """A model whose files do not exist."""


class PlannerError(PlanAgentError, RuntimeError):
    """A planner that gives no trajectory."""


class SimulationError(PlanAgentError, RuntimeError):
    """A simulation that cannot go on, or is not over yet."""


class RunError(PlanAgentError, RuntimeError):
    """A run that cannot start, resume or end."""


class RunLockedError(RunError):
    """A folder in which another process runs."""


class RunNotFoundError(RunError, FileNotFoundError):
    """A folder that holds no run."""


class RunStoppedError(RunError):
    """A run that was stopped. Its attribute `results` has what was completed."""


class MissingPackageError(PlanAgentError, ModuleNotFoundError):
    """A package that a function needs and that is not installed."""


class SimulationsFailedWarning(UserWarning):
    """Some simulations of a run failed."""


class InternalError(PlanAgentError, RuntimeError):
    """A fault of the package itself, with its place in the sources."""
