"""Recovery: the response of a walk to failed legs."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import combinations
from typing import Literal

import numpy as np

from hexctl.control.monitor.repertoire import SAFEST, Repertoire, find_repertoire, walks_on
from hexctl.control.planning.crawl import REACH_POINTS, gait_without
from hexctl.control.planning.static_stability import DIRECTION_STEP_RAD, STAND_UP
from hexctl.control.planning.top_speed import fast_gaits
from hexctl.control.trial_plan import TrialPlan
from hexctl.gait.foot_trajectory import RAMP_DURATION_S, gait_feet_body
from hexctl.gait.gait import PACE_HZ, Gait, Motion, is_crawl
from hexctl.ik.legs import legs_that_reach
from hexctl.robot.failure import Failure
from hexctl.robot.model import Robot
from hexctl.robot.plugins import made_of
from hexctl.types import N_LEGS

#: Share of the stance height by which the body sinks. With both front legs limp, `ant` then keeps 0.79 of its
#: speed instead of 0.22, and four legs with weak servos carry it without falls.
SINK = 0.29

#: Failures over two of which the body sinks: the legs drag or are gone. A locked leg would hold it up.
DRAGGED = ("limp", "missing")

#: Maximum number of lost legs: on three, of which one swings, hardly any robot makes progress.
MOST_RECOVERED = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Response:
    """The response of a walk from now on.

    Attributes:
        gait: gait to glide to, posture included; None keeps the current one.
        tries: gaits to try in turn on a held line if that one is slow (`PostureTrial`).
        stays: whether the gait is the one used with all legs intact.
        why: reason for people, or empty.
    """

    gait: Gait | None = None
    tries: tuple[Gait, ...] = ()
    stop: bool = False
    stays: bool = False
    why: str = ""

    def __str__(self) -> str:
        return f"{self.did}: {self.why}" if self.why else self.did

    @property
    def lines(self) -> tuple[str, ...]:
        """Response and reason, in short lines for a recording."""
        return (f"recovery: {self.did}", *([f"why: {self.why}"] if self.why else []))

    @property
    def did(self) -> str:
        """The response in few words."""
        if self.stop:
            return "stopped"
        if self.gait is None or self.stays:
            return "walked on"
        slots = f"slots {','.join(map(str, self.gait.slots))}"
        crawls = is_crawl(self.gait.phases, self.gait.swing_share)
        return f"changed to {'a crawl, ' if crawls else ''}{slots}"


class Recovery(ABC):
    """Decides how walks respond to failed legs; custom subclasses have a constructor without arguments."""

    def prepare(self, robot: Robot, plan: TrialPlan, heading_body_rad: float) -> None:  # noqa: B027
        """Compute before the walk what takes too long in a tick; the heading is in the body frame."""

    @abstractmethod
    def respond(
        self, robot: Robot, plan: TrialPlan, heading_body_rad: float, failures: Sequence[Failure]
    ) -> Response:
        """The response to all failures assumed now; called within a tick."""


class WalkOn(Recovery):
    """Changes nothing: the walk reports its suspicions, and continues."""

    def respond(
        self, robot: Robot, plan: TrialPlan, heading_body_rad: float, failures: Sequence[Failure]
    ) -> Response:
        """No change."""
        return Response()


class StopWalking(Recovery):
    """Comes softly to a stand: the default on real robots."""

    def respond(
        self, robot: Robot, plan: TrialPlan, heading_body_rad: float, failures: Sequence[Failure]
    ) -> Response:
        """A stop."""
        return Response(stop=True)


class GlideToStableGait(Recovery):
    """Glides to the best gait for the intact legs: by the repertoire, else the most stable one.

    That is `gait_without`, or a faster gait in the repertoire. A walk faster than the robot's own continues
    as fast as the servos of the other legs hold. With three lost legs it stops. The course stays.

    Args:
        repertoire: `auto` finds the robot's, in `runs/repertoires` or shipped; None uses no repertoire.
    """

    def __init__(self, repertoire: Repertoire | Literal["auto"] | None = "auto") -> None:
        self._find = repertoire == "auto"
        self._repertoires = [repertoire] if isinstance(repertoire, Repertoire) else []

    def prepare(self, robot: Robot, plan: TrialPlan, heading_body_rad: float) -> None:
        """Find the repertoire, and the gaits without each one or two further legs."""
        whole = [leg for leg in range(1, N_LEGS + 1) if leg not in plan.failed_legs]
        left = range(1, MOST_RECOVERED - len(plan.failed_legs) + 1)
        for lost in [legs for count in left for legs in combinations(whole, count)]:
            self._gait_without(robot, plan, heading_body_rad, lost)
        if self._find and self._covering(robot, plan) is None:
            found = find_repertoire(robot, plan)
            self._repertoires += [] if found is None else [found]
        if (repertoire := self._covering(robot, plan)) is not None:
            repertoire.choice((), heading_body_rad)  # computes all choices

    def respond(
        self, robot: Robot, plan: TrialPlan, heading_body_rad: float, failures: Sequence[Failure]
    ) -> Response:
        """The gait for the intact legs; that of the plan if only legs failed that the plan knows."""
        legs = tuple(sorted({failure.leg for failure in failures}))
        noticed = set(legs) - set(plan.failed_legs)
        if not noticed:
            return Response(gait=plan.gait)
        if len(legs) > MOST_RECOVERED:
            return Response(stop=True)
        faster = self._faster(robot, plan, heading_body_rad, failures)
        if faster is not None and faster.stays:
            return faster
        response = faster or Response(gait=self._gait_without(robot, plan, heading_body_rad, legs))
        return _sunk_over(robot, plan, heading_body_rad, failures, response)

    def _covering(self, robot: Robot, plan: TrialPlan) -> Repertoire | None:
        return next((one for one in self._repertoires if one.covers(robot, plan)), None)

    def _faster(
        self, robot: Robot, plan: TrialPlan, heading_body_rad: float, failures: Sequence[Failure]
    ) -> Response | None:
        repertoire = self._covering(robot, plan)
        choice = None if repertoire is None else repertoire.choice(failures, heading_body_rad)
        if choice is None or choice.candidate.name == SAFEST:
            return None
        faster = f"{choice.gain:.0%} of the speed faster than the safest gait"
        if not walks_on(choice.candidate, plan.gait):
            gait = _at_speed(plan, choice.candidate.gait(plan.gait))
            return Response(gait=gait, why=f"{faster} in {choice.walks} walks")
        legs = " and ".join(str(leg) for leg in sorted({one.leg for one in failures}))
        why = f"{faster} without leg {legs} in {choice.walks} walks"
        return Response(gait=plan.gait, stays=True, why=why)

    @staticmethod
    def _gait_without(robot: Robot, plan: TrialPlan, heading_body_rad: float, legs: Sequence[int]) -> Gait:
        posture = plan.gait.posture
        raised = replace(posture, body_raise=posture.body_raise or STAND_UP)
        lost = tuple(sorted({*plan.failed_legs, *legs}))
        gait = gait_without(
            robot, replace(plan.gait, posture=raised), heading_rad=heading_body_rad, legs=lost
        )
        return _as_fast(robot, plan, heading_body_rad, gait) or _at_speed(plan, gait)


def _as_fast(robot: Robot, plan: TrialPlan, heading_body_rad: float, gait: Gait) -> Gait | None:
    """In a walk faster than the robot's own, the fastest variant of a gait that its servos hold, else None.

    It is no faster than the plan. If they hold none, the robot walks it at its own pace.
    """
    own, asked = robot.gait, plan.gait
    if asked.pace_hz * asked.amplitude <= own.pace_hz * own.amplitude:
        return None
    base = replace(gait, amplitude=own.amplitude)
    fast = fast_gaits(robot, base, heading_rad=heading_body_rad, reorder=True)
    fast = fast or (replace(base, pace_hz=own.pace_hz),)
    speed_hz = asked.strokes_per_cycle * asked.amplitude * asked.pace_hz
    pace_hz = speed_hz / (fast[0].strokes_per_cycle * fast[0].amplitude)
    return replace(fast[0], pace_hz=min(fast[0].pace_hz, pace_hz))


def _at_speed(plan: TrialPlan, gait: Gait) -> Gait:
    """A gait whose pace keeps the plan's speed: feet move more slowly in the longer stance of a crawl."""
    if gait.phases is None:
        return gait
    pace_hz = gait.pace_hz * plan.gait.strokes_per_cycle / gait.strokes_per_cycle
    return replace(gait, pace_hz=min(pace_hz, PACE_HZ.high))


def _sunk_over(
    robot: Robot, plan: TrialPlan, heading_body_rad: float, failures: Sequence[Failure], response: Response
) -> Response:
    """The response with the body sunk over two legs that drag, and its own height to try; a plan's stays."""
    drag = len(failures) > 1 and all(one.kind in DRAGGED and one.joint is None for one in failures)
    if response.gait is None or plan.gait.posture.body_raise or not drag:
        return response
    low = _sunk(robot, response.gait, round(heading_body_rad / DIRECTION_STEP_RAD))
    return response if low is None else replace(response, gait=low, tries=(response.gait,))


@lru_cache(maxsize=1024)
def _sunk(robot: Robot, gait: Gait, direction: int) -> Gait | None:
    """A gait with the body lower by `SINK`; None if a foot is then out of reach."""
    height_m = SINK * float(-robot.stance_feet_body[:, 2].max())
    low = replace(gait, posture=replace(gait.posture, body_raise=round(-height_m / robot.size_m, 6)))
    time_s = RAMP_DURATION_S + np.arange(REACH_POINTS) / (REACH_POINTS * gait.pace_hz)
    feet = gait_feet_body(robot, low, Motion(heading_rad=direction * DIRECTION_STEP_RAD), time_s)
    return low if legs_that_reach(robot, feet).all() else None


def default_recovery(*, simulated: bool, failures_come: bool = True) -> str:
    """Name of the default recovery: `stop` on real robots, else `glide`, without failures `walk-on`."""
    return "stop" if not simulated else "glide" if failures_come else "walk-on"


#: Recoveries by name.
RECOVERIES: dict[str, type[Recovery]] = {
    "walk-on": WalkOn,
    "stop": StopWalking,
    "glide": GlideToStableGait,
}


def make_recovery(name: str) -> Recovery:
    """Recovery of a name in `RECOVERIES`, of a plug-in, or `package.module:Class`; or InputError."""
    return made_of(name, RECOVERIES, Recovery, "recovery", "recoveries")  # type: ignore[type-abstract]
