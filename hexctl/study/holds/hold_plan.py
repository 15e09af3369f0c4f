"""Settings of a comparison of holds: robots, unseen worlds, legs, failures, and what the walks hold."""

from dataclasses import dataclass

from hexctl.backends.sim.world import MAX_MEMBERS, DomainRandomization, World
from hexctl.control.trial_plan import AUTO_ROTATION, SELF_ROTATIONS
from hexctl.control.walks.turning import check_plan
from hexctl.errors import InputError, LimitError, ReachError, check_type
from hexctl.robot.failure_grammar import KINDS, parse_kind
from hexctl.robot.model import Robot
from hexctl.study.holds.hold_conditions import HOLDS, INTACT, HoldCase, HoldConditions, with_sensors
from hexctl.study.study_options import WORLDS
from hexctl.study.study_plan import check_each, check_robot, check_setting
from hexctl.types import N_LEGS

#: Members of the families before this one were looked at: those of the transfer benchmark, 200 to 214 of
#: `transfer`, with which this comparison was built, and 215 to 243, on which it was measured before.
FIRST_WORLD = 250

#: The family of unseen worlds, unless told otherwise.
FAMILY = "transfer"

#: What is wrong with each leg, unless told otherwise.
FAILURES = ("locked", "limp", "missing", "weak:0.5", "stuck:coxa")


@dataclass(frozen=True, kw_only=True)
class HoldPlan:
    """Settings of one comparison.

    Attributes:
        robots: models of the robots.
        families: the unseen worlds by the name of their family.
        worlds: number of worlds of each family.
        first_world: number of the first of them.
        legs: the failed legs, ascending.
        failures: of each leg, in the words of `parse_kind`; intact robots walk beside them.
        holds: what the walks hold, of `hexctl.study.holds.hold_conditions.HOLDS`.
        self_rotation: where the failed leg points during the walk; with `auto` to the rear under the hold
            `heading`, and as it is under the others, as `hexctl run --gait auto` walks under `heading` and
            `line`. The open loop then walks the gait that holds the line.
        duration_s: length of each walk.
        exact_sensors: whether the worlds keep the sensors that their family gives them, instead of
            `hexctl.study.holds.hold_conditions.SENSORS`.
    """

    robots: tuple[Robot, ...]
    families: dict[str, DomainRandomization]
    worlds: int = 10
    first_world: int = FIRST_WORLD
    legs: tuple[int, ...] = tuple(range(1, N_LEGS + 1))
    failures: tuple[str, ...] = FAILURES
    holds: tuple[str, ...] = HOLDS
    self_rotation: str = AUTO_ROTATION
    duration_s: float = 30.0
    exact_sensors: bool = False

    def __post_init__(self) -> None:
        for name in ("robots", "legs", "failures", "holds"):
            check_type(getattr(self, name), tuple, f"plan.{name}", "a tuple")
        for robot in self.robots:
            check_robot(robot)
        check_type(self.families, dict, "plan.families", "families of worlds by name")
        for family in self.families.values():
            allowed = "a DomainRandomization, as load_randomization('transfer') gives"
            check_type(family, DomainRandomization, "plan.families", allowed)
        for failure in self.failures:
            check_type(failure, str, "plan.failures", KINDS)
        for name in ("worlds", "first_world"):
            check_type(getattr(self, name), int, f"plan.{name}")
        check_type(self.duration_s, float, "plan.duration_s")
        check_type(self.exact_sensors, bool, "plan.exact_sensors")

    def conditions(self) -> list[HoldConditions]:
        """Conditions of all walks, robot by robot and world by world."""
        return [
            HoldConditions(
                robot=robot,
                family=name,
                number=number,
                kind=family.kind(number).name,
                world=self._sensed(world),
                self_rotation=self.self_rotation,
                duration_s=self.duration_s,
            )
            for robot in self.robots
            for name, family in self.families.items()
            for number, world in enumerate(family.members(self.first_world, self.worlds), self.first_world)
        ]

    def _sensed(self, world: World) -> World:
        return world if self.exact_sensors else with_sensors(world)

    def cases(self) -> list[HoldCase]:
        """Cases under each of the conditions: intact, then leg by leg."""
        broken = [(0, INTACT), *((leg, failure) for leg in self.legs for failure in self.failures)]
        return [
            HoldCase(leg=leg, failure=failure, hold=hold) for leg, failure in broken for hold in self.holds
        ]

    def walked(self) -> list[tuple[HoldConditions, list[HoldCase]]]:
        """Conditions of all walks, and the cases under each."""
        return [(one, self.cases()) for one in self.conditions()]

    def check(self) -> None:
        """Raise InputError for anything that is not allowed, before anything runs."""
        check_each("robot", [robot.name for robot in self.robots])
        check_each("world", list(self.families))
        check_each("legs", self.legs, tuple(range(1, N_LEGS + 1)))
        check_each("failure", self.failures)
        check_each("holds", self.holds, HOLDS)
        most = min(int(WORLDS.high), MAX_MEMBERS - self.first_world)
        check_setting("worlds", self.worlds, 1 <= self.worlds <= most, f"1..{most}")
        turn = self.self_rotation
        allowed = (AUTO_ROTATION, *SELF_ROTATIONS)
        check_setting("self_rotation", turn, turn in allowed, ", ".join(allowed))
        for failure in self.failures:
            parse_kind(self.legs[0], failure)
        for one in self.conditions()[:: len(self.families) * self.worlds]:
            for case in self.cases():
                try:
                    check_plan(one.robot, one.trial(case).plan)
                except (ReachError, LimitError) as error:
                    raise InputError(f"{one.robot.name}, leg {case.leg} {case.failure}: {error}") from error
