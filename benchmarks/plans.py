"""The robot and the trials that the benchmarks run."""

from functools import cache

from hexctl.control.trial_plan import SelfRotation, TrialPlan
from hexctl.gait.encoding import Slots
from hexctl.gait.gait import NAMED_SLOTS, Gait
from hexctl.robot.loader import load_robot
from hexctl.robot.model import Robot
from hexctl.runs.run_spec import RunSpec
from hexctl.runs.walk_plan import plan_walk

#: Gaits of a robot with one failed leg.
N_CODES = 120


@cache
def ant() -> Robot:
    """Return the robot of all benchmarks."""
    return load_robot("ant")


def default_gait(slots: Slots = NAMED_SLOTS["demo"]) -> Gait:
    """Return a gait with the robot's own pace, amplitude and height; the demo gait unless told otherwise."""
    defaults = ant().gait
    return Gait(slots=slots, pace_hz=defaults.pace_hz, amplitude=defaults.amplitude, height=defaults.height)


def recovery_plans(leg: int, codes: int, walk_s: float, self_rotation: SelfRotation) -> list[TrialPlan]:
    """Return trials of a locked leg with some of the 120 codes, evenly spread; all of them with 120."""
    chosen = [1 + index * N_CODES // codes for index in range(codes)]
    return [
        plan_walk(
            RunSpec(gait=code, failed_leg=leg, duration_s=walk_s, self_rotation=self_rotation, hold="none"),
            ant(),
        )
        for code in chosen
    ]
