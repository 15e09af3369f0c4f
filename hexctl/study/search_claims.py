"""The paper's claims about the optimizers; all by the paper's count, where repetitions cost an evaluation."""

import numpy as np

from hexctl.study.bars import EARLY, EARLY_M, LATE, LATE_M
from hexctl.study.claim import Claim, cm, each, per_leg
from hexctl.study.findings import Findings
from hexctl.study.plan import BASELINE
from hexctl.types import FloatArray

#: A curve has converged when it is this near to its last value.
CONVERGED_M = 0.005

#: Optimizers are competitive when the worst is this near to the best.
COMPETITIVE_M = 0.025

#: Share of the whole improvement that the first 20 evaluations of a curve that is flat after them make.
FAST = 0.8


def expected_best_rank(draws: int, codes: int = 120) -> float:
    """Return the expected rank of the best of some codes that were drawn without repetition."""
    return (codes + 1) / (min(draws, codes) + 1)


def converges(findings: Findings) -> Claim:
    """Return what was found of the claim about the values at the end."""
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
    """Return what was found of the claim about the shape of the curves."""
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
    """Return what was found of the claim about when the curves end to fall."""
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
    """Return what was found of the claim about the first 20 evaluations."""
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
    """Return what was found of the claim about the differences between heuristics."""
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
    """Return what was found of the claim about the best trajectories."""
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
    """Return each heuristic's mean over legs and runs by the paper's count."""
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
