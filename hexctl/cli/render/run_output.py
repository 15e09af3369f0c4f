"""The outcome of a run as text and a table."""

import math
import shlex
from typing import Any

from rich.console import RenderableType
from rich.text import Text

from hexctl.cli.render.stop_reasons import clearing_in_words, link_in_words, why_in_words
from hexctl.cli.render.tables import label_table
from hexctl.control.planning.leg_sets import MOST_LOST
from hexctl.control.scoring.walk_quality import RAMP_TICKS
from hexctl.control.telemetry_watch import hot_servos
from hexctl.control.trial_plan import PLAIN_TASK
from hexctl.gait.gait import AUTO, SWING_SHARE, is_crawl
from hexctl.robot.failure import loses_leg
from hexctl.wire.links import CLEAR_COMMAND

#: Share of its ideal distance that a robot on six good legs walks at least, and a missed line.
USUAL_SHARE, MISSED_M = 0.9, 0.05

#: Misses of a self-rotation up to this are usual.
NOTED_MISS_DEG = 2.0

#: Share of inferences with an action at a limit that is printed.
SATURATED_SHARE = 0.2

#: Lengths below this are printed in cm.
ONE_M = 1.0

#: Colours of a status; any other one is red.
STATUS_STYLES = {"ok": "bold green", "no_progress": "bold yellow"}


def summary(outcome: dict[str, Any], clear: str | None = CLEAR_COMMAND) -> list[RenderableType]:
    """Outcome of a run (`hexctl run --json`) as a table of about ten rows, and the next command."""
    where = f"in world {outcome['world']}" if outcome["world"] else f"on {outcome['backend']}"
    failed = f", leg {outcome['failed_leg']} {outcome['failure']}" if outcome["failed_leg"] else ""
    failed += "".join(f", leg {leg} {how}" for leg, how in outcome.get("further_failures", {}).items())
    rows = [
        *_sensor_rows(outcome),
        *(
            _policy_rows(outcome["policy"])
            if outcome.get("policy")
            else [("gait", _gait_text(outcome["gait"]))]
        ),
        *([("task", task)] if (task := outcome.get("task")) not in (None, PLAIN_TASK) else []),
        *(_posture_rows(outcome["gait"]) if outcome["gait"] else []),
        *_distance_rows(outcome),
        *_failure_rows(outcome),
        *([("warnings", "; ".join(outcome["warnings"]))] if outcome["warnings"] else []),
        ("status", _status(outcome, clear)),
        *_trouble_rows(outcome),
        *([("recording", outcome["recording"])] if outcome["recording"] else []),
    ]
    return [f"{outcome['robot']} {where}{failed}", label_table(rows), *_next_command(outcome, clear)]


def _sensor_rows(outcome: dict[str, Any]) -> list[tuple[str, str]]:
    """What a simulated robot measured, if that is not everything, or not what the real one measures."""
    from hexctl.robot.sensors import SENSORS, in_words

    if outcome["backend"] != "sim":
        return []
    if lacking := outcome.get("sensors_simulated_only"):
        return [("measures", f"everything, also {in_words(lacking)}, which the robot lacks")]
    own = outcome.get("sensors", SENSORS)
    echoed = "" if "joint_positions" in own else "; joint angles are those commanded"
    return [("measures", f"{in_words(own)}{echoed}")] if len(own) < len(SENSORS) else []


def _policy_rows(policy: dict[str, Any]) -> list[tuple[str, str]]:
    forward, left, turn = policy["velocity_body"]
    parts = [
        f"{forward:g} m/s forward",
        *([f"{left:g} m/s left"] if left else []),
        *([f"turn {math.degrees(turn):.3g} degrees/s"] if turn else []),
    ]
    rows = [("policy", f"{policy['name']}, {', '.join(parts)}")]
    if policy["inferences"]:
        p50, p99, most = (policy["inference_us"][name] / 1000 for name in ("p50", "p99", "max"))
        rows += [("inference", f"{p50:.2g} ms median, {p99:.2g} ms 99th percentile, {most:.2g} ms maximum")]
    if often := [joint for joint, share in policy["saturated"].items() if share > SATURATED_SHARE]:
        rows += [
            ("limits", f"actions of {', '.join(often[:4])} are often at a limit; hexctl policy check FILE")
        ]
    return rows


def _next_command(outcome: dict[str, Any], clear: str | None) -> list[str]:
    if clearing := clearing_in_words(outcome["stopped"], clear=clear):
        return [f"next: {clearing}"]
    if hot := hot_servos(*outcome["warnings"], outcome["stopped"] or ""):
        return [f"next: let {hot} cool down before it walks again"]
    failed = (outcome["failed_leg"], *outcome.get("further_failures", ()))
    may_walk = outcome["failed_leg"] and len(failed) <= MOST_LOST
    ignored = _failed_legs_noticed(outcome) and outcome.get("options", {}).get("recovery") == "walk-on"
    if ignored or (outcome["status"] == "aborted" and _stopped_for_a_leg(outcome)):
        return ["next: the same with --recovery glide, which continues without the leg"]
    if may_walk and "gait" not in outcome.get("options", {}) and _is_slow(outcome):
        return [f"next: the same with --gait {AUTO}, the most stable gait for the other legs"]
    if may_walk and _misses_its_line(outcome):
        same = f"leg{', heading' if 'heading' in outcome.get('options', {}) else ''}, robot and world"
        return [f"next: hexctl adapt with the same {same}, which finds a gait that ends on the line"]
    if outcome["recording"]:
        return [f"next: hexctl view {shlex.quote(outcome['recording'])}"]
    robot = shlex.quote(str(outcome.get("options", {}).get("robot", outcome["robot"])))
    check = f"hexctl check {robot}{_flags(outcome)}"
    return [f"next: {check}"] if outcome["status"] == "no_progress" else []


def _flags(outcome: dict[str, Any]) -> str:
    """Options by which `hexctl check` checks the same walk."""
    options = outcome.get("options", {})
    degrees = {one: f"{math.degrees(float(options[one])):g}" for one in ("heading", "turn") if one in options}
    given = [one for one in ("gait", "heading", "turn", "pace", "amplitude", "height") if one in options]
    return "".join(f" --{one} {shlex.quote(str(degrees.get(one, options[one])))}" for one in given)


def _turn_missed(miss_deg: float | None) -> list[tuple[str, str]]:
    if miss_deg is None or abs(miss_deg) <= NOTED_MISS_DEG:
        return []
    return [("turn", f"the self-rotation missed its goal by {miss_deg:+.1f} degrees")]


def _is_slow(outcome: dict[str, Any]) -> bool:
    ideal_m, walked_m = outcome["ideal_distance_m"], outcome["distance_m"]
    slow = bool(ideal_m) and walked_m is not None and walked_m < USUAL_SHARE * ideal_m
    return outcome["status"] == "no_progress" or (outcome["status"] == "ok" and slow)


def _misses_its_line(outcome: dict[str, Any]) -> bool:
    off_m, straight = outcome["deviation_m"]["signed"], not outcome["ideal_yaw_change_deg"]
    return outcome["status"] == "ok" and straight and off_m is not None and abs(off_m) > MISSED_M


def _failed_legs_noticed(outcome: dict[str, Any]) -> list[dict[str, Any]]:
    return [each for each in outcome.get("noticed", ()) if loses_leg(each["kind"])]


def _stopped_for_a_leg(outcome: dict[str, Any]) -> bool:
    """Whether the recovery `stop` ended a walk for legs without which a robot can walk."""
    noticed = _failed_legs_noticed(outcome)
    failed = {each["leg"] for each in noticed} | {outcome["failed_leg"], *outcome.get("further_failures", ())}
    return bool(noticed) and noticed[-1]["did"] == "stopped" and len(failed - {None}) <= MOST_LOST


def _trouble_rows(outcome: dict[str, Any]) -> list[tuple[str, str]]:
    clipped, doubted = outcome["clipped_ticks"], outcome.get("positions_doubted", 0)
    recovered = outcome["status"] == "ok" and outcome.get("noticed")
    # A soft start scales the steps, which adds to the speed of the joints at any pace.
    short = clipped <= min(RAMP_TICKS, outcome["ticks"] / 2)
    count = f"{clipped} of {outcome['ticks']}" if short else f"{clipped}"
    advice = "" if recovered or short else ", too fast for the joints: lower --pace"
    guarded = [
        *([f"{count} commands clipped{advice}"] if clipped else []),
        *([f"{doubted} impossible joint angles ignored"] if doubted else []),
    ]
    link = outcome["servo_link"]
    lost = bool(link) and any(n for name, n in link.items() if name != "received")
    late = outcome["overruns"]
    return [
        *([("guard", "; ".join(guarded))] if guarded else []),
        *([("link", link_in_words(link))] if lost else []),
        *([("late", f"{late} of {outcome['ticks']} ticks")] if late else []),
    ]


def _failure_rows(outcome: dict[str, Any]) -> list[tuple[str, str]]:
    from hexctl.robot.failure import NoticedFailure

    noticed = [str(NoticedFailure.from_dict(each)) for each in outcome.get("noticed", ())]
    events = outcome.get("events", ())
    rows = [
        (word, ", ".join(texts))
        for word, colons in (("failed", True), ("healed", False))
        if (texts := [_event_text(event) for event in events if (":" in event) is colons])
    ]
    if events or noticed:
        rows.append(("detected", "; ".join(noticed) or "nothing"))
    return rows


def _event_text(event: str) -> str:
    """An event in words: `5:limp@8` fails, `5@20` heals."""
    what, _, at_s = event.partition("@")
    return f"leg {what.replace(':', ' ', 1)} at {at_s} s"


def _status(outcome: dict[str, Any], clear: str | None) -> Text:
    status, stopped = outcome["status"], outcome["stopped"]
    if (status, stopped) == ("aborted", "requested"):
        return Text("stopped by Ctrl-C", style="bold red")
    why = (
        f" ({stopped})"
        if clearing_in_words(stopped, clear=clear)
        else why_in_words(stopped, outcome.get("standstill_s"), clear=clear)
    )
    text = Text(status.replace("_", " "), style=STATUS_STYLES.get(status, "bold red"))
    return Text.assemble(text, f"{why}{_cause(outcome.get('cause'))}")


def _cause(cause: str | None) -> str:
    from hexctl.control.scoring.cause import CAUSES

    return "" if cause is None else f" ({cause}: {CAUSES.get(cause, '')})"


def _gait_text(gait: dict[str, Any]) -> str:
    slots = ",".join(str(slot) for slot in gait["slots"])
    named = gait["name"] not in (slots, str(gait["code"]))
    code = "" if gait["code"] is None else f", code {gait['code']}"
    then = "".join(f", then {change}" for change in gait.get("then", []))
    crawls = is_crawl(gait.get("phases"), gait.get("swing_share", SWING_SHARE))
    slots = f"{'a crawl, ' if crawls else ''}slots {slots}"
    return (f"{gait['name']} ({slots}{code})" if named else f"{slots}{code}") + then


def _posture_rows(gait: dict[str, Any]) -> list[tuple[str, str]]:
    from hexctl.gait.posture import Posture
    from hexctl.recording.trial_summary import posture_in_words

    text = posture_in_words(Posture(**gait.get("posture", {})), gait.get("swing_share", SWING_SHARE))
    return [("posture", text)] if text else []


def _distance_rows(outcome: dict[str, Any]) -> list[tuple[str, str]]:
    ideal, turn = outcome["ideal_distance_m"], outcome["ideal_yaw_change_deg"]
    turned_deg = outcome["yaw_change_deg"]
    of_turn = f", {100 * turned_deg / turn:.0f} % of ideal ({turn:.1f})" if turn and turned_deg else ""
    turned = [] if turned_deg is None else [("turned", f"{turned_deg:z.1f} degrees{of_turn}")]
    if turn and ideal:
        return [*_turn_rows(outcome), *turned, *_hold_rows(outcome)]
    moved = _turn_rows(outcome) if turn else _line_rows(outcome)
    missed = _turn_missed(outcome.get("turn_miss_deg"))
    return [*moved, *turned, *missed, *_hold_rows(outcome), *_cost(outcome)]


def _turn_rows(outcome: dict[str, Any]) -> list[tuple[str, str]]:
    if outcome["distance_m"] is None:
        return _unmeasured_rows(outcome)
    seconds, ahead_m, left_m = (
        f"{outcome['duration_s']:.1f} s",
        outcome["distance_m"],
        outcome["deviation_m"]["signed"],
    )
    if outcome["ideal_distance_m"]:
        return [("walked", f"{seconds} in an arc, ended {ahead_m:.2f} m ahead and {_side(left_m)}")]
    return [("walked", f"{seconds} on the spot, ended {_length(math.hypot(ahead_m, left_m))} from the start")]


def _line_rows(outcome: dict[str, Any]) -> list[tuple[str, str]]:
    if outcome["distance_m"] is None:
        return _unmeasured_rows(outcome)
    distance, ideal = outcome["distance_m"], outcome["ideal_distance_m"]
    share = (
        f"{100 * distance / ideal:.0f} % of ideal ({ideal:.2f} m without slip or soft start)" if ideal else ""
    )
    walked = f"{distance:.2f} m in {outcome['duration_s']:.1f} s{', ' if share else ''}{share}"
    return [("walked", walked), ("off line", _deviation(outcome["deviation_m"]))]


def _unmeasured_rows(outcome: dict[str, Any]) -> list[tuple[str, str]]:
    walked = f"{outcome['duration_s']:.1f} s; its position is not known"
    if outcome.get("true_distance_m") is not None:
        side = _side(outcome["true_deviation_m"]["signed"])
        walked += f"; in the simulation {outcome['true_distance_m']:.2f} m ahead, {side}"
    return [("walked", walked if outcome["duration_s"] else "it never set out")]


def _hold_rows(outcome: dict[str, Any]) -> list[tuple[str, str]]:
    """The hold of a walk and its disturbances; empty for a robot that never set out."""
    from hexctl.recording.trial_summary import hold_in_words

    return [("held", hold_in_words(outcome))] if outcome["duration_s"] else []


def _cost(outcome: dict[str, Any]) -> list[tuple[str, str]]:
    cost, energy_j = outcome.get("cost_of_transport"), outcome.get("energy_j")
    if cost is None or energy_j is None:
        return []
    return [("energy", f"{energy_j:.1f} J mechanical, cost of transport {cost:.2f}")]


def _deviation(deviation_m: dict[str, Any]) -> str:
    return f"{_side(deviation_m['signed'])} at the end, {_length(deviation_m['mean'])} on average"


def _side(signed_m: float) -> str:
    length = _length(abs(signed_m))
    return length if length == _length(0.0) else f"{length} to the {'left' if signed_m > 0 else 'right'}"


def _length(length_m: float) -> str:
    return f"{100 * length_m:.1f} cm" if length_m < ONE_M else f"{length_m:.2f} m"
