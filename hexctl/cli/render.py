"""Results as text and tables."""

import shlex
from collections.abc import Iterable, Mapping
from typing import Any

from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

#: Width of the labels of a summary.
LABEL_WIDTH = 9

#: Where to look after a stop that the user did not request.
HINTS = {
    "state": "the robot's state did not come, or not in time; is the robot still there?",
    "expired": "commands did not reach the robot in time; a busy computer, or a bad link",
    "pose lost": "the robot no longer says where it is",
    "estop": "hexctl estop --clear when it may move again",
    "fault": "see to it, then hexctl estop --clear",
}


def plain_table(*columns: str) -> Table:
    """Table without lines; the first column and one without a name are to the left, the others right."""
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), show_header=any(columns))
    for number, column in enumerate(columns):
        left = number == 0 or not column
        table.add_column(Text(column, style="bold"), justify="left" if left else "right", no_wrap=True)
    return table


def label_table(rows: Iterable[tuple[str, str]]) -> Table:
    """Two columns, labels and texts; a long text is wrapped beside its label."""
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), show_header=False)
    table.add_column(no_wrap=True, min_width=LABEL_WIDTH)
    table.add_column(overflow="fold")
    for label, text in rows:
        table.add_row(Text(label), Text(text))
    return table


def summary(outcome: dict[str, Any]) -> list[RenderableType]:
    """Outcome of a run, the object of `hexctl run --json`, as text and a table."""
    where = f"in world {outcome['world']}" if outcome["world"] else f"on {outcome['backend']}"
    failed = f", leg {outcome['failed_leg']} {outcome['failure']}" if outcome["failed_leg"] else ""
    failed += "".join(f", leg {leg} {how}" for leg, how in outcome.get("further_failures", {}).items())
    link = link_in_words(outcome["servo_link"])
    rows = [
        ("gait", _gait_text(outcome["gait"])),
        *_posture_rows(outcome["gait"]),
        *_distance_rows(outcome),
        *_failure_rows(outcome),
        ("status", outcome["status"] + why_in_words(outcome["stopped"]) + _cause(outcome.get("cause"))),
        ("guard", _clipped(outcome["clipped_ticks"])),
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


def why_in_words(stopped: str | None) -> str:
    """Why a robot was stopped, and where to look, behind what it is told of; nothing for None."""
    if stopped is None:
        return ""
    hint = HINTS.get(stopped.partition(":")[0])
    return f" ({stopped})" if hint is None else f" ({stopped}): {hint}"


#: Misses of a self-rotation up to this are usual.
NOTED_MISS_DEG = 0.15


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


#: The true deviation of a simulation is told where the measured one is further off than this.
NOTED_ERROR_M = 0.02


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


def in_words(counts: Mapping[str, int]) -> str:
    """Counts above zero: `2 late, 1 stale owner`."""
    return ", ".join(f"{n} {name.replace('_', ' ')}" for name, n in counts.items() if n)


def link_in_words(counts: Mapping[str, int] | None) -> str:
    """Messages to and from a servo board, received and lost; empty without a board."""
    if not counts:
        return ""
    troubles = in_words({name: n for name, n in counts.items() if name != "received"})
    if "received" not in counts:  # a bus counts what it asks for
        return troubles or "nothing yet"
    return f"{counts['received']} messages came; {troubles or 'none lost'}"
