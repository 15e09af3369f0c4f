"""The tables of the documentation: what became of robots, by fault, and what was not run and why."""

from collections.abc import Iterable

import numpy as np

from faults.fault import FAULTS, NONE
from faults.measurement import MOST_REST_S, REST_S, SHARE, Outcome
from faults.phase import PHASES
from faults.sense import cells, left_out
from hexctl.types import FloatArray

#: Phases in which a joint moves when the fault comes, so that the time to rest tells something.
MOVING = ("turning", "walking", "stopping", "sitting")

HEADING = (
    "| fault | safe | injections | at rest, s: median, 99.9 %, greatest | within 0.25 s "
    "| largest step, pace | falls | trials lost | stops that were not needed |",
    "|---|---|---|---|---|---|---|---|---|",
)


def page_part(outcomes: Iterable[Outcome]) -> str:
    """Tables in Markdown."""
    given = list(outcomes)
    every = [one for one in given if one.punctual]
    rows = [_row(name, [one for one in every if one.fault == name]) for name in FAULTS]
    late = len(given) - len(every)
    measured = {(one.fault, one.backend, one.phase) for one in every}
    held = [f"{bar}: {'holds' if holds else '**does not hold**'}" for bar, holds in bars(every).items()]
    lines = [
        f"{len(every)} injections, {len(measured)} of {len(cells())} cells; {late} more in which the machine "
        "kept the twin waiting for more than 0.02 s are not counted. " + "; ".join(held) + ".",
        "",
        *HEADING,
        *(row for row in rows if row),
        "",
        "| not run | why |",
        "|---|---|",
        *(f"| {'; '.join(what)} | {why} |" for why, what in left_out().items()),
    ]
    return "\n".join(lines)


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
        timed = within = "-"
    else:
        timed = ", ".join(_seconds(float(value)) for value in _distribution(rest))
        within = f"{np.count_nonzero(rest <= REST_S)} of {rest.size}"
    trials = [one for one in outcomes if one.trials is not None]
    lost = f"{sum(one.lost or 0 for one in trials)} of {sum(one.trials or 0 for one in trials)}"
    to_go_on = [one for one in outcomes if one.safe == "goes on"]
    unneeded = f"{sum(one.unneeded for one in to_go_on)} of {len(to_go_on)}" if to_go_on else "-"
    falls = "by itself" if fault.topples else str(sum(one.fell for one in outcomes))
    step, pace = max(one.step for one in outcomes), max(one.pace for one in outcomes)
    return (
        f"| {fault.words} | {fault.safe} | {len(outcomes)} | {timed} | {within} "
        f"| {step:.2f}, {pace:.2f} | {falls} | {lost if trials else '-'} | {unneeded} |"
    )


def _distribution(rest_s: FloatArray) -> tuple[float, float, float]:
    ordered = np.sort(rest_s)
    last = ordered.size - 1
    share = ordered[min(last, int(np.ceil(SHARE * ordered.size)) - 1)]
    return float(ordered[last // 2]), float(share), float(ordered[last])


def _seconds(value_s: float) -> str:
    return f"{value_s:.2f}" if np.isfinite(value_s) else "not at rest"


def bars(outcomes: Iterable[Outcome]) -> dict[str, bool]:
    """The bars of the matrix, and whether each holds."""
    every = [one for one in outcomes if one.punctual]
    rest = np.array(
        [np.inf if one.rest_s is None else one.rest_s for one in every if one.timed and one.phase in MOVING]
    )
    null = [one for one in every if one.fault == NONE]
    return {
        f"at rest within {REST_S} s in 99.9 %": bool((rest <= REST_S).mean() >= SHARE) if rest.size else True,
        f"at rest within {MOST_REST_S} s at most": bool((rest <= MOST_REST_S).all()),
        "no step larger than a tick's slew": not any(one.jumped for one in every),
        "no trial lost": not any(one.lost for one in every),
        "no stop for one wild reading": not any(one.unneeded for one in every if one.fault == "wild-reading"),
        "without a fault no stop": not any(
            one.stopped or (PHASES[one.phase].moves and not one.goes_on) for one in null
        ),
    }
