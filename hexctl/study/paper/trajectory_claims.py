"""Claims of the paper about trajectories: to which side they go, and what the self-rotation changes."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from hexctl.control.walks.turning import turn_needed_rad
from hexctl.study.landscape import Landscape
from hexctl.study.paper.evidence import (
    EARLY_M,
    LATE_M,
    Claim,
    Measure,
    Tolerance,
    Verdict,
    judge_all,
    measures_text,
    share_text,
)
from hexctl.study.paper.leg_groups import is_mirror_of
from hexctl.study.paper.searches import Findings
from hexctl.study.report_page import texts

if TYPE_CHECKING:
    from pandas import DataFrame

#: Minimum number of valid gaits to judge a side.
MIN_VALID = 10

#: Share of the gaits that counts as a tendency to one side; both sides have at least a fifth.
TENDENCY, BOTH = 0.9, 0.2

#: Minimum share of the gaits that end nearer to the line with self-rotation.
NEARER = 2 / 3

#: Gaits near the line that the self-rotation has to gain, mean over legs: more than none.
MORE = 0.1

#: Smaller self-rotations are none.
TURN_RAD = math.radians(1.0)


def make_claim(
    name: str, measured: str, verdict: Verdict, *, values: Mapping[str, object] | None = None, **more: str
) -> Claim:
    """Return the claim of a short name with a verdict.

    `values` fill the text of its rule; `more` are further fields of `Claim`.
    """
    text = texts("claims")[name]
    rule = text["rule"].format(**(values or {}))
    fields: dict[str, Any] = asdict(verdict) | more
    return Claim(claim=text["claim"], rule=rule, measured=measured, **fields)


def claim_of(
    name: str,
    measures: Sequence[Measure],
    text: Callable[[float], str],
    tolerance: Tolerance,
    *,
    before: str = "",
    **more: Any,
) -> Claim:
    """Return the claim that holds if all its numbers are within a tolerance; `before` leads their text."""
    measured = before + measures_text(measures, text, tolerance)
    return make_claim(name, measured, judge_all(measures, tolerance), **more)


def valid_left_share(landscape: Landscape) -> float:
    """Share of the valid gaits that end on the left; NaN with fewer than `MIN_VALID`."""
    signed = landscape.number("signed_m")[landscape.valid]
    return float((signed > 0).mean()) if signed.size >= MIN_VALID else float("nan")


def _valid_text(landscapes: Sequence[Landscape]) -> str:
    counts = ", ".join(str(int(one.valid.sum())) for one in landscapes)
    return f"{counts} of {len(landscapes[0].codes)} gaits valid"


def _sides(findings: Findings, legs: Sequence[int], number: Callable[[float], float]) -> list[Measure]:
    """A number of the share of each leg's valid gaits that end on the left, without self-rotation."""
    measures = []
    for leg in legs:
        landscapes = [findings.without(leg, world) for world in findings.worlds]
        values = tuple(number(valid_left_share(one)) for one in landscapes)
        measures.append(Measure(f"leg {leg}", values, _valid_text(landscapes), most=1.0))
    return measures


def _all_ends(findings: Findings, legs: Sequence[int]) -> str:
    shares = [f"leg {leg} {findings.without(leg).left_share:.0%}" for leg in legs]
    return "on the left of all gaits, valid or not: " + (", ".join(shares) or "no such leg")


def veers(findings: Findings, legs: Sequence[int], side: str) -> Claim:
    """Claim about legs after whose failure the robot goes to one side."""
    legs = [leg for leg in legs if leg in findings.plan.legs]
    others = ", ".join(str(8 - leg) for leg in legs)
    mirrored = legs and all(_mirrored(findings, leg, 8 - leg) for leg in legs)
    return claim_of(
        side,
        _sides(findings, legs, lambda left: left if side == "left" else 1 - left),
        share_text,
        Tolerance(TENDENCY, 1.0),
        beside=_all_ends(findings, legs),
        symmetric=f"mirror image of legs {others}: one vote for both" if mirrored else "",
        values={"tendency": TENDENCY, "side": side, "least": MIN_VALID},
    )


def _mirrored(findings: Findings, leg: int, other: int) -> bool:
    plan = findings.plan
    return is_mirror_of(plan.robot, plan.world, leg, other, "none", plan.failure)


def goes_both_ways(findings: Findings) -> Claim:
    """Claim about legs 1 and 4."""
    legs = [leg for leg in (1, 4) if leg in findings.plan.legs]
    tolerance, measures = Tolerance(BOTH, 1 - BOTH), _sides(findings, legs, float)
    verdict, symmetric = judge_all(measures, tolerance), ""
    if legs and all(_mirrored(findings, leg, leg) for leg in legs):
        symmetric = "robot and world are their own mirror image with this leg failed"
        if not verdict.not_judged:
            verdict = Verdict(no_evidence="the mirror symmetry implies it")
    return make_claim(
        "both sides",
        measures_text(measures, lambda share: f"{share:.0%} left", tolerance),
        verdict,
        beside=_all_ends(findings, legs),
        symmetric=symmetric,
        values={"both": BOTH},
    )


def rotation_straightens(findings: Findings) -> Claim:
    """Claim about the effect of the self-rotation, gait by gait."""
    return claim_of(
        "turn helps",
        [_nearer(findings, group) for group in _turning(findings)],
        share_text,
        Tolerance(NEARER, 1.0),
        beside="a leg that points to the rear already is no pair",
        values={"nearer": NEARER},
    )


def _turning(findings: Findings) -> list[tuple[int, ...]]:
    """Legs for which the self-rotation turns the robot, grouped by experiments without self-rotation."""
    plan = findings.plan
    if plan.self_rotation == "none":
        return []
    return [group for group in plan.experiments(plan.world, "none") if _turns(findings.rotated(group[0]))]


def _turns(landscape: Landscape) -> bool:
    spec = landscape.spec
    needed_rad = turn_needed_rad(spec.robot, spec.trial(spec.codes[0]).plan)
    return abs(needed_rad) > TURN_RAD


def _pairs(findings: Findings, leg: int, world: int) -> "DataFrame":
    """Gaits walked without and with self-rotation: scores before and after it, and which are valid."""
    from pandas import DataFrame

    before, after = (
        DataFrame({"score": one.scores, "valid": one.valid}, index=one.codes)
        for one in (findings.without(leg, world), findings.rotated(leg, world))
    )
    return before.add_suffix("_before").join(after.add_suffix("_after"))


def _nearer(findings: Findings, group: Sequence[int]) -> Measure:
    values, counts = [], []
    for world in findings.worlds:
        pairs = _pairs(findings, group[0], world)
        some = pairs[pairs["valid_before"] | pairs["valid_after"]]
        values.append(float((some["score_after"] < some["score_before"]).mean()))
        counts.append(f"{len(some)} pairs, {pairs['valid_before'].sum()} valid before")
    return Measure(experiment_text(group), tuple(values), ", ".join(dict.fromkeys(counts)), most=1.0)


def experiment_text(group: Sequence[int]) -> str:
    """Name of an experiment."""
    listed = ", ".join(str(leg) for leg in group)
    return f"leg {listed}" if len(group) == 1 else f"legs {listed} (one experiment)"


def rotation_helps(findings: Findings) -> Claim:
    """Claim about the gaits near the line with self-rotation, compared with the same gaits without it.

    Some of 120 gaits end near the line by chance; only the difference is evidence for the self-rotation.
    """
    enough, more = Tolerance(low=1.0), Tolerance(low=MORE)
    after = [_near(findings, group) for group in findings.experiments]
    turning = _turning(findings)
    near = [[_near_both_ways(findings, group[0], world) for world in findings.worlds] for group in turning]
    before = [Measure(experiment_text(group), tuple(without for without, _ in some))
              for group, some in zip(turning, near, strict=True)]  # fmt: skip
    gain = [_gain(near)] if near else []
    here = [f"leg {leg} {findings.without(leg).within(EARLY_M)}" for leg in findings.plan.legs]
    return make_claim(
        "gaits near the line",
        f"gaits within 10 cm: {measures_text(after, '{:.3g}'.format, enough)}; of the same "
        f"gaits more than without: {measures_text(gain, '{:+.1f}'.format, more)}",
        _judge_near(judge_all(after, enough), judge_all(before, enough), judge_all(gain, more)),
        beside="without self-rotation: " + ", ".join(here),
    )


def _judge_near(after: Verdict, before: Verdict, gain: Verdict) -> Verdict:
    if gain == Verdict():
        return gain  # No leg turns: nothing was measured.
    if after.holds is not False and before.holds:
        return Verdict(no_evidence="each leg that turns has such a gait without self-rotation, too")
    if False in (after.holds, gain.holds):
        return Verdict(holds=False)
    return gain if after.holds else after


def _near(findings: Findings, group: Sequence[int]) -> Measure:
    landscapes = [findings.rotated(group[0], world) for world in findings.worlds]
    counts = tuple(float(landscape.within(EARLY_M)) for landscape in landscapes)
    late = ", ".join(str(one.within(LATE_M)) for one in landscapes)
    return Measure(experiment_text(group), counts, f"{late} within 2.5 cm; {_valid_text(landscapes)}")


def _near_both_ways(findings: Findings, leg: int, world: int) -> tuple[int, int]:
    """Numbers of gaits near the line without and with self-rotation, of those walked both ways."""
    pairs = _pairs(findings, leg, world)
    return int((pairs["score_before"] <= EARLY_M).sum()), int((pairs["score_after"] <= EARLY_M).sum())


def _gain(near: Sequence[Sequence[tuple[int, int]]]) -> Measure:
    """How many more gaits are near the line with self-rotation, mean over the legs that turn."""
    counts = np.array(near)
    gains = counts[..., 1] - counts[..., 0]
    each = "; ".join(
        f"{', '.join(map(str, turned))} against {', '.join(map(str, without))}"
        for without, turned in counts.transpose(0, 2, 1)
    )
    return Measure("mean", tuple(gains.mean(axis=0).tolist()), each, least=-np.inf)


#: Claims about the robot.
OF_WALKS: tuple[Callable[[Findings], Claim], ...] = (
    partial(veers, legs=(2, 3), side="left"),
    partial(veers, legs=(5, 6), side="right"),
    goes_both_ways,
    rotation_straightens,
    rotation_helps,
)
