"""What a trial is worth: one score to be made small, with every invalid trial behind every valid one."""

from hexctl.control.result import TrialResult
from hexctl.errors import InputError

#: Score of a trial that fell, made no progress, diverged or was aborted: worse than any deviation in m.
INVALID_SCORE = 1e6

OBJECTIVES = ("final", "mean", "max", "progress")


def score_of(result: TrialResult, objective: str) -> float:
    """Return the score of a trial in m, lower is better.

    `final` (the paper's F), `mean` and `max` are deviations from the line of travel; `progress` is the final
    deviation per share of the ideal distance, so that of two equally straight walks the faster one wins.
    Raises InputError for another objective.
    """
    check_objective(objective)
    deviation, distance_m = result.deviation, result.distance_m
    if not result.valid or deviation is None or distance_m is None:
        return INVALID_SCORE
    if objective == "progress":
        # A short walk may have got nowhere: still ahead of every invalid one.
        score = deviation.final * result.ideal_distance_m / max(distance_m, 1e-9)
        return min(score, 0.99 * INVALID_SCORE)
    return {"final": deviation.final, "mean": deviation.mean, "max": deviation.max}[objective]


def check_objective(objective: str) -> None:
    """Raise InputError unless the objective is one of `OBJECTIVES`."""
    if objective not in OBJECTIVES:
        raise InputError(f"objective: got {objective!r}; allowed: {', '.join(OBJECTIVES)}")
