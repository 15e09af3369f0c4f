"""Recovery: what a walk does about a leg that is believed to have failed."""

import inspect
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace

from hexctl.control.assessment.static_stability import STAND_UP, most_stable_slots
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

    def __init__(self) -> None:
        self._slots: dict[tuple[str, float, tuple[tuple[int, str], ...]], Slots] = {}

    def prepare(self, robot: Robot, plan: TrialPlan, heading_body_rad: float) -> None:
        """Find the gaits for each leg that may fail first."""
        believed = () if plan.belief is None else (plan.belief,)
        for leg in range(1, N_LEGS + 1):
            if leg not in plan.failed_legs:
                self._slots_of(robot, heading_body_rad, (*believed, Failure(leg=leg, kind="limp")))

    def respond(
        self, robot: Robot, plan: TrialPlan, heading_body_rad: float, failures: Sequence[Failure]
    ) -> Response:
        """The gait for the legs that are left; that of the plan once all are whole."""
        if not failures:
            return Response(gait=plan.gait)
        legs = tuple(failure.leg for failure in failures)
        posture = plan.gait.posture
        posture = replace(
            posture,
            tucked_legs=tuple(sorted({*posture.tucked_legs, *legs})),
            body_raise=posture.body_raise or STAND_UP,
        )
        slots = self._slots_of(robot, heading_body_rad, failures)
        return Response(gait=replace(plan.gait, slots=slots, posture=posture))

    def _slots_of(self, robot: Robot, heading_body_rad: float, failures: Sequence[Failure]) -> Slots:
        # A tucked leg carries nothing, however it failed.
        lost = tuple(Failure(leg=failure.leg, kind="limp") for failure in failures)
        key = (robot.fingerprint, heading_body_rad, tuple(sorted((one.leg, one.kind) for one in lost)))
        if key not in self._slots:
            self._slots[key] = most_stable_slots(robot, heading_rad=heading_body_rad, failure=lost)
        return self._slots[key]


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
