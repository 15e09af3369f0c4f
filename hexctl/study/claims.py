"""The claims of the paper and the project's own bar, each with its rule and the numbers measured."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from statistics import fmean

import numpy as np

from hexctl.study.landscape import Landscape
from hexctl.study.plan import BASELINE
from hexctl.study.searches import Findings
from hexctl.types import FloatArray

#: Shorter walks are not judged: deviations grow with the time walked, and the distances in claims and bars
#: are those of walks of this duration.
JUDGED_FROM_S = 30.0


@dataclass(frozen=True, kw_only=True)
class Claim:
    """A claim of the paper and the numbers of this study.

    Attributes:
        claim: the paper's statement.
        rule: condition under which it counts as held here.
        measured: the numbers, with the excess where it does not hold.
        beside: result of the random baseline, or another fact to compare with.
        holds: None where this study did not measure it or cannot judge it.
        not_judged: why the numbers cannot be judged; empty where they can.
    """

    claim: str
    rule: str
    measured: str
    beside: str
    holds: bool | None
    not_judged: str = ""

    @property
    def verdict(self) -> str:
        """Verdict in words."""
        return verdict_of(self.holds, self.not_judged)


def verdict_of(holds: bool | None, not_judged: str = "") -> str:
    """Verdict in words; `not_judged` is the reason why there is none."""
    if not_judged:
        return f"not judged: {not_judged}"
    return {True: "holds", False: "does not hold", None: "not measured"}[holds]


def too_short(duration_s: float) -> str:
    """Reason why walks of a duration are not judged, empty for those that are long enough."""
    if duration_s >= JUDGED_FROM_S:
        return ""
    return f"walks of {duration_s:g} s, needs at least {JUDGED_FROM_S:g} s"


def per_leg(legs: Sequence[int], values: Sequence[str]) -> str:
    """One text per leg, on one line."""
    return "; ".join(f"leg {leg}: {value}" for leg, value in zip(legs, values, strict=True)) or "no such leg"


def each(values: dict[str, str]) -> str:
    """One text per optimizer, on one line."""
    return ", ".join(f"{name} {value}" for name, value in values.items()) or "not within the budget"


def cm(value_m: float) -> str:
    """Length in m as text in cm."""
    if not np.isfinite(value_m):
        return "none"
    return f"{100 * value_m:.1f} cm" if abs(value_m) >= 0.01 else f"{100 * value_m:.2f} cm"


#: After 20 evaluations the mean is to be within 10 cm.
EARLY, EARLY_M = 20, 0.10

#: After 60 within 2.5 cm, or within 1 cm of the best gait that there is where that is not within 2.5 cm.
LATE, LATE_M, LATE_ABOVE_BEST_M = 60, 0.025, 0.01


@dataclass(frozen=True, kw_only=True)
class BarRow:
    """One optimizer against the bar at one number of evaluations.

    Attributes:
        optimizer: its name.
        paper_count: which count of evaluations.
        evaluations: 20 or 60.
        leg: the leg, or None for all legs together.
        mean_m: mean best-so-far over the runs that have found a valid gait; NaN when there is none.
        limit_m: the bar.
        share: of the runs that are in the mean.
        not_judged: why the mean cannot be judged; empty where it can.
    """

    optimizer: str
    paper_count: bool
    evaluations: int
    leg: int | None
    mean_m: float
    limit_m: float
    share: float
    not_judged: str = ""

    @property
    def over_m(self) -> float:
        """Excess of the mean over the bar, in m; negative within the bar."""
        return self.mean_m - self.limit_m

    @property
    def holds(self) -> bool | None:
        """Whether the mean is within the bar; False without any mean, None where it cannot be judged."""
        return None if self.not_judged else bool(self.over_m <= 0)

    @property
    def verdict(self) -> str:
        """Verdict in words, with the excess."""
        missed = f", by {cm(self.over_m)}" if self.holds is False else ""
        return verdict_of(self.holds, self.not_judged) + missed


def limit_m(findings: Findings, evaluations: int, leg: int | None) -> float:
    """Bar of a leg in m, or the mean of the legs' bars."""
    if evaluations == EARLY:
        return EARLY_M
    if leg is None:
        return fmean(limit_m(findings, evaluations, each) for each in findings.plan.legs)
    best = findings.rotated(leg).best_m
    return best + LATE_ABOVE_BEST_M if best > LATE_M else LATE_M


def bar_rows(findings: Findings, *, paper_count: bool) -> list[BarRow]:
    """Every optimizer against every bar within the budget: all legs together, then each leg."""
    return [
        _row(findings, optimizer, evaluations, leg, paper_count)
        for optimizer in findings.plan.optimizers
        for evaluations in (EARLY, LATE)
        if evaluations <= findings.plan.budget
        for leg in (None, *findings.plan.legs)
    ]


def _row(findings: Findings, optimizer: str, evaluations: int, leg: int | None, paper_count: bool) -> BarRow:
    if leg is None:
        curve = findings.mean_curve(optimizer, paper_count=paper_count)
    else:
        curve = findings.searches[leg, optimizer, paper_count].curve
    return BarRow(
        optimizer=optimizer,
        paper_count=paper_count,
        evaluations=evaluations,
        leg=leg,
        mean_m=float(curve.mean[evaluations - 1]),
        limit_m=limit_m(findings, evaluations, leg),
        share=float(curve.share[evaluations - 1]),
        not_judged=too_short(findings.plan.duration_s),
    )


#: Share of the gaits that is a tendency to one side; both sides have at least a fifth.
TENDENCY, BOTH = 0.9, 0.2


def left_share(landscape: Landscape) -> float:
    """Share of gaits that end on the left, of those that have an end; NaN where none has."""
    left, right = ends(landscape)
    return left / (left + right) if left + right else float("nan")


def ends(landscape: Landscape) -> tuple[int, int]:
    """Number of gaits that end on the left and on the right, valid or not."""
    signed = landscape.number("signed_m")
    return int((signed > 0).sum()), int((signed <= 0).sum())


def within(landscape: Landscape, limit_m: float) -> int:
    """Number of valid gaits that end within a distance of the line."""
    return int((landscape.final_m[landscape.valid] <= limit_m).sum())


def veers_left(findings: Findings) -> Claim:
    """Claim about legs 2 and 3."""
    return _side(findings, (2, 3), "left", "When leg 2 or 3 fails, the robot moves to the left", 1)


def veers_right(findings: Findings) -> Claim:
    """Claim about legs 5 and 6."""
    return _side(findings, (5, 6), "right", "When leg 5 or 6 fails, the robot moves to the right", -1)


def _side(findings: Findings, legs: Sequence[int], side: str, claim: str, sign: int) -> Claim:
    legs = [leg for leg in legs if leg in findings.plan.legs]
    shares = [left_share(findings.without(leg)) for leg in legs]
    shares = [share if sign > 0 else 1 - share for share in shares]
    return Claim(
        claim=claim,
        rule=f"at least {TENDENCY:.0%} of each leg's gaits end on the {side}, without self-rotation",
        measured=per_leg(legs, [f"{share:.0%} {side}" for share in shares]),
        beside="",
        holds=all(share >= TENDENCY for share in shares) if legs else None,
    )


def goes_both_ways(findings: Findings) -> Claim:
    """Claim about legs 1 and 4."""
    legs = [leg for leg in (1, 4) if leg in findings.plan.legs]
    shares = [left_share(findings.without(leg)) for leg in legs]
    return Claim(
        claim="When leg 1 or 4 fails, the robot goes straight or turns left or right, depending on the gait",
        rule=f"each side has at least {BOTH:.0%} of each leg's gaits, without self-rotation",
        measured=per_leg(legs, [f"{share:.0%} left, {1 - share:.0%} right" for share in shares]),
        beside="",
        holds=all(BOTH <= share <= 1 - BOTH for share in shares) if legs else None,
    )


def rotation_helps(findings: Findings) -> Claim:
    """Claim about the effect of the self-rotation."""
    legs = findings.plan.legs
    near = [within(findings.rotated(leg), EARLY_M) for leg in legs]
    before = [within(findings.without(leg), EARLY_M) for leg in legs]
    counts = [
        f"{count} ({within(findings.rotated(leg), LATE_M)} within 2.5 cm)"
        for leg, count in zip(legs, near, strict=True)
    ]
    return Claim(
        claim="After the self-rotation there are gaits with a small deviation, whichever leg failed",
        rule="each leg has a valid gait that ends within 10 cm of the line",
        measured="gaits within 10 cm: " + per_leg(legs, counts),
        beside="without self-rotation: " + per_leg(legs, [str(count) for count in before]),
        holds=all(count > 0 for count in near),
    )


#: A curve has converged when it is this near to its last value.
CONVERGED_M = 0.005

#: Optimizers are competitive when the worst is this near to the best.
COMPETITIVE_M = 0.025

#: Share of the whole improvement that the first 20 evaluations of a curve that is flat after them make.
FAST = 0.8


def expected_best_rank(draws: int, codes: int = 120) -> float:
    """Expected rank of the best of some codes drawn without repetition: (codes + 1) / (draws + 1)."""
    return (codes + 1) / (min(draws, codes) + 1)


def converges(findings: Findings) -> Claim:
    """Claim about the values at the end of the curves."""
    budget = findings.plan.budget
    finals = np.array(
        [
            findings.searches[leg, name, True].curve.mean[-1]
            for leg in findings.plan.legs
            for name in findings.heuristics
        ]
    )
    best = np.mean([findings.rotated(leg).best_m for leg in findings.plan.legs])
    reached = int((finals <= LATE_M).sum())
    return Claim(
        claim="The optimizers converge to about 2.5 cm in most cases",
        rule="more than half of the cases (leg and heuristic) have a mean within 2.5 cm at the end, "
        "by the paper's count",
        measured=f"{reached} of {finals.size} cases after {budget} evaluations; "
        f"median case {cm(_median(finals))}, worst {cm(_worst(finals))}",
        beside=f"best of all gaits, mean over legs: {cm(float(best))}; {_random(findings, budget)}",
        holds=reached > finals.size / 2 if finals.size and budget >= LATE else None,
    )


def fast_then_flat(findings: Findings) -> Claim:
    """Claim about the shape of the curves."""
    curves = _mean_curves(findings)
    shares = {
        name: float((curve[0] - curve[EARLY - 1]) / (curve[0] - curve[-1])) if curve[0] > curve[-1] else 1.0
        for name, curve in curves.items()
        if len(curve) > EARLY
    }
    return Claim(
        claim="Convergence is fastest in the first 20 evaluations and relatively flat from 20 to 120",
        rule=f"the first 20 evaluations make at least {FAST:.0%} of the improvement of each heuristic's mean",
        measured=each({name: f"{share:.0%}" for name, share in shares.items()}),
        beside="",
        holds=all(share >= FAST for share in shares.values()) if shares else None,
    )


def minimal_by_60(findings: Findings) -> Claim:
    """Claim about when the curves stop falling."""
    when = {
        name: int(np.argmax(curve <= curve[-1] + CONVERGED_M)) + 1
        for name, curve in _mean_curves(findings).items()
        if findings.plan.budget > LATE
    }
    return Claim(
        claim="Minimal values are reached in about 40 to 60 evaluations",
        rule="by 60, each heuristic's mean over legs is within 0.5 cm of where it ends, by the paper's count",
        measured=each({name: f"after {count}" for name, count in when.items()}),
        beside=f"expected best rank of {LATE} random draws: {expected_best_rank(LATE):.1f} of 120",
        holds=all(count <= LATE for count in when.values()) if when else None,
    )


def ten_cm_by_20(findings: Findings) -> Claim:
    """Claim about the first 20 evaluations."""
    means = _means_at(findings, EARLY)
    over = {name: mean - EARLY_M for name, mean in means.items() if not mean <= EARLY_M}
    missed = "; too much: " + each({name: cm(by) for name, by in over.items()}) if over else ""
    return Claim(
        claim="A deviation of about 10 cm is reached in less than 20 evaluations",
        rule="by 20, each heuristic's mean over legs and runs is within 10 cm, by the paper's count",
        measured=each({name: cm(mean) for name, mean in means.items()}) + missed,
        beside=f"{_random(findings, EARLY)}; expected best rank of {EARLY} random draws: "
        f"{expected_best_rank(EARLY):.1f} of 120",
        holds=not over if means else None,
    )


def competitive(findings: Findings) -> Claim:
    """Claim about the differences between heuristics."""
    means = _means_at(findings, LATE)
    spread = max(means.values()) - min(means.values()) if means else float("nan")
    random = _baseline_at(findings, LATE)
    better = sum(mean < random for mean in means.values())
    return Claim(
        claim="All heuristics are competitive under few evaluations",
        rule="by 60, the worst heuristic's mean is within 2.5 cm of the best's, by the paper's count",
        measured=f"{each({name: cm(mean) for name, mean in means.items()})}; {cm(spread)} apart",
        beside=f"{_random(findings, LATE)}; heuristics better than random: {better} of {len(means)}",
        holds=bool(spread <= COMPETITIVE_M) if len(means) > 1 else None,
    )


def best_keep_line(findings: Findings) -> Claim:
    """Claim about the best trajectories."""
    legs, names = findings.plan.legs, findings.heuristics
    best = [
        np.array(
            [np.nanmin(findings.searches[leg, name, True].best_m[:, -1], initial=np.inf) for name in names]
        )
        for leg in legs
    ]
    worst = [float(max(values)) if names else float("nan") for values in best]
    return Claim(
        claim="With the best gaits found, the robot keeps the direction reasonably well for each failed leg",
        rule="each heuristic's best run ends within 10 cm of the line for each leg",
        measured="the heuristics' best runs, worst of them: " + per_leg(legs, [cm(value) for value in worst]),
        beside="",
        holds=all(value <= EARLY_M for value in worst) if names else None,
    )


def _mean_curves(findings: Findings) -> dict[str, FloatArray]:
    """Mean of each heuristic over legs and runs by the paper's count."""
    return {name: findings.mean_curve(name, paper_count=True).mean for name in findings.heuristics}


def _means_at(findings: Findings, evaluations: int) -> dict[str, float]:
    if evaluations > findings.plan.budget:
        return {}
    return {name: findings.mean_at(name, evaluations, paper_count=True) for name in findings.heuristics}


def _baseline_at(findings: Findings, evaluations: int) -> float:
    if BASELINE not in findings.plan.optimizers:
        return float("nan")
    return findings.mean_at(BASELINE, evaluations, paper_count=True)


def _random(findings: Findings, evaluations: int) -> str:
    return f"random: {cm(_baseline_at(findings, evaluations))} after {evaluations}"


def _median(values: FloatArray) -> float:
    return float(np.median(values)) if values.size else float("nan")


def _worst(values: FloatArray) -> float:
    return float(values.max()) if values.size else float("nan")


def claims_of(findings: Findings) -> list[Claim]:
    """All claims in the paper's order; walks that are too short leave those that were measured not judged."""
    makers: list[Callable[[Findings], Claim]] = [
        veers_left,
        veers_right,
        goes_both_ways,
        rotation_helps,
        converges,
        fast_then_flat,
        minimal_by_60,
        ten_cm_by_20,
        competitive,
        best_keep_line,
    ]
    claims = [make(findings) for make in makers]
    reason = too_short(findings.plan.duration_s)
    if not reason:
        return claims
    return [
        claim if claim.holds is None else replace(claim, holds=None, not_judged=reason) for claim in claims
    ]
