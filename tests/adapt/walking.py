"""Trials without a robot: a made-up landscape that the loop walks."""

import itertools
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from hexctl.adapt.objectives import OBJECTIVES
from hexctl.adapt.optimizer import Trim
from hexctl.adapt.runner import TrialRequest, WalkedTrial, WalkTrial
from hexctl.adapt.sessions.search_session import Session
from hexctl.adapt.sessions.session_spec import SessionSpec
from hexctl.adapt.sessions.store import SessionStore
from hexctl.adapt.sessions.walk_records import BaselineRecord, TrialRecord
from hexctl.adapt.space import GaitSpace
from hexctl.backends.clock import PERIOD_S
from hexctl.cli.render.session_summary import closing_parts
from hexctl.control.planning.top_speed import Stride
from hexctl.control.trial_result import Deviation, TrialResult
from hexctl.gait.foot_trajectory import RAMP_DURATION_S
from hexctl.gait.gait import NAMED_SLOTS
from tests.robots import shipped

SPEC = SessionSpec(failed_leg=5, optimizer="pso", budget=12, seed=3)


def result_of(deviation_m: float, status: str = "ok") -> TrialResult:
    """The result of a walk that ends so far to the left of the line."""
    path = np.linspace([0.0, 0.0], [4.0, deviation_m], 100)
    off = abs(deviation_m)
    return TrialResult(
        status=status,
        stopped="requested" if status == "aborted" else None,
        duration_s=30.0,
        turned_rad=0.0,
        distance_m=4.0,
        ideal_distance_m=4.455,
        deviation=Deviation(off, off / 2, off, deviation_m),
        yaw_change_rad=0.1,
        clipped_ticks=0,
        path_m=path,
    )


#: A walk of a robot that knows no pose.
UNSEEN = replace(
    result_of(0.0), distance_m=None, deviation=None, yaw_change_rad=None, path_m=np.zeros((0, 2))
)


def arc_of(drift: Trim, trim: Trim, *, gain: float = 1.0, status: str = "ok") -> TrialResult:
    """The result of a walk of 4 m along an arc, by its drift and its trim, whose turn has a gain."""
    times_s = PERIOD_S * np.arange(1, 1501)
    steps_m = 4.0 / 29.0 * PERIOD_S * np.minimum(times_s / RAMP_DURATION_S, 1.0)
    turned_rad = (drift.turn_rad_s + gain * trim.turn_rad_s) * (times_s - RAMP_DURATION_S / 2)
    direction_rad = drift.course_rad + trim.course_rad + turned_rad
    path_m = np.cumsum([steps_m * np.cos(direction_rad), steps_m * np.sin(direction_rad)], axis=1).T
    distance_m, signed_m = path_m[-1].tolist()
    off_m = np.abs(path_m[:, 1])
    return replace(
        result_of(signed_m, status),
        distance_m=distance_m,
        deviation=Deviation(abs(signed_m), float(off_m.mean()), float(off_m.max()), signed_m),
        path_m=path_m,
        trim_rad=trim.course_rad,
        turn_trim_rad_s=trim.turn_rad_s,
    )


def walked(result: float | TrialResult, margin_m: float | None = None) -> dict[str, Any]:
    """Fields of a stored walk by its result, or by how far to the left it ends."""
    result = result if isinstance(result, TrialResult) else result_of(result)
    return {
        "score": OBJECTIVES["final"](result),
        "outcome": result.to_dict(),
        "path_m": result.path_m[::10].tolist(),
        "recording": None,
        "margin_m": margin_m,
    }


def record(
    index: int, result: float | TrialResult = 0.2, margin_m: float | None = None, *, confirms: bool = False
) -> TrialRecord:
    """A trial of `SPEC`, by its result or by how far to the left it ends."""
    code = (index - 1) % 120 + 1
    slots = GaitSpace((SPEC.broken.leg,)).slots_of(code)
    return TrialRecord(index=index, code=code, slots=slots, confirms=confirms, **walked(result, margin_m))


def baseline_record(gait: str, result: float | TrialResult, margin_m: float | None = None) -> BaselineRecord:
    """A walk of the baseline; whatever its name, the gait is the tripod."""
    return BaselineRecord(gait=gait, code=None, slots=(1, 4, 1, 4, 1, 4), **walked(result, margin_m))


def stored_session(
    folder: Path,
    trial_m: float,
    optimizer: str = "random",
    stride: Stride | None = None,
    /,
    **baseline_m: float,
) -> str:
    """Name of a session of `ant` without leg 2 with one trial, of code 17, and walks of its baseline.

    All of them are told by where they end; `auto` is code 42. Which optimizer it had is a name alone.
    """
    space = GaitSpace((2,))
    spec = SessionSpec(failed_leg=2, optimizer=optimizer, robot_fingerprint=shipped().fingerprint)
    store = SessionStore(folder)
    session = store.create(spec)
    for gait, off_m in baseline_m.items():
        slots = NAMED_SLOTS.get(gait, space.slots_of(42))
        code = 42 if gait == "auto" else None
        store.add(session, BaselineRecord(gait=gait, code=code, slots=slots, **walked(off_m)))
    trial = TrialRecord(index=1, code=17, slots=space.slots_of(17), stride=stride, **walked(trial_m))
    store.add(session, trial, {})
    return session.name


class Landscape:
    """Walks gaits by a formula, and keeps their codes."""

    def __init__(self) -> None:
        self.walked: list[int] = []

    def __call__(self, request: TrialRequest) -> WalkedTrial:
        code = request.code
        self.walked.append(code)
        status = "no_progress" if code % 7 == 0 else "ok"
        return WalkedTrial(
            result=result_of((code - 60.3) / 40, status), recording=Path(f"trial-{request.index:03d}.rrd")
        )


def cut_off(walk: WalkTrial, after: int) -> WalkTrial:
    """Walks that are interrupted after a number of trials."""
    left = itertools.count(after, -1)
    return lambda request: walk(request) if next(left) > 0 else WalkedTrial(result=result_of(0.0, "aborted"))


def closing_lines(session: Session, ended: str | None) -> str:
    """Final summary of a session as plain text."""
    return "\n".join(map(str, closing_parts(session, ended)))
