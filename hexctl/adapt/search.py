"""From options to a checked session spec."""

import math
from collections.abc import Container
from dataclasses import fields, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, cast

from hexctl.adapt.adapt_options import AdaptOptions
from hexctl.adapt.measurement import Operator
from hexctl.adapt.objectives import OBJECTIVES, Objective, ObjectiveChoice, as_objective
from hexctl.adapt.optimizer import OptimizerChoice
from hexctl.adapt.optimizers.optimizer_registry import make_optimizer, name_of
from hexctl.adapt.optimizers.shipped import BAYES, NAMES, STRIDES, TRIM
from hexctl.adapt.prior.prior_choice import (
    DEFAULT_TARGET_M,
    Contradictions,
    choose_prior,
    refuse,
)
from hexctl.adapt.prior.prior_files import prior_folders
from hexctl.adapt.sessions.search_session import Session
from hexctl.adapt.sessions.session_spec import UNWATCHED, SessionSpec
from hexctl.adapt.sessions.store import RUNS
from hexctl.adapt.sessions.walk_records import BASELINE_GAITS
from hexctl.adapt.setting import Note, Setting, load_setting, log_note, start_note, with_known_uncertainty
from hexctl.adapt.space import GaitSpace
from hexctl.backends.base import LegServos
from hexctl.backends.registry import check_options, option_values
from hexctl.backends.sim.world import with_step
from hexctl.control.monitor.recovery import make_recovery
from hexctl.control.planning.static_stability import in_posture, usual_posture
from hexctl.control.scoring.uncertainty_store import CONFIRM_STEP_S
from hexctl.control.trial_plan import AUTO_ROTATION, suited_rotation
from hexctl.errors import InputError, UnusedError, argument, check_type
from hexctl.gait.foot_trajectory import RAMP_DURATION_S
from hexctl.robot.configs import shipped_text
from hexctl.robot.loader import load_robot

#: Objectives for which strides are searched, and holds of walks that are trimmed.
OF_STRIDES, OF_TRIM = ("speed", "cost"), ("heading", "none")

#: Packages that decide how trials end.
PACKAGES = ("hexctl", "mujoco", "numpy")

#: Shortest walk of which lean and steadiness are measured: its soft start and two cycles or so.
LEAST_S = RAMP_DURATION_S + 2.0


def new_spec(*, folder: Path = RUNS, note: Note = log_note, **asked: Any) -> SessionSpec:
    """Spec of a new session, checked before the session exists.

    Args:
        folder: of custom priors, and of the measured uncertainty of the simulation.
        note: called with the reason for a missing prior or uncertainty.
        asked: fields of `AdaptOptions`.

    Raises InputError for invalid input.
    """
    options = AdaptOptions(**asked)
    measure, free = as_objective(options.objective), options.optimizer is None
    spec = _with_target(_spec_of(options, measure), options.target)
    if free:
        spec = replace(spec, optimizer=_usual_optimizer(spec, strides=options.prior is None))
    _check_confirm(spec)
    _check_options(spec, measure)
    if spec.optimizer == TRIM:
        spec = _for_trim(spec)
    if spec.optimizer not in (BAYES, STRIDES, TRIM):
        make_optimizer(options.optimizer or spec.optimizer, GaitSpace((spec.broken.leg,)), spec.seed)
    spec, setting = _in_its_setting(spec, options.body_raise)
    if options.uncertainty_m is None:
        spec = with_known_uncertainty(spec, setting, folder, note)
    prior = None if options.prior is None else str(options.prior)
    if spec.optimizer == STRIDES:
        if prior not in (None, "none"):
            raise InputError(
                f"{argument('prior')}: got {prior} with {argument('optimizer')} {STRIDES}; allowed: none, or "
                f"{argument('optimizer')} {BAYES}"
            )
        return spec
    return choose_prior(spec, setting, prior, free=free, folders=prior_folders(folder), note=note)


def _in_its_setting(spec: SessionSpec, body_raise: float | None) -> tuple[SessionSpec, Setting]:
    """Spec with target and posture for its robot, and its loaded setting."""
    setting = load_setting(spec)
    start_note(spec, setting)  # refuses an arena that is too small
    if spec.target_m is None and spec.target_share is not None:
        spec = replace(spec, target_m=spec.target_share * setting.ideal_m)
    if body_raise is None:
        posture = "auto" if spec.optimizer == TRIM else usual_posture(spec.hold)
        setting = replace(setting, plan=in_posture(setting.robot, setting.plan, posture))
        spec = replace(spec, body_raise=setting.plan.gait.posture.body_raise)
    return spec, setting


def _spec_of(options: AdaptOptions, measure: Objective) -> SessionSpec:
    hold, credentials, home_m = options.hold or measure.hold, options.credentials, options.home_m
    # An operator's robot does not know where it is.
    held = "heading" if options.ask and hold == "auto" else hold
    robot = _named("robot", options.robot)
    world = None if options.world is None else _named("world", options.world)
    asked = {field.name: getattr(options, field.name) for field in fields(options)}
    return SessionSpec(
        **asked
        | {
            "robot": shipped_text("robots", robot),
            "robot_fingerprint": load_robot(robot).fingerprint,
            "world": _world_of(options.backend, world),
            "credentials": None if credentials is None else str(credentials),
            "optimizer": "random" if options.optimizer is None else name_of(options.optimizer),
            "objective": measure.name,
            "objective_label": "" if measure.name in OBJECTIVES else measure.label,
            "objective_unit": measure.unit,
            "hold": hold,
            "self_rotation": suited_rotation(options.self_rotation or AUTO_ROTATION, held, chosen_gait=True),
            "body_raise": options.body_raise or 0.0,
            "uncertainty_m": options.uncertainty_m or 0.0,
            "home_m": None if home_m is None else [float(value) for value in home_m],
            "prior": None,
            "recovery": options.recovery or UNWATCHED,
            "baseline_gaits": list(BASELINE_GAITS) if options.baseline else [],
            "versions": {package: version(package) for package in PACKAGES},
        }
    )


def _named(what: str, value: object) -> str | Path:
    """Stored form of a robot or a world; raises WrongTypeError unless it is a name or path."""
    check_type(value, (str, Path), what, f"the name or path of a {what} file, which the session stores")
    return cast(str | Path, value)


def _world_of(backend: str, world: Path | str | None) -> str | None:
    """World of a session, `flat` by default, None on a real robot."""
    if backend == "sim":
        return "flat" if world is None else shipped_text("worlds", world)
    if world is not None:
        raise UnusedError(
            f"{argument('world')}: got {world} with {argument('backend')} {backend}; allowed: with sim"
        )
    return None


def extended(session: Session, budget: int) -> SessionSpec:
    """Spec with another budget; raises InputError for one that is spent already."""
    walked = len(session.trials)
    if budget <= walked:
        raise InputError(
            f"{argument('budget')}: got {budget}, of which {walked} are walked; allowed: more than {walked}"
        )
    spec = replace(session.spec, budget=budget)
    _check_confirm(spec)
    return spec


def _check_confirm(spec: SessionSpec) -> None:
    if not 0 <= spec.confirm < spec.budget:
        raise InputError(
            f"{argument('confirm')}: got {spec.confirm}; allowed: 0 to less than the budget of {spec.budget}"
        )


def _with_target(spec: SessionSpec, target: float | str | None) -> SessionSpec:
    """Spec with a target given as a number, or as a share of a distance that is not known yet."""
    if target is None:
        return spec
    if spec.target_m is not None:
        raise InputError(f"target: got {target} and target_m {spec.target_m}; allowed: one of the two")
    text = str(target).strip()
    allowed = "a number above 0, or a share of the distance above 0 % up to 100 %, such as 1%"
    try:
        value = float(text.removesuffix("%"))
    except ValueError:
        raise InputError(f"{argument('target')}: got {target!r}; allowed: {allowed}") from None
    if not text.endswith("%"):
        return replace(spec, target=None, target_m=value)
    if not 0 < value <= 100:
        raise InputError(f"{argument('target')}: got {target}; allowed: {allowed}")
    if spec.objective_unit != "m":
        raise InputError(
            f"{argument('target')}: got {target} with the objective {spec.objective}, which is not in "
            f"metres; allowed: {f'a number, in {unit}' if (unit := spec.objective_unit) else 'a number'}"
        )
    return spec


def _usual_optimizer(spec: SessionSpec, *, strides: bool) -> str:
    """Trim for straight walks without a held line, strides for fast or cheap walks along one, else codes."""
    if spec.early_stop or spec.count_repeats or spec.worth_m is not None:  # only searches of codes have them
        return spec.optimizer
    if spec.trim != "off" and spec.objective in ("final", "progress") and spec.hold in OF_TRIM:
        return TRIM
    return STRIDES if strides and spec.objective in OF_STRIDES and spec.hold != "none" else spec.optimizer


def _for_trim(spec: SessionSpec) -> SessionSpec:
    """Spec of a search that trims, with a fine time step and a target."""
    if spec.world is not None:
        spec = replace(spec, world=with_step(spec.world, CONFIRM_STEP_S))
    known = spec.target_m is not None or spec.target_share is not None
    return spec if known else replace(spec, target_m=DEFAULT_TARGET_M)


def _check_options(spec: SessionSpec, objective: Objective) -> None:
    make_recovery(spec.recovery)
    linked = option_values(spec, but=("robot", "world", "failures", "seed"))
    if ":" not in spec.backend or any(linked.values()):
        check_options(spec.backend, **linked)
    refuse(_of_optimizer(spec))
    refuse(_contradictions(spec, objective))


def _of_optimizer(spec: SessionSpec) -> Contradictions:
    """Contradictions of the optimizer and other options."""
    trims, strides = spec.optimizer == TRIM, spec.optimizer == STRIDES
    named, held = argument("objective"), argument("hold")
    got = f"{argument('optimizer')}: got {spec.optimizer} with"
    yield trims and spec.trim == "off", f"{got} {argument('trim')} off", "without"
    # First, as it may be what chose the hold.
    metres = "with one in metres, such as final"
    yield trims and spec.objective_unit != "m", f"{got} {named} {spec.objective}", metres
    yaw = "with heading, or none for a robot without a yaw"
    yield trims and spec.hold not in OF_TRIM, f"{got} {held} {spec.hold}", yaw
    steered = spec.objective in OF_STRIDES and spec.hold != "none"
    along = f"with {' or '.join(OF_STRIDES)} along a held line"
    yield strides and not steered, f"{got} {named} {spec.objective} and {held} {spec.hold}", along
    for name in ("count_repeats", "early_stop", "worth_m"):
        given = getattr(spec, name) is not None and getattr(spec, name) is not False  # 0 is given, too
        yield (trims or strides) and given, f"{got} {argument(name)}", "without"


def _contradictions(spec: SessionSpec, objective: Objective) -> Contradictions:
    """Whether options contradict one another, what was got, and what is allowed instead."""
    named, sim, ask = argument("objective"), f"{argument('backend')} sim", argument("ask")
    staying = ask if spec.ask else argument("arena_m")
    stays = spec.arena_m is not None or spec.ask
    got = f"uncertainty_m: got {spec.uncertainty_m} with {argument('backend')} {spec.backend}"
    yield bool(spec.uncertainty_m) and not spec.simulated, got, "with sim, whose own it is"
    uncertain = bool(spec.uncertainty_m) and spec.objective != "final"
    got = f"uncertainty_m: got {spec.uncertainty_m} with {named} {spec.objective}"
    yield uncertain, got, "with final, whose end of a walk it is of"
    short = objective.name in ("tilt", "steadiness") and spec.duration_s < LEAST_S
    got = f"{argument('duration_s')}: got {spec.duration_s:g} with {named} {objective.name}"
    yield short, f"{got}, which is measured after the soft start", f"{LEAST_S:g} or more"
    got = f"{staying}: used with {sim}, where each trial begins at the same place"
    yield spec.simulated and stays, got, "with a robot that stays where a walk ends"
    home, nowhere = spec.home_m, "with it, whose middle it is"
    yield home is not None and spec.arena_m is None, f"home_m: got {home} without arena_m", nowhere
    point = home is None or (len(home) == 2 and all(map(math.isfinite, home)))
    yield not point, f"home_m: got {home}", "x and y in m"
    got = f"{argument('cool_down_c')}: used with {sim}, whose servos do not heat up"
    yield spec.cool_down_c is not None and spec.simulated, got, "with a real robot"
    aimed = stays and bool(spec.heading_rad) and spec.self_rotation != "none"
    got = f"{argument('heading_rad')}: got {math.degrees(spec.heading_rad):g} with {staying}"
    seen = f"with {argument('self_rotation')} none, as seen from the body"
    yield aimed, f"{got}, where the line is wherever it fits", seen
    located = "with a robot that knows where it is"
    yield spec.ask and spec.arena_m is not None, f"{argument('arena_m')}: used with {ask}", located
    yield spec.ask and spec.early_stop, f"{argument('early_stop')}: used with {ask}", located
    got = f"{argument('hold')}: got line with {ask}, where the robot does not know its position"
    yield spec.ask and spec.hold == "line", got, "auto, heading, none"
    usable = [name for name, shipped in OBJECTIVES.items() if not shipped.needs_course]
    enough = f"{' or '.join(usable)}, for which the end of a walk is enough"
    yield spec.ask and objective.needs_course, f"{named}: got {spec.objective} with {ask}", enough


def check_parts(
    spec: SessionSpec,
    servos: LegServos | None,
    optimizer: OptimizerChoice | None,
    objective: ObjectiveChoice | None,
    operator: Operator | None,
) -> None:
    """Raise InputError for given parts of a session that contradict its spec."""
    if spec.ask and operator is None:
        raise InputError(
            f"operator: got none with {argument('ask')}; allowed: one who places the robot and measures"
        )
    if operator is not None and not spec.ask:
        raise InputError(f"operator: got one without {argument('ask')}; allowed: with a spec that has ask")
    if servos is not None and spec.simulated:
        raise InputError(
            f"servos: got some with {argument('backend')} sim; allowed: with the name of their class"
        )
    if optimizer is not None:
        _check_name("optimizer", name_of(optimizer), spec.optimizer, NAMES)
    if objective is not None:
        _check_name("objective", as_objective(objective).name, spec.objective, OBJECTIVES)


def _check_name(part: str, got: str, named: str, shipped: Container[str]) -> None:
    """Raise InputError for another part than the spec names; a custom one may have moved."""
    if got != named and (got in shipped or named in shipped):
        raise InputError(f"{part}: got {got} for a session with {named}; allowed: {named}")
