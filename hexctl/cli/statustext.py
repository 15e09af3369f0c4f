"""What `hexctl status` shows a person, from what a robot says of itself."""

from collections.abc import Mapping
from typing import Any

from rich.table import Table
from rich.text import Text

from hexctl.cli.render import in_words, link_in_words

Status = Mapping[str, Any]

#: What each stop asks for; every other one waits for somebody who has looked at the robot.
LIFTED_BY = {
    "expired": "the next controller lifts it",
    "fault": "see to it, then hexctl estop --clear",
    "state": "see to it, then hexctl estop --clear",
}
CLEARED = "hexctl estop --clear lifts it"

POSTURES = {
    "idle": "waiting for its first command",
    "commanded": "commanded",
    "holding": "holding its pose",
    "sitting": "sitting down: no commands any more",
    "limp": "sitting, joints limp",
}


def status_table(statuses: list[dict[str, Any]]) -> Table:
    """Return what robots say of themselves as two columns, an empty line between robots."""
    table = Table(show_header=False, box=None, pad_edge=False)
    table.add_column(no_wrap=True)
    table.add_column()
    for number, status in enumerate(statuses):
        if number:
            table.add_row("", "")
        for name, text in status_rows(status):
            table.add_row(name, Text(text))
    return table


def status_rows(status: Status) -> list[tuple[str, str]]:
    """Return the lines about one robot, the most pressing first; what a robot does not say is left out."""
    rows = [
        ("robot", _robot(status)),
        ("stopped", _stopped(status.get("stopped"))),
        ("posture", POSTURES.get(status.get("posture", ""), "")),
        ("controller", _controller(status)),
        ("fault", status.get("fault") or ""),
        ("battery", _battery(status)),
        ("joints", _joints(status)),
        ("position", "known" if status.get("pose") else "not known, so no trial can be scored"),
        ("commands", _commands(status.get("commands", {}))),
        ("guard", f"{status.get('clipped', 0)} targets limited to what the joints can do"),
        ("dropped", _dropped(status)),
        ("servo link", link_in_words(status.get("servo_link"))),
        ("loop", f"{status.get('ticks', 0)} ticks of 20 ms, {status.get('overruns', 0)} skipped"),
        ("link", _link(status)),
    ]
    return [(name, text) for name, text in rows if text]


def _robot(status: Status) -> str:
    words = f"{status.get('robot', '?')} ({status.get('backend', '?')})"
    simulated = status.get("simulated")
    if not isinstance(simulated, Mapping):
        return words
    return f"{words}, world {simulated.get('world')}, failure {simulated.get('failure')}"


def _stopped(reason: str | None) -> str:
    if reason is None:
        return "no"
    kind, colon, detail = reason.partition(":")
    return f"{kind.upper()}{colon}{detail}; {LIFTED_BY.get(kind, CLEARED)}"


def _controller(status: Status) -> str:
    owner, since_s = status.get("controller"), status.get("controller_since_s")
    return "nobody" if owner is None else f"{owner}, for {since_s} s"


def _battery(status: Status) -> str:
    volts, share = status.get("battery_v"), status.get("battery_share")
    words = [f"{volts:.1f} V" if volts is not None else "", f"{share:.0%}" if share is not None else ""]
    return ", ".join(filter(None, words)) or "does not say"


def _joints(status: Status) -> str:
    kind, age_s = status.get("joints"), status.get("state_age_s")
    if kind is None:
        return "nothing heard of them yet"
    meaning = "measured" if kind == "measured" else "echoed: what was sent comes back, nobody measures"
    return meaning if age_s is None else f"{meaning}, {1e3 * age_s:.0f} ms old"


def _commands(counts: Mapping[str, int]) -> str:
    dropped = in_words({name: n for name, n in counts.items() if name != "accepted"})
    return f"{counts.get('accepted', 0)} obeyed; {dropped or 'none dropped'}"


def _dropped(status: Status) -> str:
    return in_words({**status.get("malformed", {}), "leases_refused": status.get("leases_refused", 0)})


def _link(status: Status) -> str:
    guarded = "certificates" if status.get("secured") else "no certificates"
    if status.get("insecure"):
        guarded = "INSECURE: no certificates beyond that computer"
    return f"{status.get('endpoint', '?')}, {guarded}"
