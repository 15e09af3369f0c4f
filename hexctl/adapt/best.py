"""The best known gaits for a walk: `hexctl run --gait best`."""

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast

from hexctl.adapt.prior.prior import open_prior
from hexctl.adapt.prior.prior_files import find_prior, prior_folders
from hexctl.adapt.prior.samples import ranked_codes
from hexctl.adapt.sessions.search_session import Session
from hexctl.adapt.sessions.store import RUNS, StoreError, list_sessions, load_session
from hexctl.adapt.sessions.walk_records import BaselineRecord
from hexctl.adapt.space import GaitSpace
from hexctl.backends.base import as_robot
from hexctl.control.planning.static_stability import in_posture, usual_posture
from hexctl.control.planning.top_speed import STRIDE, Stride
from hexctl.control.trial_plan import AUTO_ROTATION, GaitChange
from hexctl.control.trial_result import TrialResult
from hexctl.errors import InputError, argument
from hexctl.gait.encoding import Slots
from hexctl.gait.gait import NAMED_SLOTS, Gait, make_gait, names_best
from hexctl.gait.posture import Posture
from hexctl.robot.failure import Failure
from hexctl.robot.model import Robot
from hexctl.runs.run_spec import RunSpec, name_and_time
from hexctl.runs.walk_plan import plan_walk


@dataclass(frozen=True, slots=True, kw_only=True)
class BestGait:
    """The best known gaits for a walk.

    Attributes:
        spec: of the walk, with gait and posture; of a session also its self-rotation and trim. With a prior
            the self-rotation is unchanged. For a gait to change to, only the gait.
        source: gaits and their origin, for people.
    """

    spec: RunSpec
    source: str


def best_gait(spec: RunSpec, folder: Path | str = RUNS) -> BestGait:
    """The best gait for a walk whose spec has the gait `best` or `best:SESSION`, or changes to one.

    The first matching prior gives the fastest gait, or the straightest of open-loop walks; a session gives
    its recommendation (`Session.best_walk`). `folder` has sessions and custom priors.

    Raises InputError for other gaits, a walk without a failed leg, and if no prior or session matches.
    """
    if not spec.asks_for_best:
        raise InputError(f"{argument('gait')}: got {spec.gait_text}; allowed: best or best:SESSION")
    sources = []
    if names_best(spec.gait):
        first = _best_of(spec, folder)
        spec = first.spec
        sources.append(first.source)
    then = list(spec.then)
    for index, name in enumerate(spec.names_then):
        if names_best(name):
            text = str(then[index])
            at_s = name_and_time(text)[1]
            try:  # without the trim and turn of a session
                found = _best_of(replace(spec, gait=name), folder, trimmed=False)
            except InputError as error:
                raise InputError(f"{argument('then')}: got {text!r} ({error})") from error
            sources.append(f"from {at_s:g} s on {found.source}")
            gait = found.spec.gait  # with the stride of a session, otherwise slots
            then[index] = (
                GaitChange(gait=gait, at_s=at_s)
                if isinstance(gait, Gait)
                else f"{found.spec.gait_text}@{at_s:g}"
            )
    return BestGait(spec=replace(spec, then=tuple(then)), source="; ".join(sources))


def _best_of(spec: RunSpec, folder: Path | str, *, trimmed: bool = True) -> BestGait:
    session = str(spec.gait).partition(":")[2].strip()
    known = load_session(session, folder) if session else None
    if not spec.failures:
        raise InputError(
            f"{argument('gait')}: got {spec.gait} with six good legs; allowed: with a failed leg; "
            "auto is the gait that stands safest"
        )
    if len(spec.failures) > 1:
        raise InputError(
            f"{argument('gait')}: got {spec.gait} with failed legs "
            f"{', '.join(str(one.leg) for one in spec.failures)}; allowed: with one; auto needs no prior"
        )
    robot, failure = as_robot(spec.robot), spec.failures[0]
    if known is not None:
        return _of_session(spec, robot, failure, known, trimmed=trimmed)
    return _of_prior(spec, robot, failure, Path(folder))


def _of_prior(spec: RunSpec, robot: Robot, failure: Failure, folder: Path) -> BestGait:
    if spec.turn_rate_rad_s is not None:
        raise InputError(f"{argument('gait')}: got best with a turn; allowed: straight, or auto")
    plan = plan_walk(replace(spec, gait="demo", chosen_gait=True, fast=False, then=(), feet="planned"), robot)
    if spec.body_raise is None:
        plan = in_posture(robot, plan, usual_posture(spec.hold))
    found = find_prior(robot, plan, prior_folders(folder), any_duration=True)
    session = _newest_session(robot, failure, folder)
    if found.path is None:
        raise InputError(
            f"{argument('gait')}: got best, and there is no prior for such walks ({found.reason}); allowed: "
            f"auto, which needs none, or best:{session or 'SESSION'}"
        )
    code = ranked_codes(open_prior(found.path), robot, failure.leg)[0]
    slots, body_raise = GaitSpace((failure.leg,)).slots_of(code), plan.gait.posture.body_raise
    walk = replace(spec, gait=slots, chosen_gait=True, body_raise=body_raise)
    searched = f"; the last search for this leg: best:{session}" if session else ""
    return BestGait(spec=walk, source=f"gait {code}, the best by the prior {found.path.name}{searched}")


def _newest_session(robot: Robot, failure: Failure, folder: Path) -> str | None:
    try:
        sessions = list_sessions(folder, on_damage=lambda _: None)
    except StoreError:  # a session is only a hint, and the gait is that of a prior
        return None
    for session in reversed(sessions):
        fits = (session.spec.robot_fingerprint, session.spec.broken) == (robot.fingerprint, failure)
        if fits and session.best_walk is not None:
            return session.name
    return None


def _of_session(
    spec: RunSpec, robot: Robot, failure: Failure, session: Session, *, trimmed: bool
) -> BestGait:
    own, best, what = session.spec, session.best_walk, f"{argument('gait')}: got best:{session.name}"
    if own.robot_fingerprint != robot.fingerprint:
        raise InputError(f"{what}, a session of {own.robot}; allowed: of {robot.name} as it is described now")
    if (own.broken.leg, str(own.broken)) != (failure.leg, str(failure)):
        raise InputError(
            f"{what}, a session with leg {own.broken.leg} {own.broken}; allowed: with leg {failure.leg} "
            f"{failure}"
        )
    if best is None:
        raise InputError(f"{what}, which has no valid walk; allowed: another session, or auto")
    rotation = own.self_rotation if spec.self_rotation == AUTO_ROTATION else spec.self_rotation
    body_raise = own.body_raise if spec.body_raise is None else spec.body_raise
    gait: str | Slots = best.slots
    if isinstance(best, BaselineRecord):
        gait = best.gait if best.gait in NAMED_SLOTS else best.slots  # the tripod is no permutation
        source = f"gait {best.gait}, as good as any trial of the session {session.name}"
    else:
        source = f"gait {best.code}, trial {best.index} of the session {session.name}"
    walk = replace(spec, gait=gait, chosen_gait=True, body_raise=body_raise, self_rotation=rotation)
    if best.stride is not None:
        walk = _with_stride(walk, robot, best.stride, failure)
        source += f", at {best.stride.pace_hz:g} Hz"
    found = BestGait(spec=walk, source=source)
    return _with_trim(found, best.result) if trimmed else found


def _with_stride(spec: RunSpec, robot: Robot, stride: Stride, failure: Failure) -> RunSpec:
    """A walk with the stride of a trial, except for what its own options say."""
    own = {name: getattr(spec, name) for name in STRIDE if getattr(spec, name) is not None}
    gait = make_gait(robot, cast(Slots, spec.gait), height=spec.height)
    gait = replace(gait, posture=Posture(body_raise=spec.body_raise or 0.0))
    return replace(
        spec,
        gait=replace(stride, **own).applied(gait, (failure.leg,)),
        pace_hz=None,
        amplitude=None,
        swing_share=None,
        height=None,
        body_raise=None,
    )


def _with_trim(found: BestGait, walk: TrialResult) -> BestGait:
    """A walk with the trim that a walk of its gait had, if both hold the same, unless it has its own."""
    spec, turn_rad_s = found.spec, walk.turn_trim_rad_s
    if walk.trim_rad is None or walk.hold != spec.hold or spec.trim_rad is not None:
        return found
    if spec.turn_rate_rad_s is not None or spec.turn_trim_rad_s is not None:
        return found
    text = f"{found.source}, with its trim of {math.degrees(walk.trim_rad):.2f} degrees"
    if turn_rad_s is not None:
        text += f" and {math.degrees(turn_rad_s):.3f} degrees/s"
    return BestGait(spec=replace(spec, trim_rad=walk.trim_rad, turn_trim_rad_s=turn_rad_s), source=text)
