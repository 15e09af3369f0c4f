"""`hexctl status`: state of the robots on a link."""

import math
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hexctl.cli.console import StopOnInterrupt, note_refusal, print_result
from hexctl.cli.shared_options import JsonOption
from hexctl.cli.signature import with_options
from hexctl.control.stop_reason import MEANINGS
from hexctl.errors import InputError, printable
from hexctl.wire.connection_diagnosis import RefusalWatch
from hexctl.wire.links import LinkOptions, Role, load_link

if TYPE_CHECKING:
    from hexctl.cli.render.tables import PlainTable
    from hexctl.client.remote import RemoteRobots

Status = Mapping[str, Any]

#: How each stop is cleared, with {} for the command; every other one needs an operator's inspection.
CLEARED_BY = {
    "expired": "the next controller clears it",
    "fault": "remove the cause, then {}",
    "state": "remove the cause, then {}",
}
CLEARED = "{} clears it"

WATCH_PERIOD_S = 0.25

POSTURES = {
    "idle": "waiting for a command",
    "commanded": "commanded",
    "holding": "holding its pose",
    "sitting": "sitting down: commands have stopped",
    "limp": "sitting, joints limp",
    "unreached": "not known: its servos cannot be reached",
}


@with_options(LinkOptions)
def status(
    place: dict[str, Any],
    watch: Annotated[bool, typer.Option("--watch", help="Keep showing it, until Ctrl-C.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Show who commands a robot on the network, why it is stopped, and which messages were dropped."""
    from hexctl.client.remote import remote_robots

    if watch and as_json:
        raise InputError("--watch: got --json too; allowed: one or the other")
    link = load_link(**place)
    with RefusalWatch(link.endpoint, note_refusal), remote_robots(link, Role.VIEWER) as robots:
        statuses = robots.await_statuses()
        if watch:
            _watch(robots)
        elif as_json:
            print_result(statuses[0])
        else:
            print_result(status_table(statuses, robots.link.clear_command))


def _watch(robots: "RemoteRobots") -> None:
    from rich.console import Console
    from rich.live import Live

    console = Console(markup=False, emoji=False)
    with StopOnInterrupt() as interrupt, ExitStack() as stack:
        live = stack.enter_context(Live(console=console, auto_refresh=False)) if console.is_terminal else None
        while not interrupt.requested():
            statuses = robots.statuses()
            shown = status_table(statuses, robots.link.clear_command) if statuses else "the robot is silent"
            if live is not None:
                live.update(shown, refresh=True)
            elif not print_result(shown):
                return
            time.sleep(WATCH_PERIOD_S)


def status_table(statuses: list[dict[str, Any]], clear: str) -> "PlainTable":
    """Statuses of robots as two columns, an empty line between robots; `clear` clears their stops."""
    from hexctl.cli.render.tables import label_table

    blocks = [status_rows(status, clear) for status in statuses]
    return label_table([row for block in blocks for row in (("", ""), *block)][1:])


def status_rows(status: Status, clear: str) -> list[tuple[str, str]]:
    """Lines about one robot, the most urgent first; `clear` is the command for its stop."""
    from hexctl.cli.render.stop_reasons import link_in_words

    lines: tuple[tuple[str, Callable[[Status], str]], ...] = (
        ("robot", _robot),
        ("served by", _served_by),
        ("stopped", lambda told: _stopped(told, clear)),
        ("posture", lambda told: POSTURES.get(told.get("posture", ""), "")),
        ("controller", _controller),
        ("fault", lambda told: told.get("fault") or ""),
        ("battery", _battery),
        ("servos", _servos),
        ("joints", _joints),
        ("position", lambda told: "known" if told.get("pose") else "not known, so no trial can be scored"),
        ("commands", lambda told: _commands(told.get("commands", {}))),
        ("guard", _guard),
        ("dropped", _dropped),
        ("servo link", lambda told: link_in_words(told.get("servo_link"))),
        ("loop", _loop),
        ("link", _link),
        ("ROS", lambda told: _ros(told.get("ros"))),
    )
    rows = [(name, _line(make, status)) for name, make in lines]
    return [(name, text) for name, text in rows if text]


def _line(make: Callable[[Status], str], status: Status) -> str:
    """A malformed value affects only its own line."""
    try:
        return printable(str(make(status)))
    except (AttributeError, LookupError, TypeError, ValueError, OverflowError):
        return "not readable by this version of hexctl"


def _robot(status: Status) -> str:
    words = f"{status.get('robot', '?')} ({status.get('backend', '?')})"
    simulated = status.get("simulated")
    if not isinstance(simulated, Mapping):
        return words
    return f"{words}, world {simulated.get('world')}, failure {simulated.get('failure')}"


def _served_by(status: Status) -> str:
    from hexctl.wire.description import RobotIdentity

    return RobotIdentity.of_answer(status).started_by


def _stopped(status: Status, clear: str) -> str:
    reason = status.get("stopped")
    if reason is None:
        return f"no{_cleared_in_words(status.get('cleared'))}"
    kind, colon, detail = reason.partition(":")
    if kind == "fault" and detail and status.get("fault") is None:
        over = "the fault is over" if status.get("servos") is None else "they answer again"
        return f"FAULT:{detail}; {over}: {clear}"
    which = _stop_in_words(status.get("stop"), stays=kind != "expired")
    meaning = f": {MEANINGS[kind]}" if kind in MEANINGS and not colon else ""
    return f"{kind.upper()}{colon}{detail}{meaning}{which}; {CLEARED_BY.get(kind, CLEARED).format(clear)}"


def _stop_in_words(stop: object, *, stays: bool) -> str:
    """Id, requester and time of a stop; not for silence, which the next controller lifts."""
    if not isinstance(stop, Mapping):
        return ""
    by = f", asked for by {stop['by']}" if stop.get("by") else ""
    kept = ", not kept" if stays and not stop.get("kept") else ""
    return f" ({stop.get('id')}, {stop.get('since_s')} s ago{by}{kept})"


def _cleared_in_words(cleared: object) -> str:
    """The last cleared stop and who cleared it; empty without one."""
    if not isinstance(cleared, Mapping):
        return ""
    return f" ({cleared.get('reason')} was cleared by {cleared.get('by')}, {cleared.get('since_s')} s ago)"


def _controller(status: Status) -> str:
    owner, since_s = status.get("controller"), status.get("controller_since_s")
    return "none" if owner is None else f"{owner}, for {since_s} s"


def _ros(ros: Mapping[str, Any] | None) -> str:
    if not ros:
        return ""
    router = (
        f"router {ros.get('router')}" if ros.get("connected") else ros.get("trouble") or "not connected yet"
    )
    counts = f"{ros.get('commands', 0)} commands, {ros.get('malformed', 0)} malformed"
    counts += f", {ros['late']} late by their stamp" if ros.get("late") else ""
    return f"{router}; {counts if ros.get('drive') else 'ROS may stop the robot, and not move it'}"


def _battery(status: Status) -> str:
    volts, share = status.get("battery_v"), status.get("battery_share")
    words = [f"{volts:.1f} V" if volts is not None else "", f"{share:.0%}" if share is not None else ""]
    return ", ".join(filter(None, words)) or "not reported"


def _servos(status: Status) -> str:
    from hexctl.types import JOINT_NAMES, ServoReadings

    try:
        readings = ServoReadings.from_json(status["servos"])
    except (KeyError, TypeError, ValueError):
        return ""
    words, joint = [], readings.hottest_joint
    if joint is not None:
        words.append(f"up to {readings.temperatures_c[joint]:.0f} C ({JOINT_NAMES[joint]})")
    volts = [one for one in readings.voltages_v.tolist() if math.isfinite(one)]
    if volts:
        words.append(f"{min(volts):.1f} to {max(volts):.1f} V")
    return ", ".join(words)


def _joints(status: Status) -> str:
    kind, age_s = status.get("joints"), status.get("state_age_s")
    if kind is None:
        return "no state received yet"
    meaning = "measured" if kind == "measured" else "echoed targets, not measured"
    return meaning if age_s is None else f"{meaning}, {1e3 * age_s:.0f} ms old"


def _commands(counts: Mapping[str, int]) -> str:
    from hexctl.cli.render.stop_reasons import in_words

    dropped = in_words({name: n for name, n in counts.items() if name != "accepted"})
    return f"{counts.get('accepted', 0)} executed; {dropped or 'none dropped'}"


def _guard(status: Status) -> str:
    from hexctl.cli.render.stop_reasons import counted

    limited = counted(status.get("clipped", 0), "targets limited to what the joints can do")
    return f"{limited}, by the robot's own guard, behind the controller's"


def _loop(status: Status) -> str:
    from hexctl.cli.render.stop_reasons import counted

    return f"{counted(status.get('ticks', 0), 'ticks of 20 ms')}, {status.get('overruns', 0)} skipped"


def _dropped(status: Status) -> str:
    from hexctl.cli.render.stop_reasons import in_words

    names = ("leases_refused", "late_poses")
    return in_words({**status.get("malformed", {}), **{name: status.get(name, 0) for name in names}})


def _link(status: Status) -> str:
    guarded = "certificates" if status.get("secured") else "no certificates"
    if status.get("insecure"):
        guarded = "INSECURE: no certificates beyond that computer"
    return f"{status.get('endpoint', '?')}, {guarded}"
