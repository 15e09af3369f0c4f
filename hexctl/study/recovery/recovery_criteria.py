"""Bars of the recovery benchmark: what its method `recover` is to reach, and whether it does."""

import math
from collections.abc import Iterator
from dataclasses import replace

from hexctl.study.recovery.methods import TOLD
from hexctl.study.recovery.recovery_findings import (
    RecoveryFindings,
    RecoveryStatistics,
    counted,
    leg_set,
    recovering,
)
from hexctl.study.recovery.recovery_plan import LINE, SECOND
from hexctl.study.verdicts.claim_evidence import Bar, cm, limit_text, too_short

#: The method that is judged.
JUDGED = "recover"

#: How many episodes it takes to judge falls and the right leg, and the joints of failures that matter.
ENOUGH, ENOUGH_JOINTS = 1000, 100


def recovery_bars(findings: RecoveryFindings) -> list[Bar]:
    """Bars that the method `recover` reaches; those of lines are not judged on walks that are too short."""
    if JUDGED not in findings.plan.methods:
        return []
    bars: list[Bar] = []
    if LINE in findings.plan.protocols:
        bars = [*_alarm_bars(findings), *_walk_bars(findings)]
        if reason := too_short(findings.plan.duration_s):
            bars = [replace(bar, holds=None, not_judged=reason) for bar in bars]
    return [*bars, *_rule_bars(findings), *_second_bars(findings)]


def _alarm_bars(findings: RecoveryFindings) -> Iterator[Bar]:
    rows = [row for row in findings.judged if row.episode.case.method == JUDGED]
    legs = RecoveryStatistics.of([row for row in rows if row.whole_leg])
    yield _share_bar(
        "right_leg", "whole legs: the right one accused", legs.right_leg, legs.episodes, (0.99, 0.999), ENOUGH
    )
    joints = RecoveryStatistics.of([row for row in rows if not row.whole_leg and row.matters])
    what = "single joints that matter: leg, joint and kind right"
    yield _share_bar("right_joint", what, joints.right_kind, joints.matter, (0.95, 0.99), ENOUGH_JOINTS)
    both = RecoveryStatistics.of([row for row in rows if row.whole_leg or row.matters])
    yield Bar(
        name="delay",
        asked="failure to alarm: median at most 0.5, 95 of 100 at most 1 cycle",
        measured=f"median {both.delay_median:.2f}, 95 of 100 at most {both.delay_p95:.2f}",
        holds=bool(both.delay_median <= 0.5 and both.delay_p95 <= 1.0),
    )
    healthy = [one for _, one in findings.intact if one.status == "ok"]
    aside = [one for _, one in findings.intact if one.status != "ok"]
    alarms, early = sum(len(one.early) for one in healthy), sum(bool(row.episode.early) for row in rows)
    hours = sum(one.duration_s for one in healthy) / 3600
    yield Bar(
        name="false_alarms",
        asked="no false alarm in healthy walking",
        measured=f"{alarms} in {hours:.2f} h of intact walks; {early} of {len(rows)} episodes had one before "
        f"the failure; {sum(len(one.early) for one in aside)} in {len(aside)} intact walks without progress",
        holds=alarms + early == 0,
    )


def _walk_bars(findings: RecoveryFindings) -> Iterator[Bar]:
    rows = [row for row in findings.judged if row.episode.case.method == JUDGED]
    found = RecoveryStatistics.of(rows)
    legs = RecoveryStatistics.of([row for row in rows if row.whole_leg])
    yield Bar(
        name="settled",
        asked="failure to 90 % of the later speed: median at most 2.5 s (stretch: 1.5 s)",
        measured=_told(found.settled_median_s, ".2f", " s"),
        holds=bool(found.settled_median_s <= 2.5),
    )
    yield Bar(
        name="deviation",
        asked=f"deviation from the original line at the end: mean at most {limit_text(0.008)}, "
        f"99 of 100 at most {limit_text(0.04)} (stretch: {limit_text(0.004)}, {limit_text(0.025)})",
        measured=f"mean {cm(found.mean_m)}, 99 of 100 at most {cm(found.p99_m)}",
        holds=bool(found.mean_m <= 0.008 and found.p99_m <= 0.04),
    )
    failed = found.fell + found.others
    enough = found.episodes >= ENOUGH or failed > 0
    yield Bar(
        name="falls",
        asked=f"no fall in {ENOUGH} or more episodes",
        measured=f"{found.fell} fell, {found.others} diverged or were stopped, of {found.episodes}",
        holds=failed == 0 if enough else None,
        not_judged="" if enough else _few(found.episodes),
    )
    yield Bar(
        name="kept",
        asked="whole legs: speed kept against intact at least 80 % (stretch: 90 %), in the worst of robot, "
        "gait, leg and kind 60 %",
        measured=f"mean {_told(legs.kept, '.1%')}, worst {_told(legs.kept_worst, '.1%')}",
        holds=bool(legs.kept >= 0.8 and legs.kept_worst >= 0.6),
    )


def _told(value: float, form: str, unit: str = "") -> str:
    """A number with its unit; a dash for one that no walk was long enough for, `never` for infinity."""
    if math.isinf(value):
        return "never"
    return "-" if math.isnan(value) else f"{value:{form}}{unit}"


def _rule_bars(findings: RecoveryFindings) -> Iterator[Bar]:
    found = findings.rule_share(JUDGED, 2)
    if not found.of_sets:
        return
    share = found.sets / found.of_sets
    yield Bar(
        name="pairs",
        asked="HexaHeal's rule: pairs of legs that recover in at least half of the walks: 12 of 15 "
        "(stretch: 15)",
        measured=f"{found.sets} of {found.of_sets}; {found.recovered} of {found.walks} walks",
        holds=share >= 12 / 15,
    )


def _second_bars(findings: RecoveryFindings) -> Iterator[Bar]:
    """Of the pairs that recover when told, those that recover by themselves."""
    told = findings.ruled(TOLD, SECOND)
    if not told:
        return
    sets, able = {leg_set(*row) for row in told}, recovering(told)
    found = [row for row in findings.ruled(JUDGED, SECOND) if leg_set(*row) in able]
    recover = len(recovering(found))
    yield Bar(
        name="second",
        asked="a second leg 10 s after the first: pairs that recover in at least half of the walks, of those "
        "that do when told: 80 %",
        measured=f"{recover} of {len(able)} (of {len(sets)} pairs); "
        f"{sum(one.recovered for _, one in found)} of {len(found)} walks",
        holds=recover >= 0.8 * len(able) if able else None,
        not_judged="" if able else "no pair recovers when told",
    )


def _share_bar(name: str, what: str, count: int, of: int, least: tuple[float, float], enough: int) -> Bar:
    """Bar of a share that is to be at least so much, with its stretch; not judged on few episodes."""
    return Bar(
        name=name,
        asked=f"{what}: at least {least[0]:.0%} (stretch: {least[1]:.1%}), of {enough} or more",
        measured=counted(count, of),
        holds=count >= least[0] * of if of >= enough else None,
        not_judged="" if of >= enough else _few(of, enough),
    )


def _few(episodes: int, enough: int = ENOUGH) -> str:
    return f"{episodes} episodes, needs {enough}"
