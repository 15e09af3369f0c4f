"""Results as text."""

import math
import shlex
from collections.abc import Mapping
from typing import Any

import numpy as np

from hexctl.backends.clock import PERIOD_S
from hexctl.control.guard import Guard
from hexctl.control.log import TickLog
from hexctl.control.plan import TrialPlan
from hexctl.control.result import TrialResult

#: What to look at after a stop that a person did not ask for.
HINTS = {
    "state": "the robot's state did not come, or not in time; is the robot still there?",
    "expired": "commands did not reach the robot in time; a busy computer, or a bad link",
    "pose lost": "the robot no longer says where it is",
    "estop": "hexctl estop --clear when it may move again",
    "fault": "see to it, then hexctl estop --clear",
}


def report(
    plan: TrialPlan,
    result: TrialResult,
    log: TickLog,
    guard: Guard,
    *,
    wall_s: float,
    gait_text: str,
    facts: dict[str, Any],
) -> dict[str, Any]:
    """Return the JSON object of `hexctl run --json`; every value is plain and finite, or null."""
    work_us = log["work_s"] * 1e6  # (ticks,)
    quantiles = np.percentile(work_us, [50, 99, 100]) if len(log) else np.zeros(3)
    return {
        "gait": {"name": gait_text, "slots": list(plan.gait.slots), "code": plan.gait.code(plan.failed_legs)},
        "failed_leg": plan.failure.leg if plan.failure else None,
        "failure": str(plan.failure) if plan.failure else None,
        **result.numbers(),
        "ideal_yaw_change_deg": math.degrees(plan.turn_rate_rad_s * result.duration_s),
        "ticks": len(log),
        "overruns": guard.clock.overruns,
        "refused_commands": guard.counters.refused,
        "servo_link": guard.link_counts or None,
        "tick_us": dict(zip(("p50", "p99", "max"), (round(float(q), 1) for q in quantiles), strict=True)),
        "realtime_factor": round(len(log) * PERIOD_S / wall_s, 2) if wall_s > 0 else None,
        **facts,
    }


def summary(outcome: dict[str, Any]) -> str:
    """Return the outcome for a person."""
    where = f"in world {outcome['world']}" if outcome["world"] else f"on {outcome['backend']}"
    failed = f", leg {outcome['failed_leg']} {outcome['failure']}" if outcome["failed_leg"] else ""
    link = link_in_words(outcome["servo_link"])
    lines = [
        f"{outcome['robot']} {where}{failed}",
        f"gait       {_gait_text(outcome['gait'])}",
        *_distance_lines(outcome),
        f"status     {outcome['status']}" + _why(outcome["stopped"]),
        _clipped_line(outcome),
        *([f"link       {link}"] if link else []),
        f"ticks      {outcome['ticks']}, {outcome['overruns']} overruns, "
        f"{outcome['realtime_factor']:g} x real time",
    ]
    if outcome["recording"]:
        lines.append(f"recording  {outcome['recording']}")
        lines.append(f"look at it with: hexctl view {shlex.quote(outcome['recording'])}")
    return "\n".join(lines)


def _why(stopped: str | None) -> str:
    """Return why a walk was stopped, and where to look."""
    if stopped is None:
        return ""
    hint = HINTS.get(stopped.partition(":")[0])
    return f" ({stopped})" if hint is None else f" ({stopped}): {hint}"


def _gait_text(gait: dict[str, Any]) -> str:
    """Return name, slots and code, each once."""
    slots = ",".join(str(slot) for slot in gait["slots"])
    named = gait["name"] not in (slots, str(gait["code"]))
    code = "" if gait["code"] is None else f", code {gait['code']}"
    return f"{gait['name']} (slots {slots}{code})" if named else f"slots {slots}{code}"


def _distance_lines(outcome: dict[str, Any]) -> list[str]:
    """Return distance, deviation and turn, as far as the robot knows them."""
    if outcome["distance_m"] is None:
        known = "this robot knows no position" if outcome["duration_s"] else "it never set out"
        return [f"walked     {outcome['duration_s']:.1f} s; {known}"]
    ideal, turned = outcome["ideal_distance_m"], outcome["ideal_yaw_change_deg"]
    if turned and ideal:
        return [
            f"walked     {outcome['duration_s']:.1f} s in an arc, "
            f"ended {outcome['distance_m']:.3f} m ahead and {_side(outcome['deviation_m']['signed'])}",
            f"turned     {outcome['yaw_change_deg'] + 0.0:.1f} degrees of {turned:.1f} asked for",
        ]
    share = f" of {ideal:.3f} m ideal ({100 * outcome['distance_m'] / ideal:.0f} %)" if ideal else ""
    of_ideal = f" of {turned:.1f} asked for" if turned else ""
    return [
        f"walked     {outcome['duration_s']:.1f} s, {outcome['distance_m']:.3f} m{share}",
        f"deviation  {_side(outcome['deviation_m']['signed'])} at the end, "
        f"{outcome['deviation_m']['mean']:.3f} m on average",
        f"turned     {outcome['yaw_change_deg'] + 0.0:.1f} degrees{of_ideal}",
    ]


def _side(signed_m: float) -> str:
    return f"{abs(signed_m):.3f} m to the {'left' if signed_m > 0 else 'right'}"


def _clipped_line(outcome: dict[str, Any]) -> str:
    """Return how often the guard had to limit the walk, and what to do about it."""
    clipped = outcome["clipped_ticks"]
    if not clipped:
        return "guard      let every command pass"
    return f"guard      clipped {clipped} commands of the walk: too fast for the joints, see hexctl check"


def in_words(counts: Mapping[str, int]) -> str:
    """Return the counts above zero: `2 late, 1 stale owner`."""
    return ", ".join(f"{n} {name.replace('_', ' ')}" for name, n in counts.items() if n)


def link_in_words(counts: Mapping[str, int] | None) -> str:
    """Return what became of the messages to and from a servo board; empty where there is none."""
    if not counts:
        return ""
    troubles = in_words({name: n for name, n in counts.items() if name != "received"})
    return f"{counts.get('received', 0)} messages came; {troubles or 'none lost'}"
