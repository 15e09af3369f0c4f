"""hexctl walks a simulated or a real six-legged robot at 50 Hz.

This is the whole public interface, with the names of `hexctl.see`; everything else may change. Names are
imported when first used, so that `import hexctl` costs nothing and needs neither MuJoCo nor Rerun.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from hexctl.lazy_names import lazy_names

if TYPE_CHECKING:
    from hexctl import see, testing
    from hexctl.adapt.adaptation import Adaptation, adapt
    from hexctl.adapt.best import BestGait, best_gait
    from hexctl.adapt.objectives import Objective, as_objective, make_objective
    from hexctl.adapt.optimizer import Observation, Optimizer, Prediction
    from hexctl.adapt.optimizers.registry import make_optimizer
    from hexctl.adapt.prior.find import list_priors
    from hexctl.adapt.prior.prior import Prior, ScorePrior, load_prior, load_score_prior
    from hexctl.adapt.result import AdaptationResult
    from hexctl.adapt.search import new_spec
    from hexctl.adapt.sessions.session import BaselineRecord, Session, SessionSpec, TrialRecord, WalkRecord
    from hexctl.adapt.sessions.store import delete_session, list_sessions, load_session
    from hexctl.adapt.sessions.table import export_session, sessions
    from hexctl.adapt.space import GaitSpace
    from hexctl.backends.base import LegServos, ServosWrapper
    from hexctl.backends.clock import Clock, Tick, WallClock
    from hexctl.backends.mock import MockServos
    from hexctl.backends.registry import BackendOptions, make_servos
    from hexctl.backends.sim.servos import SimServos
    from hexctl.backends.sim.world import DomainRandomization, World, load_randomization, load_world
    from hexctl.control.assessment.feasibility import check_robot
    from hexctl.control.batch import SimTrial, run_sim_trial, run_sim_trials
    from hexctl.control.controllers import Controller, Stand, Walk
    from hexctl.control.diagnosis.findings import Diagnosis, LegFinding
    from hexctl.control.drive.arbiter import Arbiter, Velocity, VelocitySource
    from hexctl.control.drive.drive import Drive
    from hexctl.control.guard import Guard
    from hexctl.control.log import Recorder, Recorders, TickLog
    from hexctl.control.plan import TrialPlan
    from hexctl.control.preparation import WalkStart
    from hexctl.control.result import Deviation, TrialResult
    from hexctl.control.trial import planned_walk, run_trial
    from hexctl.demo.rescue import DemoResult, demo
    from hexctl.doctor.checkup import Checkup, doctor
    from hexctl.errors import (
        CommandRefusedError,
        EStopError,
        HexctlError,
        InputError,
        LimitError,
        MissingExtraError,
        ReachError,
        RecordingError,
        RobotFaultError,
        SimulationDivergedError,
        WrongTypeError,
    )
    from hexctl.export.export import export
    from hexctl.gait.encoding import code_from_slots, slots_from_code
    from hexctl.gait.gait import Gait, Motion, make_gait
    from hexctl.record.diagnosis import DiagnosisResult, diagnose
    from hexctl.record.recorded_trial import RecordedTrial, read_trial
    from hexctl.record.recording import Recording
    from hexctl.record.run import RunResult, run
    from hexctl.record.run_spec import RunSpec
    from hexctl.robot.failure import Failure, parse_failure
    from hexctl.robot.formats.mjcf import mjcf_of
    from hexctl.robot.formats.urdf import urdf_of
    from hexctl.robot.formats.urdf_import import ImportedRobot, import_urdf
    from hexctl.robot.loader import RobotFile, load_robot, load_robot_file
    from hexctl.robot.model import Robot
    from hexctl.serve.ros.options import RosOptions
    from hexctl.serve.service import RobotService, ServosSpec, serve
    from hexctl.serve.stops.estop import ReadyStop, StopResult, clear_stop, estop
    from hexctl.settings import Settings, read_settings
    from hexctl.study.plan import StudyPlan
    from hexctl.study.prior import PriorPlan, build_prior
    from hexctl.study.study import StudyResult, study
    from hexctl.types import JointTargets, RobotState

# fmt: off
__all__ = [
    # robots, worlds and gaits
    "Robot", "RobotFile", "load_robot", "load_robot_file", "Failure", "parse_failure",
    "DomainRandomization", "World", "load_randomization", "load_world", "Gait", "Motion", "make_gait",
    "code_from_slots", "slots_from_code", "check_robot", "urdf_of", "mjcf_of",
    "import_urdf", "ImportedRobot",
    # servos and clocks
    "JointTargets", "RobotState", "LegServos", "ServosWrapper", "Guard", "SimServos", "MockServos",
    "BackendOptions", "make_servos", "Clock", "Tick", "WallClock",
    # trials, controllers and recorders
    "TrialPlan", "WalkStart", "planned_walk", "run_trial", "SimTrial", "run_sim_trial",
    "run_sim_trials", "Deviation", "TrialResult", "Controller", "Stand", "Walk", "Recorder",
    "Recorders", "TickLog", "Recording",
    # driving
    "Drive", "Velocity", "VelocitySource", "Arbiter",
    # search
    "GaitSpace", "Observation", "Optimizer", "Prediction", "make_optimizer", "Objective",
    "as_objective", "make_objective",
    # adaptation, sessions and priors
    "Adaptation", "AdaptationResult", "adapt", "new_spec", "Session", "SessionSpec", "TrialRecord",
    "BaselineRecord", "WalkRecord", "delete_session", "export_session", "list_sessions", "load_session",
    "sessions",
    "BestGait", "best_gait", "Prior", "ScorePrior", "load_prior", "load_score_prior", "list_priors",
    "PriorPlan", "build_prior",
    # one call for each command
    "RunResult", "RunSpec", "run", "Diagnosis", "DiagnosisResult", "LegFinding", "diagnose",
    "StudyPlan", "StudyResult", "study", "RobotService", "RosOptions", "ServosSpec",
    "serve", "estop", "clear_stop", "ReadyStop", "StopResult", "export", "RecordedTrial", "read_trial",
    "demo", "DemoResult", "doctor", "Checkup", "Settings", "read_settings",
    # errors
    "HexctlError", "InputError", "WrongTypeError", "MissingExtraError", "ReachError", "LimitError",
    "CommandRefusedError", "EStopError", "RobotFaultError", "SimulationDivergedError", "RecordingError",
    # a camera over the floor, with names of its own
    "see",
    # conformance suites for servos and optimizers of your own; they need pytest
    "testing",
]
# fmt: on

#: Where the names live. The packages `adapt`, `study` and `serve` can be called themselves.
_MODULES = {
    # robots, worlds and gaits
    "robot.model": "Robot",
    "robot.loader": "RobotFile load_robot load_robot_file",
    "robot.failure": "Failure parse_failure",
    "robot.formats.mjcf": "mjcf_of",
    "robot.formats.urdf": "urdf_of",
    "robot.formats.urdf_import": "ImportedRobot import_urdf",
    "backends.sim.world": "DomainRandomization World load_randomization load_world",
    "gait.gait": "Gait Motion make_gait",
    "gait.encoding": "code_from_slots slots_from_code",
    "control.assessment.feasibility": "check_robot",
    # servos and clocks
    "types": "JointTargets RobotState",
    "backends.base": "LegServos ServosWrapper",
    "control.guard": "Guard",
    "backends.sim.servos": "SimServos",
    "backends.mock": "MockServos",
    "backends.registry": "BackendOptions make_servos",
    "backends.clock": "Clock Tick WallClock",
    # trials, controllers and recorders
    "control.plan": "TrialPlan",
    "control.trial": "WalkStart planned_walk run_trial",
    "control.batch": "SimTrial run_sim_trial run_sim_trials",
    "control.result": "Deviation TrialResult",
    "control.controllers": "Controller Stand Walk",
    "control.log": "Recorder Recorders TickLog",
    "record.recording": "Recording",
    # driving
    "control.drive.drive": "Drive",
    "control.drive.arbiter": "Velocity VelocitySource Arbiter",
    # search
    "adapt.space": "GaitSpace",
    "adapt.optimizer": "Observation Optimizer Prediction",
    "adapt.optimizers.registry": "make_optimizer",
    "adapt.objectives": "Objective as_objective make_objective",
    # adaptation, sessions and priors
    "adapt.adaptation": "Adaptation adapt",
    "adapt.result": "AdaptationResult",
    "adapt.search": "new_spec",
    "adapt.best": "BestGait best_gait",
    "adapt.sessions.session": "Session SessionSpec TrialRecord BaselineRecord WalkRecord",
    "adapt.sessions.table": "export_session sessions",
    "adapt.sessions.store": "delete_session list_sessions load_session",
    "adapt.prior.prior": "Prior ScorePrior load_prior load_score_prior",
    "adapt.prior.find": "list_priors",
    "study.prior": "PriorPlan build_prior",
    # one call for each command
    "record.run": "RunResult run",
    "control.diagnosis.findings": "Diagnosis LegFinding",
    "record.diagnosis": "DiagnosisResult diagnose",
    "record.run_spec": "RunSpec",
    "study.plan": "StudyPlan",
    "study.study": "StudyResult study",
    "serve.service": "RobotService ServosSpec serve",
    "serve.ros.options": "RosOptions",
    "serve.stops.estop": "ReadyStop StopResult clear_stop estop",
    "record.recorded_trial": "RecordedTrial read_trial",
    "demo.rescue": "DemoResult",
    "doctor.checkup": "Checkup",
    "settings": "Settings read_settings",
    # errors
    "errors": (
        "HexctlError InputError WrongTypeError MissingExtraError ReachError LimitError "
        "CommandRefusedError EStopError RobotFaultError SimulationDivergedError RecordingError"
    ),
}
_load = lazy_names("hexctl", _MODULES)


def __getattr__(name: str) -> Any:
    """Import a public name from where it lives."""
    if name in ("adapt", "demo", "doctor", "export", "see", "serve", "study", "testing"):
        return import_module(f"hexctl.{name}")
    return _load(name)


def __dir__() -> list[str]:
    return __all__
