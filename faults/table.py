"""The tables of the fault matrix: results by fault, and combinations that were not run, with reasons."""

from collections.abc import Iterable, Sequence

import numpy as np
from scipy.stats import beta

from faults.fault import FAULTS, NONE
from faults.measurement import MOST_REST_S, REST_S, SHARE, Outcome
from faults.phase import PHASES
from faults.sense import cells, left_out
from hexctl.types import FloatArray

#: Phases in which a joint moves when the fault comes, so that the time to rest tells something.
MOVING = ("turning", "walking", "stopping", "sitting")

#: Verdicts on bars.
HOLDS, FAILS, UNMEASURED = "holds", "**does not hold**", "not measured"

#: Confidence of bounds.
CONFIDENCE = 0.95

HEADING = (
    "| fault | expected | injections | at rest, s: median, 99.9 %, maximum | largest step, pace "
    "| trials lost | unneeded stops |",
    "|---|---|---|---|---|---|---|",
)


def page_part(outcomes: Iterable[Outcome], not_measured: Sequence[str] = ()) -> str:
    """Verdicts and tables in Markdown.

    Args:
        outcomes: of all injections.
        not_measured: reasons of tries that ended before their fault.
    """
    given = list(outcomes)
    every = [one for one in given if one.punctual]
    rows = [_row(name, [one for one in every if one.fault == name]) for name in FAULTS]
    late = len(given) - len(every)
    measured = {(one.fault, one.backend, one.phase) for one in every}
    lines = [
        f"{len(every)} injections in {len(measured)} of {len(cells())} cells. {late} more do not count: "
        "the machine delayed the simulation by more than 0.02 s." + _ended_before(not_measured),
        "",
        *(f"- {bar}: {verdict}" for bar, verdict in bars(every).items()),
        "",
        *HEADING,
        *(row for row in rows if row),
        "",
        "| not run | why |",
        "|---|---|",
        *(f"| {'; '.join(what)} | {why} |" for why, what in left_out().items()),
    ]
    return "\n".join(lines)


def _ended_before(reasons: Sequence[str]) -> str:
    """Sentence on tries that ended before their fault."""
    if not reasons:
        return ""
    busy = sum(reason.startswith("TooLateError") for reason in reasons)
    return (
        f" {len(reasons)} tries ended before their fault and were repeated, {busy} of them because the "
        "machine was too busy."
    )


def rests_s(outcomes: Iterable[Outcome]) -> FloatArray:
    """Times to rest of robots that moved and were to rest; infinite where they moved to the end."""
    return np.array(
        [
            np.inf if one.rest_s is None else one.rest_s
            for one in outcomes
            if one.phase in MOVING and one.safe == "rests"
        ]
    )


def _row(name: str, outcomes: list[Outcome]) -> str:
    if not outcomes:
        return ""
    fault, rest = FAULTS[name], rests_s(outcomes)
    if name == NONE or not rest.size:
        timed = "-"
    else:
        timed = ", ".join(_seconds(float(value)) for value in _distribution(rest))
        timed += f"; within {REST_S}: {np.count_nonzero(rest <= REST_S)} of {rest.size}"
    trials = [one for one in outcomes if one.trials is not None]
    lost = f"{sum(one.lost or 0 for one in trials)} of {sum(one.trials or 0 for one in trials)}"
    to_go_on = [one for one in outcomes if one.safe == "goes on"]
    unneeded = f"{sum(one.unneeded for one in to_go_on)} of {len(to_go_on)}" if to_go_on else "-"
    step, pace = max(one.step for one in outcomes), max(one.pace for one in outcomes)
    return (
        f"| {fault.words} | {fault.safe} | {len(outcomes)} | {timed} "
        f"| {step:.2f}, {pace:.2f} | {lost if trials else '-'} | {unneeded} |"
    )


def _distribution(rest_s: FloatArray) -> tuple[float, float, float]:
    ordered = np.sort(rest_s)
    last = ordered.size - 1
    share = ordered[min(last, int(np.ceil(SHARE * ordered.size)) - 1)]
    return float(ordered[last // 2]), float(share), float(ordered[last])


def _seconds(value_s: float) -> str:
    return f"{value_s:.2f}" if np.isfinite(value_s) else "not at rest"


def bars(outcomes: Iterable[Outcome]) -> dict[str, str]:
    """The bars of the matrix, and a verdict on each: `HOLDS`, `FAILS`, `UNMEASURED`, or how sure it is.

    Times to rest count for faults that have to end the motion and need not be noticed first.
    """
    every = [one for one in outcomes if one.punctual]
    rest = rests_s(one for one in every if one.timed)
    wild = [one for one in every if one.fault == "wild-reading"]
    null = [one for one in every if one.fault == NONE]
    stopped = [one for one in null if one.stopped or (PHASES[one.phase].moves and not one.goes_on)]
    return {
        f"at rest within {REST_S} s in 99.9 % of the injections": _share_verdict(
            int(np.sum(rest <= REST_S)), rest.size
        ),
        f"always at rest within {MOST_REST_S} s": _verdict(rest.size, int(np.sum(rest > MOST_REST_S))),
        "no target farther than the joint's speed allows": _verdict(
            len(every), sum(one.jumped for one in every)
        ),
        "no fall, unless the fault topples the robot": _verdict(
            len(every), sum(one.fell and not FAULTS[one.fault].topples for one in every)
        ),
        "no trial lost": _verdict(
            sum(one.trials is not None for one in every), sum(bool(one.lost) for one in every)
        ),
        "no stop for one wild reading": _verdict(len(wild), sum(one.unneeded for one in wild)),
        "no stop without a fault": _verdict(len(null), len(stopped)),
    }


def _verdict(count: int, failed: int) -> str:
    return UNMEASURED if not count else FAILS if failed else HOLDS


def _share_verdict(held: int, count: int) -> str:
    """Verdict on a share by its lower confidence bound (Clopper and Pearson, one-sided)."""
    if not count:
        return UNMEASURED
    sure = float(beta.ppf(1 - CONFIDENCE, held, count - held + 1)) if held else 0.0
    verdict = HOLDS if sure >= SHARE else FAILS if held / count < SHARE else "not shown yet"
    return f"{verdict} ({held} of {count}; more than {100 * sure:.2f} % with 95 % confidence)"
