"""The outcome of a run as text and a table."""

import shlex
from typing import Any

from rich.console import RenderableType

from hexctl.cli.render.tables import label_table
from hexctl.cli.render.words import link_in_words, why_in_words
from hexctl.wire.links import CLEAR_COMMAND

#: Misses of a self-rotation up to this are usual.
NOTED_MISS_DEG = 0.15

#: The true deviation of a simulation is told where the measured one is further off than this.
NOTED_ERROR_M = 0.02


def summary(outcome: dict[str, Any], clear: str = CLEAR_COMMAND) -> list[RenderableType]:
    """Outcome of a run, the object of `hexctl run --json`, as text and a table.

    `clear` is the command that ends a stop of the robot.
    """
    where = f"in world {outcome['world']}" if outcome["world"] else f"on {outcome['backend']}"
    failed = f", leg {outcome['failed_leg']} {outcome['failure']}" if outcome["failed_leg"] else ""
    failed += "".join(f", leg {leg} {how}" for leg, how in outcome.get("further_failures", {}).items())
    link = link_in_words(outcome["servo_link"])
    rows = [
        ("gait", _gait_text(outcome["gait"])),
        *_posture_rows(outcome["gait"]),
        *_distance_rows(outcome),
        *_failure_rows(outcome),
        ("status", _status(outcome, clear)),
        ("guard", _clipped(outcome["clipped_ticks"]) + _doubted(outcome.get("positions_doubted", 0))),
        *([("link", link)] if link else []),
        (
            "ticks",
            f"{outcome['ticks']}, {outcome['overruns']} overruns, {outcome['realtime_factor']:g} x real time",
        ),
    ]
    recording = outcome["recording"]
    if recording:
        rows.append(("recording", recording))
    view = [f"look at it with: hexctl view {shlex.quote(recording)}"] if recording else []
    return [f"{outcome['robot']} {where}{failed}", label_table(rows), *view]


def _failure_rows(outcome: dict[str, Any]) -> list[tuple[str, str]]:
    """What failed on the way, and what the controller noticed of it."""
    from hexctl.robot.failure_event import NoticedFailure

    noticed = [str(NoticedFailure.from_dict(each)) for each in outcome.get("noticed", ())]
    events = outcome.get("events", ())
    rows = [
        (word, ", ".join(texts))
        for word, colons in (("failed", True), ("healed", False))
        if (texts := [event for event in events if (":" in event) is colons])  # 5:limp@8 fails, 5@20 heals
    ]
    if events or noticed:
        rows.append(("noticed", "; ".join(noticed) or "nothing"))
    return rows


def _status(outcome: dict[str, Any], clear: str) -> str:
    """How the walk ended, and why."""
    why = why_in_words(outcome["stopped"], outcome.get("standstill_s"), clear=clear)
    return f"{outcome['status']}{why}{_cause(outcome.get('cause'))}"


def _cause(cause: str | None) -> str:
    """Likely cause of a walk without progress, in words."""
    from hexctl.control.assessment.cause import CAUSES

    return "" if cause is None else f" ({cause}: {CAUSES.get(cause, '')})"


def _gait_text(gait: dict[str, Any]) -> str:
    """Name, slots and code, each once."""
    slots = ",".join(str(slot) for slot in gait["slots"])
    named = gait["name"] not in (slots, str(gait["code"]))
    code = "" if gait["code"] is None else f", code {gait['code']}"
    then = "".join(f", then {change}" for change in gait.get("then", []))
    slots = f"{'a crawl, ' if gait.get('phases') else ''}slots {slots}"
    return (f"{gait['name']} ({slots}{code})" if named else f"{slots}{code}") + then


def _posture_rows(gait: dict[str, Any]) -> list[tuple[str, str]]:
    """A row for how the body stood and the feet swung, where that was not as in the paper."""
    from hexctl.gait.gait import SWING_SHARE
    from hexctl.gait.posture import Posture
    from hexctl.record.summary import posture_in_words

    text = posture_in_words(Posture(**gait.get("posture", {})), gait.get("swing_share", SWING_SHARE))
    return [("posture", text)] if text else []


def _distance_rows(outcome: dict[str, Any]) -> list[tuple[str, str]]:
    """Distance, deviation and turn, as far as the robot knows them."""
    duration, held = f"{outcome['duration_s']:.1f} s", _hold_rows(outcome)
    ideal, turn = outcome["ideal_distance_m"], outcome["ideal_yaw_change_deg"]
    turned_deg = outcome["yaw_change_deg"]
    of_turn = f" of {turn:.1f} asked for" if turn else ""
    turned = [] if turned_deg is None else [("turned", f"{turned_deg + 0.0:.1f} degrees{of_turn}")]
    if outcome["distance_m"] is None:
        return [("walked", f"{duration}; {_why_no_distance(outcome)}"), *_true_rows(outcome), *turned, *held]
    distance, side = f"{outcome['distance_m']:.3f} m", _side(outcome["deviation_m"]["signed"])
    if turn and ideal:
        return [("walked", f"{duration} in an arc, ended {distance} ahead and {side}"), *turned, *held]
    missed = _turn_missed(outcome.get("turn_miss_deg"))
    share = f" of {ideal:.3f} m ideal ({100 * outcome['distance_m'] / ideal:.0f} %)" if ideal else ""
    mean = f"{outcome['deviation_m']['mean']:.3f} m on average"
    rows = [("walked", f"{duration}, {distance}{share}"), ("deviation", f"{side} at the end, {mean}")]
    return [*rows, *_true_rows(outcome), *turned, *missed, *held, *_cost(outcome)]


def _why_no_distance(outcome: dict[str, Any]) -> str:
    """Why a walk has no distance, in words."""
    if not outcome["duration_s"]:
        return "it never set out"
    if outcome["status"] == "no_progress":
        return "its position did not change"
    hold = outcome.get("hold")
    if hold == "line" or (hold == "none" and not outcome.get("hold_caveat")):
        return "its position was not measured at the end"
    return "its position is not known"


def _true_rows(outcome: dict[str, Any]) -> list[tuple[str, str]]:
    """A row for where a simulated robot truly was, if its sensors told otherwise or nothing."""
    true, measured = outcome.get("true_deviation_m"), outcome["deviation_m"]
    if not true or any(true.get(name) is None for name in ("signed", "mean")):
        return []
    said = f"{_side(true['signed'])} at the end, {true['mean']:.3f} m on average"
    if outcome["distance_m"] is None:
        return [("truly", said)]
    if max(abs(true[name] - measured[name]) for name in ("signed", "mean")) <= NOTED_ERROR_M:
        return []
    return [("truly", f"{said}: the sensors told otherwise")]


def _hold_rows(outcome: dict[str, Any]) -> list[tuple[str, str]]:
    """What the walk held by feedback, and what kept it from that; empty for a robot that never set out."""
    from hexctl.record.summary import held_in_words

    return [("held", held_in_words(outcome))] if outcome["duration_s"] else []


def _cost(outcome: dict[str, Any]) -> list[tuple[str, str]]:
    """A row for what the walk cost, where the robot tells its torques."""
    cost, energy_j = outcome.get("cost_of_transport"), outcome.get("energy_j")
    if cost is None or energy_j is None:
        return []
    return [("cost", f"{energy_j:.1f} J of mechanical energy, {cost:.2f} per weight and metre")]


def _turn_missed(miss_deg: float | None) -> list[tuple[str, str]]:
    """A row for a self-rotation that missed its goal by more than it should."""
    if miss_deg is None or abs(miss_deg) <= NOTED_MISS_DEG:
        return []
    return [("turn", f"the self-rotation missed its goal by {miss_deg:+.1f} degrees")]


def _side(signed_m: float) -> str:
    return f"{abs(signed_m):.3f} m to the {'left' if signed_m > 0 else 'right'}"


def _clipped(clipped: int) -> str:
    """How often the guard limited the walk, and what to do about it."""
    if not clipped:
        return "let every command pass"
    return f"clipped {clipped} commands of the walk: too fast for the joints, see hexctl check"


def _doubted(positions: int) -> str:
    """How many positions the robot cannot have had."""
    return f"; {positions} positions jumped and were not believed" if positions else ""
