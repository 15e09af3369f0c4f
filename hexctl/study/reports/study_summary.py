"""A study in three sentences: the experiment, the verdicts, and the searches beside what needs none."""

from collections.abc import Sequence
from statistics import fmean

import numpy as np

from hexctl.study.searches import BASELINE, Findings
from hexctl.study.verdicts.claim_evidence import Claim, cm
from hexctl.study.verdicts.trajectories import EARLY

#: Beginnings of verdicts, and how the summary counts them.
COUNTED = {
    "holds": "hold",
    "does not hold": "do not hold",
    "no evidence": "have no evidence",
    "not judged": "are not judged",
    "not measured": "are not measured",
}


def summary(findings: Findings) -> str:
    """Three sentences for the top of a report."""
    return " ".join((_experiment(findings), _verdicts(findings.claims), _searches(findings)))


def _experiment(findings: Findings) -> str:
    plan = findings.plan
    legs = f"leg {plan.legs[0]}" if len(plan.legs) == 1 else f"each of {len(plan.legs)} legs"
    search = "one search" if len(plan.optimizers) == 1 else f"{len(plan.optimizers)} searches"
    return (
        f"{plan.robot.name} walked 120 gaits for {plan.duration_s:g} s with {legs} {plan.failure}, "
        f"and {search} looked for the straightest gait."
    )


def _verdicts(claims: Sequence[Claim]) -> str:
    counts = {
        words: sum(claim.verdict.startswith(begin) for claim in claims) for begin, words in COUNTED.items()
    }
    *others, last = [f"{count} {words}" for words, count in counts.items() if count]
    listed = f"{', '.join(others)} and {last}" if others else last
    return f"Of the paper's {len(claims)} claims, {listed}."


def _searches(findings: Findings) -> str:
    """The best search, the random baseline and the best default gait, in one sentence."""
    after = min(EARLY, findings.plan.budget)
    means_m = {
        name: float(findings.mean_curve(name, paper_count=False).mean[after - 1])
        for name in findings.plan.optimizers
    }
    found = {name: mean_m for name, mean_m in means_m.items() if np.isfinite(mean_m)}
    if not found:
        return f"No search found a valid gait within {after} evaluations."
    best = min(found, key=found.__getitem__)
    parts = [f"{cm(found[best])} with the best search ({best})"]
    if BASELINE in found and best != BASELINE:
        parts.append(f"{cm(found[BASELINE])} with random search")
    parts += _without_a_search(findings)
    listed = parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"
    return f"After {after} evaluations, the mean deviation from the line is {listed}."


def _without_a_search(findings: Findings) -> list[str]:
    """Mean deviation with the best default gait; empty if each of them is invalid for some leg."""
    ends_m: dict[str, list[float | None]] = {}
    for walk in findings.default_walks:
        if walk.leg in findings.searched:
            ends_m.setdefault(walk.gait, []).append(walk.final_m)
    means_m = {
        gait: fmean(final_m for final_m in ends if final_m is not None)
        for gait, ends in ends_m.items()
        if None not in ends
    }
    if not means_m:
        return []
    best = min(means_m, key=means_m.__getitem__)
    return [f"{cm(means_m[best])} with the {best} gait, which needs no search"]
