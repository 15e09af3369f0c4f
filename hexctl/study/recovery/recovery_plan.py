"""The recovery benchmark: legs fail in mid-walk in held-out worlds, and reactions are compared."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import combinations
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, get_args
from zlib import crc32

import numpy as np

from hexctl.backends.robot_options import SEED
from hexctl.backends.sim.world import load_world
from hexctl.control.trial_plan import DURATION_S
from hexctl.gait.gait import NAMED_SLOTS
from hexctl.options import Typed
from hexctl.robot.failure_grammar import parse_coming_kind
from hexctl.study.experiment import plain, where
from hexctl.study.held_out import FAILURES, INTACT, with_sensors
from hexctl.study.held_out_experiment import (
    Columns,
    HeldOutExperiment,
)
from hexctl.study.plan import check_each, check_families, check_setting, check_walkable
from hexctl.study.recovery import recovery_report as report
from hexctl.study.recovery.episodes import AUTO_GAIT, RecoveryCase, RecoveryPlace
from hexctl.study.recovery.methods import DEFAULT_METHODS, NOTHING, method_of
from hexctl.study.report_page import Section, Table, markdown
from hexctl.study.study_options import RUNS

if TYPE_CHECKING:
    from pandas import DataFrame

#: Earlier worlds were used to develop monitor, recovery and diagnosis.
FIRST_WORLD = 470

#: Default families of worlds.
FAMILIES = ("transfer", "real")

#: Directions of travel, of which each episode has one.
HEADINGS_DEG = (0.0, 60.0, 145.0, -95.0)

#: `line`: a line walk in held-out worlds. On an even floor, `hexaheal`: one leg or two lose their torque
#: after 4 s of 14 s, `second`: one leg after 8 s of 36 s, and another 10 s later.
Protocol = Literal["line", "hexaheal", "second"]
LINE, HEXAHEAL, SECOND = get_args(Protocol)

#: Earliest time of the failure under each protocol; the phase of the gait is drawn.
FAULT_S = {LINE: 8.0, HEXAHEAL: 4.0, SECOND: 8.0}

#: Time between the failures of two legs under `second`.
APART_S = 10.0

#: Numbers of legs that fail in a walk under the other protocols.
COUNTS = {HEXAHEAL: (1, 2), SECOND: (2,)}

#: Length of the walks under the other protocols, and how their legs fail.
RULED_S, TORQUE_OFF = {HEXAHEAL: 14.0, SECOND: 36.0}, "limp"

#: Minimum duration of a walk after the failure.
LEAST_AFTER_S = 2.0


@dataclass(frozen=True, kw_only=True)
class RecoveryPlan(HeldOutExperiment):
    """Settings of a recovery benchmark. `duration_s` is for walks under the protocol `line`.

    Attributes:
        gaits: names of gaits on six legs, or `auto`.
        methods: as `method_of` reads them; `nothing` is one of them.
        runs: number of runs of each set of legs under `hexaheal` and `second`.
        seed: draws phase and heading of each episode.
    """

    NAME: ClassVar[str] = "recovery"
    REPORT: ClassVar[str] = "recovery.html"
    TITLE: ClassVar[str] = "hexctl study --recovery"
    HEADING: ClassVar[str] = "Legs fail in mid-walk"

    BY: ClassVar[str] = "method"
    COLUMNS: ClassVar[Columns] = report.COLUMNS
    columns = staticmethod(report.compared)
    divisions = staticmethod(report.divisions)
    summary = staticmethod(report.statistics)

    first_world: int = FIRST_WORLD
    failures: Annotated[tuple[str, ...], Typed(flag="failure")] = FAILURES
    gaits: tuple[str, ...] = ("tripod",)
    methods: tuple[str, ...] = DEFAULT_METHODS
    protocols: tuple[Protocol, ...] = (LINE, HEXAHEAL)
    runs: Annotated[int, RUNS] = 10
    seed: Annotated[int, SEED] = 0

    @property
    def ruled(self) -> list[str]:
        """Protocols judged by HexaHeal's rule."""
        return [protocol for protocol in RULED_S if protocol in self.protocols]

    def walked(self) -> list[tuple[RecoveryPlace, list[RecoveryCase]]]:
        """Return the cases to walk, place by place."""
        places = [RecoveryPlace(protocol=LINE, **one) for one in self.members() if LINE in self.protocols]
        walked = [(place, list(self._line_cases(place))) for place in places]
        for protocol in self.ruled:
            walked += [(place, list(self._set_cases(place))) for place in self._even(protocol)]
        return walked

    def _even(self, protocol: str) -> Iterator[RecoveryPlace]:
        flat = load_world("flat")
        world = flat if self.exact_sensors else with_sensors(flat)
        for robot in self.robots:
            for run in range(self.runs):
                yield RecoveryPlace(
                    protocol=protocol, robot=robot, family="flat", number=run, kind="flat",
                    world=world, duration_s=RULED_S[protocol],
                )  # fmt: skip

    def _line_cases(self, place: RecoveryPlace) -> Iterator[RecoveryCase]:
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
                    yield from self._by_methods(place, gait, (leg,), failure)

    def _set_cases(self, place: RecoveryPlace) -> Iterator[RecoveryCase]:
        """Sets of legs without torque, by each method, straight ahead.

        Each leg and each pair together, or each pair in a row; in every other run the higher leg fails first.
        """
        in_a_row = place.protocol == SECOND
        sets = [legs for count in COUNTS[place.protocol] for legs in combinations(self.legs, count)]
        for gait in self.gaits:
            for legs in sets:
                for case in self._by_methods(place, gait, legs, TORQUE_OFF):
                    order = legs[::-1] if in_a_row and place.number % 2 else legs
                    apart_s = APART_S if in_a_row else 0.0
                    yield replace(case, legs=order, heading_deg=0.0, apart_s=apart_s)

    def _by_methods(
        self, place: RecoveryPlace, gait: str, legs: tuple[int, ...], failure: str
    ) -> Iterator[RecoveryCase]:
        """Cases of one failure; its heading and its time within a cycle from the earliest are drawn."""
        text = f"{place.protocol} {place.family} {legs} {failure}"
        random = np.random.default_rng([self.seed, place.number, crc32(text.encode())])
        at_s = round(FAULT_S[place.protocol] + random.uniform() / place.robot.gait.pace_hz, 2)
        heading_deg = float(random.choice(HEADINGS_DEG))
        for method in self.methods:
            yield RecoveryCase(
                gait=gait, legs=legs, failure=failure, at_s=at_s, heading_deg=heading_deg, method=method
            )

    def check(self) -> None:
        """Raise InputError for invalid settings, before anything runs."""
        super().check()
        check_families(self.families)
        check_each("gaits", self.gaits, (*NAMED_SLOTS, AUTO_GAIT))
        for method in self.methods:
            method_of(method)
        check_setting("methods", ",".join(self.methods), NOTHING in self.methods, f"{NOTHING} among them")
        for failure in self.failures:
            parse_coming_kind(self.legs[0], failure)
        longest_s = max(1 / robot.gait.pace_hz for robot in self.robots)
        least_s = FAULT_S[LINE] + longest_s + LEAST_AFTER_S
        fine = LINE not in self.protocols or least_s <= self.duration_s
        check_setting("duration", f"{self.duration_s:g}", fine, f"{least_s:.3g} to {DURATION_S.high:g} s")
        gaits = {
            (place.robot.name, case.gait, case.heading_deg): place.trial(case)
            for place, cases in self.walked()
            for case in cases
        }
        for (_, gait, _), trial in gaits.items():
            check_walkable(gait, trial)

    def numbers(self, found: "DataFrame") -> dict[str, Any]:
        """Return settings and results as plain JSON values."""
        values = super().numbers(found) | plain(self, "gaits", "methods", "protocols", "runs", "seed")
        values["set_aside"] = int(found["set_aside"].sum())
        for protocol, counts in COUNTS.items():
            some = where(found, protocol=protocol)
            methods = self.methods if protocol in self.protocols else ()
            values[protocol] = report.rule_shares(some, methods, counts)
        return values

    def lines(self, found: "DataFrame") -> list[str]:
        """Return the tables of all walks, by kind of failure and method."""
        lines: list[str] = []
        if LINE in self.protocols:
            records = [one for one in self.statistics(found) if one["division"] in ("all", "kind")]
            lines += [*markdown(Table.of(records, report.COLUMNS)), *report.aside_lines(found)]
        for protocol in self.ruled:
            table = self._rule_table(found, protocol)
            header = [f"{protocol}: {table.header[0]}", *table.header[1:]]
            lines += ["", *markdown(Table(header, table.rows))]
        return lines

    def _rule_table(self, rows: "DataFrame", protocol: str) -> Table:
        some = where(rows, protocol=protocol)
        shares = report.rule_shares(some, self.methods, COUNTS[protocol])
        return Table.of([one for one in shares if one["walks"]], report.RULE_COLUMNS)

    def tables(self, found: "DataFrame") -> "Mapping[str, DataFrame]":
        """Return the table of all walks."""
        return {"recovery": report.table_of_walks(found)}

    def remarks(self, found: "DataFrame") -> list[str]:
        """Return the gaits, and the omissions from all numbers."""
        gaits = f"Gaits {', '.join(self.gaits)}; failures within the gait cycle after 8 s."
        return [gaits, *report.aside_lines(found)]

    def sections(self, found: "DataFrame") -> Iterator[Section]:
        """Return the parts of the report, those of the protocols judged by HexaHeal's rule included."""
        yield from super().sections(found)
        for protocol in self.ruled:
            yield Section(report.RULE_TITLES[protocol], [self._rule_table(found, protocol)])
