"""Commands that a session proposes: walk its gait, continue it, begin another one."""

import math
import shlex
from collections.abc import Mapping
from dataclasses import fields

from hexctl.adapt.optimizer import TRIM_DIGITS
from hexctl.adapt.runner import LegFailedError
from hexctl.adapt.sessions.search_session import Session
from hexctl.adapt.sessions.session_spec import SessionSpec
from hexctl.adapt.sessions.walk_records import BaselineRecord, TrialRecord, WalkRecord
from hexctl.cli.console import FAULT, code_of_stop
from hexctl.control.telemetry_watch import hot_servos
from hexctl.errors import HexctlError
from hexctl.gait.gait import NAMED_SLOTS
from hexctl.robot.failure_grammar import option_of
from hexctl.runs.run_spec import RunSpec


def resume_command(session: Session) -> str:
    """Command that continues a session of this user."""
    trust = " --trust" if session.spec.foreign_parts else ""
    return f"hexctl adapt --resume {shlex.quote(session.name)}{trust}"


def stricter_command(spec: SessionSpec) -> str:
    """Command that begins a session with half the target."""
    asked, failure = option_of(spec.broken)
    options = {
        asked.replace("_", "-"): failure,
        "objective": None if spec.objective == "final" else spec.objective,
        **_where(spec),
        "target": None if spec.target_m is None else f"{spec.target_m / 2:g}",
    }
    return shlex.join(["hexctl", "adapt", *_as_words(options)])


def after_stop(spec: SessionSpec, error: HexctlError) -> str:
    """Steps for a stop before the search continues, as the beginning of a list; empty for a fault.

    The local guard's stop does not outlast the session.
    """
    reason = getattr(error, "reason", None)
    if reason is None or code_of_stop(reason) == FAULT:
        return ""
    if isinstance(error, LegFailedError) and hot_servos(reason):
        return "let its servo cool down, "
    if isinstance(error, LegFailedError):
        legs = ",".join(map(str, sorted({spec.broken.leg, *error.legs})))
        return f"repair the leg, or walk without it (hexctl run --failed-leg {legs}), "
    at = f" --connect {shlex.quote(spec.connect)}" if spec.connect else ""
    at += f" --keys {shlex.quote(str(spec.credentials))}" if spec.credentials else ""
    clear = f"clear the stop (hexctl estop --clear{at}), " if spec.backend == "zenoh" else ""
    return f"stand it up, {clear}" if reason == "fell" else clear


def gait_option(walk: TrialRecord | BaselineRecord) -> str:
    """Name of a fixed gait, else its code or slots, because `auto` depends on hold and turn."""
    if isinstance(walk, BaselineRecord) and walk.gait in NAMED_SLOTS:
        return walk.gait
    return ",".join(map(str, walk.slots)) if walk.code is None else str(walk.code)


def walk_command(session: Session, walk: TrialRecord | BaselineRecord) -> str:
    """Command that walks as a trial did."""
    spec = session.spec
    asked, failure = option_of(spec.broken)
    chosen = {
        asked.replace("_", "-"): failure,
        "gait": gait_option(walk) if walk.stride is None else f"best:{session.name}",
        **_course_options(session, walk),
    }
    options = {
        **chosen,
        "body-raise": f"{spec.body_raise:g}" if spec.body_raise and walk.stride is None else None,
        "self-rotation": spec.self_rotation,
        **_where(spec),
    }
    return shlex.join(["hexctl", "run", *_as_words(options), *(["--insecure"] if spec.insecure else [])])


def _where(spec: SessionSpec) -> dict[str, object]:
    """Options of robot, world and connection that differ from their defaults."""
    usual = {field.name: field.default for field in fields(SessionSpec)}
    names = ("backend", "robot", "world", "seed", "connect", "link")
    unusual = {name: getattr(spec, name) for name in names if getattr(spec, name) != usual[name]}
    return {**unusual, "keys": spec.credentials}


def _as_words(options: Mapping[str, object]) -> list[str]:
    given = ((f"--{name}", str(value)) for name, value in options.items() if value is not None)
    return [word for pair in given for word in pair]


def _course_options(session: Session, walk: WalkRecord) -> dict[str, str]:
    """Hold, heading and trim of a walk, which are rounded to what is printed here."""
    heading, hold = f"{math.degrees(session.spec.heading_rad):g}", session.spec.hold
    trim_deg, turn_deg_s = (walk.outcome[name] for name in ("trim_deg", "turn_trim_deg_s"))
    options: dict[str, str] = {} if hold == RunSpec().hold else {"hold": hold}
    if trim_deg is not None:
        options |= {"trim": f"{trim_deg:.{TRIM_DIGITS}f}"}
    if turn_deg_s is not None:
        options |= {"turn-trim": f"{turn_deg_s:.{TRIM_DIGITS}f}"}
    return options if heading == "0" else {**options, "heading": heading}
