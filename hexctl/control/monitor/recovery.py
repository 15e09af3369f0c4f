"""Recovery: what a walk does about a leg that is believed to have failed."""

import inspect
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import combinations

from hexctl.control.assessment.static_stability import DIRECTION_STEP_RAD, STAND_UP, most_stable_slots
from hexctl.control.plan import TrialPlan
from hexctl.errors import InputError, argument
from hexctl.gait.encoding import Slots
from hexctl.gait.gait import Gait
from hexctl.robot.failure import Failure
from hexctl.robot.model import Robot
from hexctl.robot.plugins import load_named
from hexctl.types import N_LEGS


@dataclass(frozen=True, slots=True, kw_only=True)
class Response:
    """What a walk does from now on.

    Attributes:
        gait: glides to this gait, posture included; None keeps the one it has.
        stop: comes softly to a stand.
    """

    gait: Gait | None = None
    stop: bool = False

    def __str__(self) -> str:
        if self.stop:
            return "stopped"
        return "walked on" if self.gait is None else f"glided to slots {','.join(map(str, self.gait.slots))}"


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
    """Glides to the gait that stands safest without the failed legs, which are tucked, the body a little up.

    The course stays what it was.
    """

    def prepare(self, robot: Robot, plan: TrialPlan, heading_body_rad: float) -> None:
        """Find the gaits for each leg that may fail first, and for each two."""
        whole = [leg for leg in range(1, N_LEGS + 1) if leg not in plan.failed_legs]
        for lost in [*combinations(whole, 1), *combinations(whole, 2)]:
            slots_without(robot, heading_body_rad, tuple(sorted((*plan.failed_legs, *lost))))

    def respond(
        self, robot: Robot, plan: TrialPlan, heading_body_rad: float, failures: Sequence[Failure]
    ) -> Response:
        """The gait for the legs that are left; that of the plan while only those failed that it knows of."""
        legs = tuple(sorted({failure.leg for failure in failures}))
        noticed = set(legs) - set(plan.failed_legs)
        if not noticed:
            return Response(gait=plan.gait)
        posture = plan.gait.posture
        posture = replace(
            posture,
            tucked_legs=tuple(sorted({*posture.tucked_legs, *noticed})),
            body_raise=posture.body_raise or STAND_UP,
        )
        slots = slots_without(robot, heading_body_rad, legs)
        return Response(gait=replace(plan.gait, slots=slots, posture=posture))


def slots_without(robot: Robot, heading_body_rad: float, legs: tuple[int, ...]) -> Slots:
    """Slots of the gait that stands safest on the other legs; worked out once in a process.

    Args:
        robot: who walks.
        heading_body_rad: direction of travel in the body frame.
        legs: that carry nothing.
    """
    return _slots_without(robot, round(heading_body_rad / DIRECTION_STEP_RAD), legs)


@lru_cache(maxsize=1024)
def _slots_without(robot: Robot, direction: int, legs: tuple[int, ...]) -> Slots:
    lost = [Failure(leg=leg, kind="limp") for leg in legs]
    return most_stable_slots(robot, heading_rad=DIRECTION_STEP_RAD * direction, failure=lost)


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
    if name in POLICIES:
        return POLICIES[name]()
    what, allowed = argument("policy"), f"{', '.join(POLICIES)}, or package.module:Class"
    if ":" not in name:
        raise InputError(f"{what}: got {name!r}; allowed: {allowed}")
    try:
        own = load_named(name, "policy")
        made = own() if inspect.isclass(own) else own
    except (ImportError, AttributeError, TypeError, ValueError) as error:
        raise InputError(f"{what}: {name!r} cannot be loaded ({error}); allowed: {allowed}") from error
    if not isinstance(made, RecoveryPolicy):
        raise InputError(f"{what}: {name!r} is a {type(made).__name__}; allowed: a RecoveryPolicy")
    return made
