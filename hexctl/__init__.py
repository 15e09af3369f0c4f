"""hexctl walks a simulated or a real six-legged robot at 50 Hz.

This is the whole public interface; everything else may change. Names are imported when first used, so that
`import hexctl` costs nothing and needs neither MuJoCo nor Rerun.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hexctl.adapt.adaptation import Adaptation, AdaptationResult, adapt
    from hexctl.adapt.objectives import Objective
    from hexctl.adapt.optimizer import Optimizer
    from hexctl.adapt.session import Session
    from hexctl.adapt.space import GaitSpace
    from hexctl.backends.base import LegServos
    from hexctl.backends.clock import Clock, Tick, WallClock
    from hexctl.backends.mock import MockServos
    from hexctl.backends.sim.servos import SimServos
    from hexctl.backends.sim.world import World, load_world
    from hexctl.control.batch import SimTrial, run_sim_trials
    from hexctl.control.feasibility import check_robot
    from hexctl.control.guard import Guard
    from hexctl.control.log import TickLog
    from hexctl.control.plan import TrialPlan
    from hexctl.control.result import Deviation, TrialResult
    from hexctl.control.trial import run_trial
    from hexctl.errors import HexctlError
    from hexctl.gait.encoding import code_from_slots, slots_from_code
    from hexctl.gait.gait import Gait, Motion, make_gait
    from hexctl.record.recording import Recording
    from hexctl.record.run import RunResult, RunSpec, run
    from hexctl.robot.failure import Failure
    from hexctl.robot.loader import load_robot
    from hexctl.robot.model import Robot
    from hexctl.types import JointTargets, RobotState

_HOMES = {
    "Adaptation": "hexctl.adapt.adaptation",
    "AdaptationResult": "hexctl.adapt.adaptation",
    "GaitSpace": "hexctl.adapt.space",
    "Objective": "hexctl.adapt.objectives",
    "Optimizer": "hexctl.adapt.optimizer",
    "Session": "hexctl.adapt.session",
    "Clock": "hexctl.backends.clock",
    "Deviation": "hexctl.control.result",
    "Failure": "hexctl.robot.failure",
    "Gait": "hexctl.gait.gait",
    "Guard": "hexctl.control.guard",
    "HexctlError": "hexctl.errors",
    "JointTargets": "hexctl.types",
    "LegServos": "hexctl.backends.base",
    "MockServos": "hexctl.backends.mock",
    "Motion": "hexctl.gait.gait",
    "Recording": "hexctl.record.recording",
    "Robot": "hexctl.robot.model",
    "RobotState": "hexctl.types",
    "RunResult": "hexctl.record.run",
    "RunSpec": "hexctl.record.run",
    "SimServos": "hexctl.backends.sim.servos",
    "SimTrial": "hexctl.control.batch",
    "Tick": "hexctl.backends.clock",
    "TickLog": "hexctl.control.log",
    "TrialPlan": "hexctl.control.plan",
    "TrialResult": "hexctl.control.result",
    "WallClock": "hexctl.backends.clock",
    "World": "hexctl.backends.sim.world",
    "check_robot": "hexctl.control.feasibility",
    "code_from_slots": "hexctl.gait.encoding",
    "load_robot": "hexctl.robot.loader",
    "load_world": "hexctl.backends.sim.world",
    "make_gait": "hexctl.gait.gait",
    "run": "hexctl.record.run",
    "run_sim_trials": "hexctl.control.batch",
    "run_trial": "hexctl.control.trial",
    "slots_from_code": "hexctl.gait.encoding",
}

__all__ = [
    "Adaptation",
    "AdaptationResult",
    "Clock",
    "Deviation",
    "Failure",
    "Gait",
    "GaitSpace",
    "Guard",
    "HexctlError",
    "JointTargets",
    "LegServos",
    "MockServos",
    "Motion",
    "Objective",
    "Optimizer",
    "Recording",
    "Robot",
    "RobotState",
    "RunResult",
    "RunSpec",
    "Session",
    "SimServos",
    "SimTrial",
    "Tick",
    "TickLog",
    "TrialPlan",
    "TrialResult",
    "WallClock",
    "World",
    "adapt",
    "check_robot",
    "code_from_slots",
    "load_robot",
    "load_world",
    "make_gait",
    "run",
    "run_sim_trials",
    "run_trial",
    "slots_from_code",
]


def __getattr__(name: str) -> Any:
    """Import a public name from where it lives."""
    if name == "adapt":  # a package that can be called
        return importlib.import_module("hexctl.adapt")
    if name not in _HOMES:
        raise AttributeError(f"module 'hexctl' has no attribute {name!r}; it has {', '.join(__all__)}")
    return getattr(importlib.import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return __all__
