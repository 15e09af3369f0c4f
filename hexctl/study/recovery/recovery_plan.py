"""Settings of the recovery benchmark: robots, gaits, unseen worlds, what fails, and the methods compared."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations
from zlib import crc32

import numpy as np

from hexctl.backends.sim.world import MAX_MEMBERS, DomainRandomization, World, load_world
from hexctl.control.trial_plan import DURATION_S
from hexctl.control.walks.turning import check_plan
from hexctl.errors import InputError, LimitError, ReachError, argument, check_type
from hexctl.gait.gait import NAMED_SLOTS
from hexctl.robot.failure_grammar import KINDS, parse_coming_kind
from hexctl.robot.model import Robot
from hexctl.study.holds.hold_conditions import with_sensors
from hexctl.study.recovery.episodes import AUTO_GAIT, INTACT, RecoveryCase, RecoveryConditions
from hexctl.study.recovery.methods import DEFAULT_METHODS, NOTHING, method_of
from hexctl.study.study_options import RUNS, WORLDS
from hexctl.study.study_plan import check_each, check_robot, check_setting
from hexctl.types import JOINT_KINDS, N_LEGS

#: Members of the families before this one were looked at while monitor, recovery and diagnosis were built and
#: measured.
FIRST_WORLD = 470

#: Families of unseen worlds, unless told otherwise.
FAMILIES = ("transfer", "real")

#: How legs and single joints fail, unless told otherwise.
FAILURES = (
    "locked",
    "limp",
    "missing",
    *(f"{kind}:{joint}" for kind in ("stuck", "limp") for joint in JOINT_KINDS),
)

#: Directions of travel, of which each episode has one.
HEADINGS_DEG = (0.0, 60.0, 145.0, -95.0)

#: Protocols: `line`, a line walk in unseen worlds; `hexaheal`, that of another work: one leg or two lose
#: their torque after 4 s of 14 s, on an even floor; `second`: one leg after 8 s of 36 s, another 10 s later.
LINE, HEXAHEAL, SECOND = PROTOCOLS = ("line", "hexaheal", "second")

#: Protocols that are walked unless told otherwise.
DEFAULT_PROTOCOLS = (LINE, HEXAHEAL)

#: Protocols in which sets of legs lose their torque, judged by HexaHeal's rule.
RULED = (HEXAHEAL, SECOND)

#: When legs fail in each protocol at the earliest; the phase of the gait is drawn.
FAULT_S = {LINE: 8.0, HEXAHEAL: 4.0, SECOND: 8.0}

#: How long after the first leg the second one fails.
APART_S = 10.0

#: Length of the walks in which legs lose their torque, and how that is called.
RULED_S, TORQUE_OFF = {HEXAHEAL: 14.0, SECOND: 36.0}, "limp"

#: A walk is to go on for so long after the failure.
LEAST_AFTER_S = 2.0


@dataclass(frozen=True, kw_only=True)
class RecoveryPlan:
    """Settings of one benchmark.

    Attributes:
        robots: models of the robots.
        families: the unseen worlds by the name of their family.
        gaits: names of gaits on six legs, or `auto`.
        worlds: number of worlds of each family.
        first_world: number of the first of them.
        legs: those that fail, ascending.
        failures: of each leg, in the words of `parse_kind`; intact robots walk beside them.
        methods: what robots do about them, as `method_of` has it; `nothing` among them.
        protocols: of `PROTOCOLS`.
        runs: of each set of legs in the protocols `hexaheal` and `second`, with different seeds.
        duration_s: length of each walk of the protocol `line`.
        exact_sensors: whether worlds keep the sensors that their family gives them, instead of
            `hexctl.study.holds.hold_conditions.SENSORS`.
        seed: draws phase and heading of each episode.
    """

    robots: tuple[Robot, ...]
    families: dict[str, DomainRandomization]
    gaits: tuple[str, ...] = ("tripod",)
    worlds: int = 10
    first_world: int = FIRST_WORLD
    legs: tuple[int, ...] = tuple(range(1, N_LEGS + 1))
    failures: tuple[str, ...] = FAILURES
    methods: tuple[str, ...] = DEFAULT_METHODS
    protocols: tuple[str, ...] = DEFAULT_PROTOCOLS
    runs: int = 10
    duration_s: float = 30.0
    exact_sensors: bool = False
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("robots", "gaits", "legs", "failures", "methods", "protocols"):
            check_type(getattr(self, name), tuple, f"plan.{name}", "a tuple")
        for robot in self.robots:
            check_robot(robot)
        check_type(self.families, dict, "plan.families", "families of worlds by name")
        for family in self.families.values():
            allowed = "a DomainRandomization, as load_randomization('transfer') gives"
            check_type(family, DomainRandomization, "plan.families", allowed)
        for failure in self.failures:
            check_type(failure, str, "plan.failures", KINDS)
        for name in ("worlds", "first_world", "runs", "seed"):
            check_type(getattr(self, name), int, f"plan.{name}")
        check_type(self.duration_s, float, "plan.duration_s")
        check_type(self.exact_sensors, bool, "plan.exact_sensors")

    def walked(self) -> list[tuple[RecoveryConditions, list[RecoveryCase]]]:
        """Conditions of all walks, and the cases under each."""
        found: list[tuple[RecoveryConditions, list[RecoveryCase]]] = []
        if LINE in self.protocols:
            found += [(one, list(self._line_cases(one))) for one in self._line_conditions()]
        for protocol in RULED:
            if protocol in self.protocols:
                found += [(one, list(self._set_cases(one))) for one in self._set_conditions(protocol)]
        return found

    def _line_conditions(self) -> Iterator[RecoveryConditions]:
        for robot in self.robots:
            for name, family in self.families.items():
                for number, world in enumerate(
                    family.members(self.first_world, self.worlds), self.first_world
                ):
                    yield RecoveryConditions(
                        protocol=LINE,
                        robot=robot,
                        family=name,
                        number=number,
                        kind=family.kind(number).name,
                        world=self._sensed(world),
                        duration_s=self.duration_s,
                    )

    def _set_conditions(self, protocol: str) -> Iterator[RecoveryConditions]:
        for robot in self.robots:
            for run in range(self.runs):
                yield RecoveryConditions(
                    protocol=protocol,
                    robot=robot,
                    family="flat",
                    number=run,
                    kind="flat",
                    world=self._sensed(load_world("flat")),
                    duration_s=RULED_S[protocol],
                )

    def _sensed(self, world: World) -> World:
        return world if self.exact_sensors else with_sensors(world)

    def _line_cases(self, conditions: RecoveryConditions) -> Iterator[RecoveryCase]:
        """Intact walks in each heading, then each leg with each failure, by each method."""
        for gait in self.gaits:
            for heading_deg in HEADINGS_DEG:
                yield RecoveryCase(
                    gait=gait,
                    legs=(),
                    failure=INTACT,
                    at_s=FAULT_S[LINE],
                    heading_deg=heading_deg,
                    method=NOTHING,
                )
            for leg in self.legs:
                for failure in self.failures:
                    at_s, heading_deg = self._drawn(conditions, (leg,), failure)
                    yield from self._by_methods(gait, (leg,), failure, at_s, heading_deg)

    def _set_cases(self, conditions: RecoveryConditions) -> Iterator[RecoveryCase]:
        """Sets of legs without torque, by each method, straight ahead.

        Each leg and each pair at once, or each pair in a row, in every other run the higher leg first.
        """
        in_a_row = conditions.protocol == SECOND
        sets = [legs for count in ((2,) if in_a_row else (1, 2)) for legs in combinations(self.legs, count)]
        for gait in self.gaits:
            for legs in sets:
                at_s, _ = self._drawn(conditions, legs, TORQUE_OFF)
                order = legs[::-1] if in_a_row and conditions.number % 2 else legs
                apart_s = APART_S if in_a_row else 0.0
                yield from self._by_methods(gait, order, TORQUE_OFF, at_s, 0.0, apart_s)

    def _by_methods(
        self,
        gait: str,
        legs: tuple[int, ...],
        failure: str,
        at_s: float,
        heading_deg: float,
        apart_s: float = 0.0,
    ) -> Iterator[RecoveryCase]:
        for method in self.methods:
            yield RecoveryCase(
                gait=gait,
                legs=legs,
                failure=failure,
                at_s=at_s,
                heading_deg=heading_deg,
                method=method,
                apart_s=apart_s,
            )

    def _drawn(
        self, conditions: RecoveryConditions, legs: tuple[int, ...], failure: str
    ) -> tuple[float, float]:
        """Time of a failure, within a cycle from the earliest one on, and heading."""
        text = f"{conditions.protocol} {conditions.family} {legs} {failure}"
        random = np.random.default_rng([self.seed, conditions.number, crc32(text.encode())])
        at_s = FAULT_S[conditions.protocol] + random.uniform() / conditions.robot.gait.pace_hz
        return round(at_s, 2), float(random.choice(HEADINGS_DEG))

    def check(self) -> None:
        """Raise InputError for anything that is not allowed, before anything runs."""
        check_each("robot", [robot.name for robot in self.robots])
        check_each("world", list(self.families))
        for name, family in self.families.items():
            failing = "a family without `failures`: the benchmark lets legs fail by itself"
            check_setting("world", name, not family.failures, failing)
        check_each("gaits", self.gaits, (*NAMED_SLOTS, AUTO_GAIT))
        check_each("legs", self.legs, tuple(range(1, N_LEGS + 1)))
        check_each("failure", self.failures)
        check_each("methods", self.methods)
        check_each("protocols", self.protocols, PROTOCOLS)
        for method in self.methods:
            method_of(method)
        check_setting("methods", ",".join(self.methods), NOTHING in self.methods, f"{NOTHING} among them")
        most = min(int(WORLDS.high), MAX_MEMBERS - self.first_world)
        check_setting("worlds", self.worlds, 1 <= self.worlds <= most, f"1..{most}")
        RUNS.check(argument("runs"), self.runs)
        check_setting("seed", self.seed, self.seed >= 0, "0 or more")
        for failure in self.failures:
            parse_coming_kind(self.legs[0], failure)
        longest_s = max(1 / robot.gait.pace_hz for robot in self.robots)
        least_s = FAULT_S[LINE] + longest_s + LEAST_AFTER_S
        fine = LINE not in self.protocols or least_s <= self.duration_s <= DURATION_S.high
        check_setting("duration", f"{self.duration_s:g}", fine, f"{least_s:.3g} to {DURATION_S.high:g} s")
        self._check_walks()

    def _check_walks(self) -> None:
        """Raise InputError for a gait that the legs of a robot cannot walk."""
        checked = set()
        for one, cases in self.walked():
            for case in cases:
                key = (one.robot.name, case.gait, case.heading_deg)
                if key in checked:
                    continue
                checked.add(key)
                try:
                    check_plan(one.robot, one.trial(case).plan)
                except (ReachError, LimitError) as error:
                    raise InputError(f"{one.robot.name}, {case.gait}: {error}") from error
