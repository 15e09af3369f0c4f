"""hexctl walks a simulated or a real six-legged robot at 50 Hz.

These are the most common names; `docs/api` describes them and all others. They are imported when first used:
`import hexctl` loads neither NumPy nor MuJoCo nor Rerun.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from hexctl.lazy_names import lazy_names

if TYPE_CHECKING:
    from hexctl.adapt.adaptation import Adaptation, adapt
    from hexctl.adapt.objectives import Objective
    from hexctl.adapt.optimizer import Optimizer
    from hexctl.adapt.optimizers.optimizer_registry import make_optimizer
    from hexctl.adapt.sessions.session_tables import sessions
    from hexctl.adapt.space import GaitSpace
    from hexctl.backends.base import LegServos
    from hexctl.backends.sim.servos import SimServos
    from hexctl.backends.sim.world import World, load_world
    from hexctl.client.stop_client import clear_stop, estop
    from hexctl.control.batch import SimTrial, run_sim_trials
    from hexctl.control.controllers import Controller
    from hexctl.control.drive.arbiter import Velocity
    from hexctl.control.drive.drive import Drive
    from hexctl.control.guard import Guard
    from hexctl.control.log import Recorders
    from hexctl.control.policy.policy import Policy
    from hexctl.control.policy.policy_controller import PolicyController
    from hexctl.control.trial import run_trial
    from hexctl.control.trial_plan import TrialPlan
    from hexctl.control.trial_result import TrialResult
    from hexctl.errors import (
        EStopError,
        HexctlError,
        InputError,
        LimitError,
        MissingExtraError,
        ReachError,
        RobotFaultError,
    )
    from hexctl.export.export import export
    from hexctl.gait.body_pose import BodyPose
    from hexctl.gait.gait import Gait, make_gait
    from hexctl.ik.legs import feet_of_joint_angles, joint_angles_of_feet
    from hexctl.recording.recorded_trial import read_trial
    from hexctl.recording.recording import Recording
    from hexctl.robot.failure import Failure
    from hexctl.robot.formats.urdf import urdf_of
    from hexctl.robot.loader import load_robot
    from hexctl.robot.model import Robot
    from hexctl.runs.diagnosis import diagnose
    from hexctl.runs.run import run
    from hexctl.settings import read_settings
    from hexctl.types import JointTargets, RobotState

# fmt: off
__all__ = [
    # robots, worlds and gaits
    "Robot", "load_robot", "urdf_of", "Failure", "World", "load_world", "Gait", "make_gait",
    "joint_angles_of_feet", "feet_of_joint_angles",
    # servos
    "JointTargets", "RobotState", "LegServos", "Guard", "SimServos",
    # trials, controllers and recorders
    "TrialPlan", "run_trial", "TrialResult", "SimTrial", "run_sim_trials", "Controller", "Recorders",
    "Recording", "read_trial", "Policy", "PolicyController",
    # driving
    "Drive", "Velocity", "BodyPose",
    # search
    "GaitSpace", "Optimizer", "make_optimizer", "Objective",
    # one call for each command
    "run", "adapt", "Adaptation", "sessions", "diagnose", "estop", "clear_stop", "export", "read_settings",
    # errors
    "HexctlError", "InputError", "MissingExtraError", "ReachError", "LimitError", "EStopError",
    "RobotFaultError",
]
# fmt: on

_load = lazy_names(__name__, __file__, __all__)


def __getattr__(name: str) -> Any:
    """Import a public name from its module; the packages `adapt` and `export` are callable."""
    if name in ("adapt", "export"):
        return import_module(f"hexctl.{name}")
    return _load(name)


def __dir__() -> list[str]:
    return __all__
