"""What the episodes of the recovery benchmark show: statistics of groups of them, and bars."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from hexctl.study.recovery.episodes import Episode, RecoveryConditions
from hexctl.study.recovery.methods import NOTHING
from hexctl.study.recovery.recovery_plan import HEXAHEAL, LINE, RecoveryPlan
from hexctl.study.verdicts.claim_evidence import (
    clustered_error,
    share_text,
    wilson_interval,
)
from hexctl.types import FloatArray

#: A failure matters that, with nothing done about it, changes the end by more than this, or the speed by more
#: than this share of the intact one.
MATTERS_M, MATTERS_SHARE = 0.02, 0.10


@dataclass(frozen=True, slots=True)
class Judged:
    """An episode of the protocol `line`, beside the same walk intact, and with nothing done about it.

    Attributes:
        place: its conditions.
        episode: itself.
        intact: the walk of the same robot, world, gait and heading in which nothing fails.
        left: the walk in which the same happens and nothing is done.
    """

    place: RecoveryConditions
    episode: Episode
    intact: Episode
    left: Episode

    @property
    def world(self) -> str:
        """Name of the world."""
        return f"{self.place.family}:{self.place.number}"

    @property
    def leg(self) -> int:
        """The leg that fails."""
        return self.episode.case.legs[0]

    @property
    def whole_leg(self) -> bool:
        """Whether all joints of the leg fail, or the leg is gone."""
        return ":" not in self.episode.case.failure and self.episode.case.failure != "stuck"

    @property
    def kind(self) -> str:
        """Kind of the failure in few words, such as `locked` or `stuck joint`."""
        name, _, joint = self.episode.case.failure.partition(":")
        return f"{name} joint" if joint else name

    @property
    def matters(self) -> bool:
        """Whether the failure changes a walk with which nothing is done about it."""
        left, intact = self.left, self.intact
        if not left.ended:
            return True
        changed_m = abs(left.signed_m - intact.signed_m)
        return bool(
            changed_m > MATTERS_M
            or abs(left.after_m_s - intact.after_m_s) > MATTERS_SHARE * abs(intact.after_m_s)
        )

    @property
    def kept(self) -> float:
        """Later speed as a share of the intact one; NaN for a walk that did not end on its feet."""
        return self.episode.after_m_s / self.intact.after_m_s


@dataclass(frozen=True, kw_only=True)
class RecoveryStatistics:
    """Statistics of some episodes of one method; standard errors are over worlds, NaN for a single one.

    A walk that fell, diverged or was stopped has neither deviation nor speed.

    Attributes:
        episodes: number of episodes.
        worlds: number of worlds.
        matter: how many of the failures matter.
        right_leg: episodes whose first alarm is of the leg that has failed, after it has.
        right_kind: those of failures that matter in which it has kind and joint right too.
        early: episodes with an alarm before anything has failed.
        again: episodes with more than one alarm.
        delay_median: time from the failure to the right alarm in gait cycles.
        delay_p95: its 95th percentile.
        fell: episodes that fell.
        others: episodes that diverged or were stopped.
        no_progress: episodes without progress.
        mean_m: mean of the final deviation from the original line.
        mean_error_m: its standard error.
        p99_m: 99th percentile of the final deviation.
        max_m: greatest one.
        way_p99_m: 99th percentile of the greatest deviation after the failure.
        kept: mean of the later speed as a share of the intact one.
        kept_error: its standard error.
        kept_worst: the same of the worst robot, gait, leg and failure, over worlds.
        settled_median_s: time until 90 % of the later speed are reached.
        trials: made before the walks, all together.
    """

    episodes: int
    worlds: int
    matter: int
    right_leg: int
    right_kind: int
    early: int
    again: int
    delay_median: float
    delay_p95: float
    fell: int
    others: int
    no_progress: int
    mean_m: float
    mean_error_m: float
    p99_m: float
    max_m: float
    way_p99_m: float
    kept: float
    kept_error: float
    kept_worst: float
    settled_median_s: float
    trials: int

    @classmethod
    def of(cls, rows: Sequence[Judged]) -> "RecoveryStatistics":
        """Statistics of some episodes."""
        episodes = [row.episode for row in rows]
        worlds = np.array([row.world for row in rows])
        final_m = np.array([one.final_m for one in episodes])
        kept = np.array([row.kept for row in rows])
        ended, known = np.isfinite(final_m), np.isfinite(kept)
        delays = np.array([one.delay_s * one.pace_hz for one in episodes if one.right_leg])
        ways_m = np.array([one.way_m for one in episodes])
        settled_s = [one.settled_s if math.isfinite(one.settled_s) else math.inf for one in episodes]
        return cls(
            episodes=len(rows),
            worlds=len(set(worlds.tolist())),
            matter=sum(row.matters for row in rows),
            right_leg=sum(one.right_leg for one in episodes),
            right_kind=sum(row.matters and row.episode.right_kind for row in rows),
            early=sum(bool(one.early) for one in episodes),
            again=sum(len(one.alarms) > 1 for one in episodes),
            delay_median=_percentile(delays, 50),
            delay_p95=_percentile(delays, 95),
            fell=sum(one.status == "fell" for one in episodes),
            others=sum(not one.ended and one.status != "fell" for one in episodes),
            no_progress=sum(one.status == "no_progress" for one in episodes),
            mean_m=_mean(final_m[ended]),
            mean_error_m=float(clustered_error(final_m[ended], worlds[ended])),
            p99_m=_percentile(final_m[ended], 99),
            max_m=_percentile(final_m[ended], 100),
            way_p99_m=_percentile(ways_m[ended], 99),
            kept=_mean(kept[known]),
            kept_error=float(clustered_error(kept[known], worlds[known])),
            kept_worst=_worst_cell(rows),
            settled_median_s=_percentile(np.array(settled_s)[known], 50),
            trials=sum(one.trials for one in episodes),
        )


def _worst_cell(rows: Sequence[Judged]) -> float:
    """Smallest mean over worlds of the speed kept, of any robot, gait, leg and failure; 0 of a fallen one."""
    cells: dict[tuple[object, ...], list[float]] = {}
    for row in rows:
        case = row.episode.case
        kept = row.kept if math.isfinite(row.kept) else 0.0
        cells.setdefault((row.place.robot.name, case.gait, case.legs, case.failure), []).append(kept)
    return min((float(np.mean(cell)) for cell in cells.values()), default=math.nan)


def _mean(values: FloatArray) -> float:
    return float(values.mean()) if values.size else math.nan


def _percentile(values: FloatArray, percent: float) -> float:
    """Percentile of values, infinite ones among them; NaN for none."""
    if not values.size:
        return math.nan
    return float(np.percentile(values, percent, method="linear" if np.isfinite(values).all() else "higher"))


@dataclass(frozen=True, kw_only=True)
class RuleShare:
    """How many walks have recovered by HexaHeal's rule.

    Attributes:
        recovered: walks that have.
        walks: all of them.
        fell: walks that fell, diverged or were stopped.
        sets: sets of legs of which at least half of the walks have.
        of_sets: all sets of legs, counted for each robot and gait.
    """

    recovered: int
    walks: int
    fell: int
    sets: int
    of_sets: int

    @classmethod
    def of(cls, rows: Sequence[tuple[RecoveryConditions, Episode]]) -> "RuleShare":
        """Share of some walks."""
        sets = {leg_set(*row) for row in rows}
        return cls(
            recovered=sum(one.recovered for _, one in rows),
            walks=len(rows),
            fell=sum(not one.ended for _, one in rows),
            sets=len(recovering(rows)),
            of_sets=len(sets),
        )


#: Robot, gait and legs that lose their torque, ascending.
LegSet = tuple[str, str, tuple[int, ...]]


def leg_set(place: RecoveryConditions, episode: Episode) -> LegSet:
    """Set of legs that a walk counts for."""
    return (place.robot.name, episode.case.gait, tuple(sorted(episode.case.legs)))


def recovering(rows: Sequence[tuple[RecoveryConditions, Episode]]) -> set[LegSet]:
    """Sets of legs of which at least half of the walks have recovered."""
    walks: dict[LegSet, list[bool]] = {}
    for place, one in rows:
        walks.setdefault(leg_set(place, one), []).append(one.recovered)
    return {legs for legs, each in walks.items() if 2 * sum(each) >= len(each)}


@dataclass(frozen=True, kw_only=True)
class RecoveryFindings:
    """The episodes of a plan.

    Attributes:
        plan: what was walked.
        episodes: each with its conditions, in the order of the plan.
    """

    plan: RecoveryPlan
    episodes: Sequence[tuple[RecoveryConditions, Episode]]

    @cached_property
    def intact(self) -> list[tuple[RecoveryConditions, Episode]]:
        """Walks of the protocol `line` in which nothing fails."""
        return [(place, one) for place, one in self.episodes if not one.case.legs]

    @cached_property
    def _all(self) -> list[Judged]:
        intact = {(*_where(place), one.case.gait, one.case.heading_deg): one for place, one in self.intact}
        left = {
            (*_where(place), replace(one.case, method="")): one
            for place, one in self.episodes
            if one.case.method == NOTHING
        }
        return [
            Judged(
                place,
                one,
                intact[(*_where(place), one.case.gait, one.case.heading_deg)],
                left[(*_where(place), replace(one.case, method=""))],
            )
            for place, one in self.episodes
            if one.case.legs and place.protocol == LINE
        ]

    @cached_property
    def judged(self) -> list[Judged]:
        """Episodes of the protocol `line` of robots that make progress in that world while intact."""
        return [row for row in self._all if row.intact.status == "ok"]

    @cached_property
    def set_aside(self) -> list[Judged]:
        """The others: robots that make no progress there even with six good legs, or fall."""
        return [row for row in self._all if row.intact.status != "ok"]

    def groups(self) -> Iterator[tuple[str, str, list[Judged]]]:
        """Name of a division, name of a group in it, and its episodes, of all methods."""
        rows = self.judged
        yield "all", "one leg or joint failed", rows
        yield "kind", "whole legs", [row for row in rows if row.whole_leg]
        for division, name_of in _DIVISIONS.items():
            for name in dict.fromkeys(map(name_of, self._all)):  # in the order of the plan
                some = [row for row in rows if name_of(row) == name]
                if some:
                    yield division, name, some

    def statistics(self, rows: Sequence[Judged], method: str) -> RecoveryStatistics:
        """Statistics of those of some episodes that are of a method."""
        return RecoveryStatistics.of([row for row in rows if row.episode.case.method == method])

    @cached_property
    def table(self) -> list[tuple[str, str, str, RecoveryStatistics]]:
        """Division, group, method, and the statistics of these episodes."""
        return [
            (division, name, method, self.statistics(rows, method))
            for division, name, rows in self.groups()
            if rows
            for method in self.plan.methods
        ]

    def rule_share(self, method: str, legs: int | tuple[int, ...], protocol: str = HEXAHEAL) -> RuleShare:
        """Walks by a method in which so many legs lose their torque, or just these, in any order."""
        return RuleShare.of(
            [
                (place, one)
                for place, one in self.ruled(method, protocol)
                if legs in (len(one.case.legs), tuple(sorted(one.case.legs)))
            ]
        )

    def ruled(self, method: str, protocol: str = HEXAHEAL) -> list[tuple[RecoveryConditions, Episode]]:
        """Walks by a method under a protocol that is judged by the rule."""
        return [
            (place, one)
            for place, one in self.episodes
            if place.protocol == protocol and one.case.method == method
        ]

    def leg_sets(self, protocol: str = HEXAHEAL) -> list[tuple[int, ...]]:
        """Sets of legs that lose their torque in a protocol, ascending, in the order of the plan."""
        return list(
            dict.fromkeys(
                tuple(sorted(one.case.legs)) for place, one in self.episodes if place.protocol == protocol
            )
        )


def _where(place: RecoveryConditions) -> tuple[str, str, str, int]:
    return (place.protocol, place.robot.name, place.family, place.number)


#: Divisions of the episodes, and what is told apart in them.
_DIVISIONS: dict[str, Callable[[Judged], str]] = {
    "kind": lambda row: row.kind,
    "failure": lambda row: row.episode.case.failure,
    "robot": lambda row: row.place.robot.name,
    "gait": lambda row: row.episode.case.gait,
    "family": lambda row: row.place.family,
    "leg": lambda row: str(row.leg),
    "kind of world": lambda row: row.place.kind,
}


def counted(count: int, of: int) -> str:
    """A count of some, its share, and the interval of that."""
    if not of:
        return "-"
    low, high = wilson_interval(count, of)
    return f"{count} of {of} ({share_text(count / of)}, {low:.1%} to {high:.1%})"
