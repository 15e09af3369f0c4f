"""Summary of a trial: a text panel for people, properties for programs."""

import json
import math
from collections.abc import Iterator, Mapping
from typing import Any

from hexctl.backends.clock import PERIOD_S
from hexctl.control.scoring.cause import CAUSES
from hexctl.control.trial_plan import TrialPlan
from hexctl.control.trial_result import TrialResult
from hexctl.gait.gait import SWING_SHARE, Gait
from hexctl.gait.posture import STANCE, Posture
from hexctl.recording.scene import Subject
from hexctl.robot.failure import failures_json
from hexctl.robot.model import Robot

Row = tuple[str, str]

#: Placeholder of a missing result, which a viewer also shows while it loads.
PENDING: Row = ("**result**", "*appears when the recording is complete*")


def make_markdown(
    title: str,
    subject: Subject,
    result: TrialResult | None,
    stability: float | None,
    facts: Mapping[str, Any],
) -> str:
    """Text panel in Markdown, with a placeholder for a missing result."""
    outcome = [PENDING] if result is None else _result_rows(result, stability)
    controller = None if result is None else result.controller
    rows = [*outcome, *_plan_rows(subject.robot, subject.plan, controller), *_fact_rows(result, facts)]
    return f"## {_cell(title)}\n\n{_table(rows)}\n"


def make_properties(
    title: str, subject: Subject, result: TrialResult, stability: float | None, facts: Mapping[str, Any]
) -> dict[str, Any]:
    """Title, plan, result and facts as named plain values, without None."""
    plan, gait = subject.plan, subject.plan.gait
    task = plan.in_words(subject.robot.gait.pace_hz) if result.controller is None else None
    failures = failures_json(plan.failures)
    values = {
        "title": title,
        "task": task,
        "robot": subject.robot.name,
        "gait_slots": list(gait.slots),
        "gait_code": gait.code(plan.failed_legs),
        "then": [str(change) for change in plan.changes] or None,
        "posture": None if gait.posture == STANCE else gait.posture.to_dict(),
        "swing_share": gait.swing_share,
        "phases": None if gait.phases is None else list(gait.phases),
        "pace_hz": gait.pace_hz,
        "amplitude": gait.amplitude,
        "height": gait.height,
        "heading_deg": math.degrees(plan.heading_rad),
        **failures,
        "further_failures": failures["further_failures"] or None,
        "self_rotation": plan.self_rotation,
        "stability": stability,
    }
    numbers = result.to_dict()
    deviation = numbers.pop("deviation_m")
    values |= numbers | {f"deviation_{name}_m": value for name, value in deviation.items()}
    return {key: _plain(value) for key, value in (values | dict(facts)).items() if value is not None}


def hold_in_words(outcome: Mapping[str, Any]) -> str:
    """Hold of a walk, why it was reduced, and what disturbed it, from the plain values of a trial result."""
    hold, caveat = outcome.get("hold", "none"), outcome.get("hold_caveat")
    why = f": {caveat}" if caveat else ""
    if hold == "none":
        return f"nothing{why}"
    by = "yaw alone" if hold == "heading" else "position alone"
    if hold == "line" and outcome["yaw_change_deg"] is not None:
        by = "position and yaw"
    lost_s, limited = outcome["hold_lost_s"], outcome["limited_ticks"]
    lost = f"; {'position' if hold == 'line' else 'yaw'} lost for {lost_s:.1f} s" if lost_s else ""
    seconds = f"; {PERIOD_S * limited:.1f} s slower than asked for, at its longest strokes" if limited else ""
    return f"the {hold}, by {by}{why}{lost}{seconds}"


def posture_in_words(posture: Posture, swing_share: float, size_m: float | None = None) -> str:
    """Differences of posture and swing from the paper's, or empty; lengths as shares without `size_m`."""
    size, unit = (100.0, "% of its size") if size_m is None else (size_m, "m")
    forward, left = (f"{size * share:+g} {unit}" for share in posture.shift)
    above = "higher" if posture.body_raise > 0 else "lower"
    parts = [
        (posture.body_raise, f"body {size * abs(posture.body_raise):g} {unit} {above}"),
        (any(posture.shift), f"over its feet {forward} forward, {left} to the left"),
        (posture.tucked_legs, f"tucked legs: {', '.join(map(str, posture.tucked_legs))}"),
        (swing_share != SWING_SHARE, f"feet in the air for {100 * swing_share:.3g} % of a cycle"),
    ]
    return "; ".join(text for given, text in parts if given)


def _slots_in_words(gait: Gait, failed_legs: tuple[int, ...]) -> str:
    code = gait.code(failed_legs)
    return " ".join(map(str, gait.slots)) + ("" if code is None else f" (code {code})")


def _plan_rows(robot: Robot, plan: TrialPlan, controller: str | None) -> Iterator[Row]:
    gait = plan.gait
    if len(plan.failures) > 1:
        yield "failed legs", ", ".join(f"{one.leg} ({one})" for one in plan.failures)
    for failure in plan.failures if len(plan.failures) == 1 else ():
        yield "failed leg", f"{failure.leg} ({failure}), turned to: {plan.self_rotation}"
    yield "robot", robot.name
    if controller is not None:
        yield "controller", controller
    yield "gait" if controller is None else "gait of the plan", _slots_in_words(gait, plan.failed_legs)
    if plan.changes:
        texts = [
            f"{_slots_in_words(each.gait, plan.failed_legs)} at {each.at_s:g} s" for each in plan.changes
        ]
        yield "then", ", ".join(texts)
    if posture := posture_in_words(gait.posture, gait.swing_share, robot.size_m):
        yield "posture", posture
    yield (
        "pace, amplitude, height",
        (f"{gait.pace_hz:g} Hz, {gait.amplitude * robot.size_m:g} m, {gait.height * robot.size_m:g} m"),
    )
    yield "heading", f"{math.degrees(plan.heading_rad):g}°"
    if plan.turn_rate_rad_s:
        yield "turn", f"{math.degrees(plan.turn_rate_rad_s):g} °/s"


def _result_rows(result: TrialResult, stability: float | None) -> Iterator[Row]:
    yield "**result**", f"**{result.status}** after {result.duration_s:.1f} s"
    if result.cause is not None:
        yield "likely cause", f"{result.cause}: {CAUSES.get(result.cause, '')}"
    if result.distance_m is not None:
        yield "distance", f"{result.distance_m:.2f} m of {result.ideal_distance_m:.2f} m without slip"
    if result.deviation is not None:
        off = result.deviation
        whole = (
            f", mean {100 * off.mean:.1f}, max {100 * off.max:.1f}"
            if math.isfinite(off.mean)
            else ", by hand"
        )
        yield "**deviation**", f"**{100 * off.final:.1f} cm** at the end{whole}"
    if result.duration_s:
        yield "held", hold_in_words(result.to_dict())
    for one in result.noticed:
        yield "noticed", f"{one.at_s:.2f} s: {one.in_words}"
        for line in one.did.split(": ", 1):
            yield "", line
    if result.yaw_change_rad is not None:
        yield "turned", f"{math.degrees(result.yaw_change_rad):+.1f}°"
    if result.cost_of_transport is not None and result.energy_j is not None:
        yield (
            "cost of transport",
            f"{result.cost_of_transport:.2f}, {result.energy_j:.1f} J of mechanical energy",
        )
    if result.trim_rad:
        yield "trim", f"{math.degrees(result.trim_rad):+.2f}°"
    if result.turn_trim_rad_s:
        yield "turn trim", f"{math.degrees(result.turn_trim_rad_s):+.3f} °/s"
    if stability is not None:
        yield "**stability**", f"**{100 * stability:.0f} %** of the walk above the feet that stand"
    yield "clipped ticks", str(result.clipped_ticks)


def _fact_rows(result: TrialResult | None, facts: Mapping[str, Any]) -> Iterator[Row]:
    told = {"robot", "gait", "failed_leg", "failure", *(result.to_dict() if result is not None else ())}
    for key, value in facts.items():
        if key not in told and value not in (None, [], {}):
            yield _cell(key), _cell(value)


def _table(rows: Any) -> str:
    lines = [f"| {name} | {value} |" for name, value in rows]
    return "\n".join(["| | |", "|---|---|", *lines])


def _cell(value: Any) -> str:
    if isinstance(value, list):
        value = ", ".join(map(str, value))
    if isinstance(value, Mapping):
        value = ", ".join(f"{key} {each}" for key, each in value.items())
    text = f"{value:g}" if isinstance(value, float) else str(value)
    return " ".join(text.split()).replace("|", "\\|")


def _plain(value: Any) -> Any:
    simple = (str, int, float, bool)
    if isinstance(value, simple):
        return value
    if isinstance(value, list) and value and all(type(item) is type(value[0]) for item in value):
        return value if isinstance(value[0], simple) else json.dumps(value, default=str)
    return json.dumps(value, default=str)
