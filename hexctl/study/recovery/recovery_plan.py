"""The recovery benchmark: legs fail in mid-walk in held-out worlds, and reactions are compared."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from operator import itemgetter
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
    Record,
    end_statistics,
    groups,
    mean_with_error,
    percentile,
    worlds_text,
)
from hexctl.study.paper.evidence import cm, cm_with_error, share_text, share_with_error
from hexctl.study.plan import check_each, check_families, check_setting, check_walkable
from hexctl.study.recovery.episodes import AUTO_GAIT, RecoveryCase, RecoveryPlace
from hexctl.study.recovery.methods import DEFAULT_METHODS, NOTHING, method_of
from hexctl.study.report_page import Section, Table, markdown
from hexctl.study.study_options import RUNS

if TYPE_CHECKING:
    from pandas import DataFrame, Series

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


#: A failure matters if it changes the end of a walk without a reaction by more than this, or its speed by
#: more than this share of the intact speed.
MATTERS_M, MATTERS_SHARE = 0.02, 0.10


def compared(rows: "DataFrame") -> "DataFrame":
    """Return episodes of the protocol `line` next to the same walk intact, and with nothing done about it.

    Column `judged` is true for those of robots that make progress in that world while intact, `set_aside`
    for the others; both are false for intact walks and other protocols.
    """
    rows = rows.assign(
        n_legs=[len(legs) for legs in rows["legs"]],
        leg=[legs[0] if legs else 0 for legs in rows["legs"]],
        leg_set=[" and ".join(map(str, sorted(legs))) for legs in rows["legs"]],
        failure_kind=[_kind_of(failure) for failure in rows["failure"]],
    )
    rows["whole_leg"] = ~rows["failure"].str.contains(":") & (rows["failure"] != "stuck")
    place = ["protocol", "robot", "family", "world", "gait", "heading_deg"]
    numbers = ["status", "signed_m", "after_m_s"]
    intact = rows[rows["n_legs"] == 0].set_index(place)[numbers].add_prefix("intact_")
    left = rows[(rows["method"] == NOTHING) & (rows["n_legs"] > 0)]
    left = left.set_index([*place, "legs", "failure"])[["ended", *numbers]].add_prefix("left_")
    rows = rows.join(intact, on=place).join(left, on=[*place, "legs", "failure"])
    one_of_line = (rows["protocol"] == "line") & (rows["n_legs"] > 0)
    rows["judged"] = one_of_line & (rows["intact_status"] == "ok")
    rows["set_aside"] = one_of_line & ~rows["judged"]
    rows["speed_kept"] = (rows["after_m_s"] / rows["intact_after_m_s"]).where(one_of_line)
    rows["matters"] = _matters(rows).where(one_of_line, None)
    rows["intact_status"] = rows["intact_status"].where(one_of_line, None)
    return rows


def _matters(rows: "DataFrame") -> "Series[bool]":
    slower = (rows["left_after_m_s"] - rows["intact_after_m_s"]).abs()
    return (
        (rows["left_ended"] == False)  # noqa: E712  unknown for intact walks
        | ((rows["left_signed_m"] - rows["intact_signed_m"]).abs() > MATTERS_M)
        | (slower > MATTERS_SHARE * rows["intact_after_m_s"].abs())
    )


def _kind_of(failure: str) -> str:
    """Kind of a failure in few words, such as `locked` or `stuck joint`."""
    name, _, joint = failure.partition(":")
    return f"{name} joint" if joint else name


def divisions(rows: "DataFrame") -> Iterator[tuple[str, str, "DataFrame"]]:
    """Return name of a division, name of a group in it, and its judged episodes of all methods."""
    judged = rows[rows["judged"]]
    if len(judged):
        yield "all", "one leg or joint failed", judged
    if judged["whole_leg"].any():
        yield "kind", "whole legs", judged[judged["whole_leg"]]
    columns = {"kind": "failure_kind", "failure": "failure", "robot": "robot", "gait": "gait"}
    more = {"family": "family", "leg": "leg", "kind of world": "kind_of_world"}
    yield from groups(judged, columns | more)


def statistics(rows: "DataFrame") -> Record:
    """Return the statistics of some episodes of one method; standard errors over worlds, NaN for one world.

    `kept_worst` is the smallest mean over worlds of the speed kept by a robot, gait, leg and failure, 0 for a
    walk that fell.
    """
    matter, noticed = rows["matters"].to_numpy(bool), rows[rows["right_leg"].to_numpy(bool)]
    delays = noticed["delay_cycles"].to_numpy(float)
    kept, kept_error = mean_with_error(rows, "speed_kept")
    return {
        "episodes": len(rows),
        **end_statistics(rows, 99),
        "matter": int(matter.sum()),
        "right_leg": len(noticed),
        "right_kind": int((rows["right_kind"] & matter).sum()),
        "early": int((rows["early_alarms"] > 0).sum()),
        "delay_median": percentile(delays, 50),
        "delay_p95": percentile(delays, 95),
        "kept": kept,
        "kept_error": kept_error,
        "kept_worst": _worst_cell(rows),
        "trials": int(rows["trials"].sum()),
    }


def _worst_cell(rows: "DataFrame") -> float:
    kept = rows.assign(speed_kept=rows["speed_kept"].fillna(0.0).astype(float))
    return float(kept.groupby([*SET, "failure"])["speed_kept"].mean().min())


#: A set of legs counts for each robot and gait.
SET = ["robot", "gait", "leg_set"]


def rule_share(rows: "DataFrame") -> Record:
    """Return how many walks have recovered, and of how many sets of legs at least half have."""
    return {
        "recovered": int(rows["recovered"].sum()),
        "walks": len(rows),
        "fell": int((~rows["ended"].astype(bool)).sum()),
        "sets": int((rows.groupby(SET)["recovered"].mean() >= 0.5).sum()),
        "of_sets": len(rows.drop_duplicates(SET)),
    }


def counted(count: int, of: int) -> str:
    """Text of a count, its share, and Wilson's interval of that."""
    from scipy.stats import binomtest

    if not of:
        return "-"
    interval = binomtest(count, of).proportion_ci(method="wilson")
    return f"{count} of {of} ({share_text(count / of)}, {interval.low:.1%} to {interval.high:.1%})"


def _if_noticing(text: Any) -> Any:
    """Text of a cell, or a dash for a method that notices no failures."""
    return lambda one: text(one) if method_of(one["method"]).notices else "-"


COLUMNS: Columns = {
    "": itemgetter("group"),
    "method": itemgetter("method"),
    "walks": lambda one: worlds_text(one["episodes"], one["worlds"]),
    "right leg": _if_noticing(lambda one: counted(one["right_leg"], one["episodes"])),
    "right kind, of those that matter": _if_noticing(lambda one: counted(one["right_kind"], one["matter"])),
    "alarm after: median, 95th percentile (cycles)": _if_noticing(
        lambda one: f"{one['delay_median']:.2f}, {one['delay_p95']:.2f}" if one["right_leg"] else "-"
    ),
    "early alarms": _if_noticing(lambda one: str(one["early"])),
    "final: mean": lambda one: cm_with_error(one["mean_m"], one["mean_error_m"]),
    "99th percentile": lambda one: cm(one["p99_m"]),
    "maximum": lambda one: cm(one["max_m"]),
    "during the walk: 99th percentile": lambda one: cm(one["way_p99_m"]),
    "fell": lambda one: counted(one["fell"], one["episodes"]) if one["fell"] else "0",
    "stopped": lambda one: str(one["others"]),
    "no progress": lambda one: str(one["no_progress"]),
    "speed kept": lambda one: share_with_error(one["kept"], one["kept_error"]),
    "worst cell": lambda one: _number(one["kept_worst"]),
    "trials before, each": lambda one: f"{one['trials'] / one['episodes']:.3g}" if one["trials"] else "0",
}

RULE_TITLES = {"hexaheal": "HexaHeal's protocol", "second": "A second leg"}


def rule_shares(rows: "DataFrame", methods: Sequence[str], counts: Sequence[int]) -> list[Record]:
    """Return the walks that recover, by number of failed legs and method."""
    return [
        {"legs": count, "method": method} | rule_share(where(rows, method=method, n_legs=count))
        for count in counts
        for method in methods
    ]


RULE_COLUMNS: Columns = {
    "legs that fail": lambda one: {1: "one", 2: "two"}[one["legs"]],
    "method": itemgetter("method"),
    "walks that recover": lambda one: counted(one["recovered"], one["walks"]),
    "fell or stopped": lambda one: str(one["fell"]),
    "sets of legs that recover": lambda one: f"{one['sets']} of {one['of_sets']}",
}


def aside_lines(rows: "DataFrame") -> list[str]:
    """Return the omissions from all numbers, in words; nothing if there are none."""
    aside = rows[rows["set_aside"]]
    places = dict.fromkeys(aside["robot"] + " in " + aside["place"])
    if not places:
        return []
    return [
        f"counted apart: {len(aside)} walks in which the robot makes no progress with six good legs "
        f"({', '.join(places)})"
    ]


def _number(value: float) -> str:
    """Text of a number; a dash if no walk was long enough for it."""
    return f"{value:.2f}" if math.isfinite(value) else "-"


def table_of_walks(rows: "DataFrame") -> "DataFrame":
    """Return the table of all walks as it is written."""
    legs = ["n_legs", "leg", "leg_set", "whole_leg", "failure_kind"]
    used = ["judged", "set_aside", "ended", "place", "intact_signed_m", "intact_after_m_s"]
    return rows.drop(columns=[*legs, *used, *rows.filter(like="left_")])


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
    HEADING: ClassVar[str] = "Legs fail in mid-walk"

    BY: ClassVar[str] = "method"
    COLUMNS: ClassVar[Columns] = COLUMNS
    columns = staticmethod(compared)
    divisions = staticmethod(divisions)
    summary = staticmethod(statistics)

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

    def numbers(self, findings: "DataFrame") -> dict[str, Any]:
        """Return settings and results as plain JSON values."""
        values = super().numbers(findings) | plain(self, "gaits", "methods", "protocols", "runs", "seed")
        values["set_aside"] = int(findings["set_aside"].sum())
        for protocol, counts in COUNTS.items():
            some = where(findings, protocol=protocol)
            methods = self.methods if protocol in self.protocols else ()
            values[protocol] = rule_shares(some, methods, counts)
        return values

    def lines(self, findings: "DataFrame") -> list[str]:
        """Return the tables of all walks, by kind of failure and method."""
        lines: list[str] = []
        if LINE in self.protocols:
            records = [one for one in self.statistics(findings) if one["division"] in ("all", "kind")]
            lines += [*markdown(Table.of(records, COLUMNS)), *aside_lines(findings)]
        for protocol in self.ruled:
            table = self._rule_table(findings, protocol)
            header = [f"{protocol}: {table.header[0]}", *table.header[1:]]
            lines += ["", *markdown(Table(header, table.rows))]
        return lines

    def _rule_table(self, rows: "DataFrame", protocol: str) -> Table:
        some = where(rows, protocol=protocol)
        shares = rule_shares(some, self.methods, COUNTS[protocol])
        return Table.of([one for one in shares if one["walks"]], RULE_COLUMNS)

    def tables(self, findings: "DataFrame") -> "Mapping[str, DataFrame]":
        """Return the table of all walks."""
        return {"recovery": table_of_walks(findings)}

    def remarks(self, findings: "DataFrame") -> list[str]:
        """Return the gaits, and the omissions from all numbers."""
        gaits = f"Gaits {', '.join(self.gaits)}; failures within the gait cycle after 8 s."
        return [gaits, *aside_lines(findings)]

    def sections(self, findings: "DataFrame") -> Iterator[Section]:
        """Return the parts of the report, those of the protocols judged by HexaHeal's rule included."""
        yield from super().sections(findings)
        for protocol in self.ruled:
            yield Section(RULE_TITLES[protocol], [self._rule_table(findings, protocol)])
