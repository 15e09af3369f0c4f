"""Trials in the simulation, as short to write as a command line."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from hexctl.backends.sim.servos import SimServos
from hexctl.backends.sim.world import World
from hexctl.control.batch import SimTrial
from hexctl.control.guard import Guard
from hexctl.control.log import TickLog
from hexctl.control.trial import run_trial
from hexctl.control.trial_plan import TrialPlan
from hexctl.control.trial_result import TrialResult
from hexctl.gait.encoding import Slots
from hexctl.gait.gait import NAMED_SLOTS, Gait, make_gait
from hexctl.robot.failure import Failure, FailureEvent, each_failure
from hexctl.robot.model import Robot
from tests.robots import shipped


@dataclass(frozen=True)
class Outcome:
    """A trial that ran: its result, its log, and the guard it ran through."""

    result: TrialResult
    log: TickLog
    guard: Guard


def gait_of(robot: Robot, gait: str | Slots | Gait = "demo") -> Gait:
    """Return a gait as it is, or one by name or slots with the robot's own pace, amplitude and height."""
    if isinstance(gait, Gait):
        return gait
    slots = NAMED_SLOTS[gait] if isinstance(gait, str) else gait
    return Gait(
        slots=slots, pace_hz=robot.gait.pace_hz, amplitude=robot.gait.amplitude, height=robot.gait.height
    )


def walk(
    gait: str | Slots | Gait = "demo",
    *,
    robot: Robot | None = None,
    failure: Failure | None = None,
    world: World | None = None,
    seed: int = 0,
    **plan: Any,
) -> Outcome:
    """Run a trial in the simulation; `plan` holds more of a `TrialPlan`."""
    robot = robot or shipped()
    with SimServos(robot, world=world, failures=failure, seed=seed) as servos:
        guard, log = Guard(servos), TickLog()
        result = run_trial(
            guard,
            TrialPlan(gait=gait_of(robot, gait), failures=each_failure(failure), **plan),
            recorders=(log,),
        )
    return Outcome(result, log, guard)


def sim_trial(
    gait: str = "tripod",
    *,
    robot: Robot | None = None,
    failure: Failure | None = None,
    world: World | str | None = None,
    seed: int = 0,
    events: Sequence[FailureEvent] = (),
    **plan: Any,
) -> SimTrial:
    """A simulated trial; `plan` holds more of a `TrialPlan`, which knows of the failure."""
    robot = robot or shipped()
    made = make_gait(robot, gait, failed_legs=(failure.leg,) if failure else ())
    known = TrialPlan(gait=made, **{"failures": each_failure(failure), **plan})
    return SimTrial(robot=robot, plan=known, failures=failure, world=world, seed=seed, events=events)


class Calling:
    """A recorder that calls a function with each block."""

    def __init__(
        self, function: Callable[[TickLog, int, int], object], block_ticks: int | None = None
    ) -> None:
        self._function = function
        self.block_ticks = block_ticks

    def write_block(self, log: TickLog, start: int, stop: int) -> None:
        self._function(log, start, stop)
