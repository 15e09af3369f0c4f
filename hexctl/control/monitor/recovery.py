"""Recovery: what a walk does about a leg that is believed to have failed."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Literal

from hexctl.control.assessment.crawl import gait_without
from hexctl.control.assessment.static_stability import STAND_UP
from hexctl.control.monitor.repertoire import SAFEST, Repertoire, walks_on
from hexctl.control.monitor.repertoire_store import find_repertoire
from hexctl.control.trial_plan import TrialPlan
from hexctl.gait.gait import Gait
from hexctl.robot.failure import Failure
from hexctl.robot.model import Robot
from hexctl.robot.plugins import made_of
from hexctl.types import N_LEGS

#: A recovery walks on without this many legs at most: on three, of which one swings, hardly a robot gets on.
MOST_RECOVERED = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Response:
    """What a walk does from now on.

    Attributes:
        gait: glides to this gait, posture included; None keeps the one it has.
        stop: comes softly to a stand.
        stays: whether the gait is the one it had while all legs were whole.
        why: what speaks for it, for people; empty for nothing in particular.
    """

    gait: Gait | None = None
    stop: bool = False
    stays: bool = False
    why: str = ""

    def __str__(self) -> str:
        return f"{self.did}: {self.why}" if self.why else self.did

    @property
    def lines(self) -> tuple[str, ...]:
        """What it does and what speaks for it, in short lines for a recording."""
        return (f"policy: {self.did}", *([f"why: {self.why}"] if self.why else []))

    @property
    def did(self) -> str:
        """What it does, in few words."""
        if self.stop:
            return "stopped"
        if self.gait is None or self.stays:
            return "walked on"
        slots = f"slots {','.join(map(str, self.gait.slots))}"
        return f"changed to {slots}" if self.gait.phases is None else f"changed to a crawl, {slots}"


class RecoveryPolicy(ABC):
    """Decides what a walk does about failed legs. One policy serves any number of walks.

    Policies of one's own are subclasses with a constructor without arguments, named `package.module:Class`.
    """

    def prepare(self, robot: Robot, plan: TrialPlan, heading_body_rad: float) -> None:  # noqa: B027
        """Work out before the walk what a tick has no time for.

        Args:
            robot: who walks.
            plan: of the walk.
            heading_body_rad: direction of travel in the body frame.
        """

    @abstractmethod
    def respond(
        self, robot: Robot, plan: TrialPlan, heading_body_rad: float, failures: Sequence[Failure]
    ) -> Response:
        """What to do, given all legs that are believed to have failed; called within a tick."""


class WalkOn(RecoveryPolicy):
    """Changes nothing: the walk says what it suspects, and goes on."""

    def respond(
        self, robot: Robot, plan: TrialPlan, heading_body_rad: float, failures: Sequence[Failure]
    ) -> Response:
        """Nothing."""
        return Response()


class StopWalking(RecoveryPolicy):
    """Comes softly to a stand: the default on real robots."""

    def respond(
        self, robot: Robot, plan: TrialPlan, heading_body_rad: float, failures: Sequence[Failure]
    ) -> Response:
        """A stop."""
        return Response(stop=True)


class GlideToStableGait(RecoveryPolicy):
    """Glides to the best gait for the legs that are left: by the repertoire, else the one that stands safest.

    The safest has the failed legs tucked, the body a little up; without two legs it is a crawl with the body
    shifted, unless they are opposite (`gait_without`). Where the repertoire has walked the failures in this
    direction of travel, and another gait was faster, it is that one; it may be to walk on as before. Without
    three legs it stops. The course stays what it was.

    Args:
        repertoire: what it goes by; `auto` finds the robot's, in `runs/repertoires` or shipped; None goes by
            the static margin alone.
    """

    def __init__(self, repertoire: Repertoire | Literal["auto"] | None = "auto") -> None:
        self._find = repertoire == "auto"
        self._repertoires = [repertoire] if isinstance(repertoire, Repertoire) else []

    def prepare(self, robot: Robot, plan: TrialPlan, heading_body_rad: float) -> None:
        """Find the repertoire, and the gaits for each leg that may fail first, and for each two."""
        whole = [leg for leg in range(1, N_LEGS + 1) if leg not in plan.failed_legs]
        left = range(1, MOST_RECOVERED - len(plan.failed_legs) + 1)
        for lost in [legs for count in left for legs in combinations(whole, count)]:
            self._gait_without(robot, plan, heading_body_rad, lost)
        if self._find and self._covering(robot, plan) is None:
            found = find_repertoire(robot, plan)
            self._repertoires += [] if found is None else [found]
        if (repertoire := self._covering(robot, plan)) is not None:
            repertoire.choice((), heading_body_rad)  # works all choices out

    def respond(
        self, robot: Robot, plan: TrialPlan, heading_body_rad: float, failures: Sequence[Failure]
    ) -> Response:
        """The gait for the legs that are left; that of the plan while only those failed that it knows of."""
        legs = tuple(sorted({failure.leg for failure in failures}))
        noticed = set(legs) - set(plan.failed_legs)
        if not noticed:
            return Response(gait=plan.gait)
        if len(legs) > MOST_RECOVERED:
            return Response(stop=True)
        faster = self._faster(robot, plan, heading_body_rad, failures)
        return faster or Response(gait=self._gait_without(robot, plan, heading_body_rad, legs))

    def _covering(self, robot: Robot, plan: TrialPlan) -> Repertoire | None:
        """The repertoire for the walk of a plan, of those that are at hand."""
        return next((one for one in self._repertoires if one.covers(robot, plan)), None)

    def _faster(
        self, robot: Robot, plan: TrialPlan, heading_body_rad: float, failures: Sequence[Failure]
    ) -> Response | None:
        """What was faster than the safest gait, by the repertoire; None for nothing, and without one."""
        repertoire = self._covering(robot, plan)
        choice = None if repertoire is None else repertoire.choice(failures, heading_body_rad)
        if choice is None or choice.candidate.name == SAFEST:
            return None
        faster = f"{choice.gain:.0%} of the speed faster than the safest gait"
        if not walks_on(choice.candidate, plan.gait):
            gait = choice.candidate.gait(plan.gait)
            return Response(gait=gait, why=f"{faster} in {choice.walks} walks")
        legs = " and ".join(str(leg) for leg in sorted({one.leg for one in failures}))
        why = f"{faster} without leg {legs} in {choice.walks} walks"
        return Response(gait=plan.gait, stays=True, why=why)

    @staticmethod
    def _gait_without(robot: Robot, plan: TrialPlan, heading_body_rad: float, legs: Sequence[int]) -> Gait:
        """Gait without some legs and those that the plan knows to have failed, the body a little up."""
        posture = plan.gait.posture
        raised = replace(posture, body_raise=posture.body_raise or STAND_UP)
        lost = tuple(sorted({*plan.failed_legs, *legs}))
        gait = replace(plan.gait, posture=raised)
        return gait_without(robot, gait, heading_rad=heading_body_rad, legs=lost)


def default_policy(*, simulated: bool, failures_come: bool = True) -> str:
    """Name of the policy of a walk that names none.

    A real robot stops: its operator decides. A simulation recovers. If no leg of it can fail, it walks its
    plan to the last bit.

    Args:
        simulated: whether the robot is a simulation.
        failures_come: whether legs of a simulation fail during the walk.
    """
    return "stop" if not simulated else "glide" if failures_come else "walk-on"


#: Policies by name: what a walk does about a leg that fails.
POLICIES: dict[str, type[RecoveryPolicy]] = {
    "walk-on": WalkOn,
    "stop": StopWalking,
    "glide": GlideToStableGait,
}


def make_policy(name: str) -> RecoveryPolicy:
    """Policy of a name in `POLICIES`, or of `package.module:Class`.

    Raises InputError for anything else.
    """
    return made_of(name, POLICIES, RecoveryPolicy, "policy")  # type: ignore[type-abstract]
