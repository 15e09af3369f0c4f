"""What `hexctl adapt` does with its options: check, search trial by trial, report."""

import json
import math
import re
import time
from contextlib import ExitStack
from dataclasses import replace
from typing import Any

import typer

from hexctl.adapt.loop import AdaptLoop
from hexctl.adapt.objectives import OBJECTIVES, make_objective
from hexctl.adapt.overview import view_runs
from hexctl.adapt.prior.prior import PriorKey
from hexctl.adapt.registry import BAYES, make_optimizer
from hexctl.adapt.runner import ResetFreeRunner, RobotStoppedError, TrialRunner
from hexctl.adapt.search import make_search, serving
from hexctl.adapt.session import Session, SessionSpec
from hexctl.adapt.space import GaitSpace
from hexctl.adapt.store import SessionStore
from hexctl.backends.sim.world import World, load_world
from hexctl.cli.adaptrobot import (
    arena_of,
    as_it_stands,
    at_home,
    check_robot_options,
    code_of_stop,
    connected,
    how_to_go_on,
    note_of,
)
from hexctl.cli.console import (
    ABORTED,
    DONE,
    INTERRUPTED,
    RUNS,
    StopOnInterrupt,
    note_no_window,
    print_note,
    print_result,
)
from hexctl.cli.operator import Prompt
from hexctl.cli.prioring import with_prior
from hexctl.cli.table import ENDS, SessionTable, closing_lines
from hexctl.control.guard import Guard
from hexctl.control.plan import TrialPlan
from hexctl.control.turning import check_plan
from hexctl.errors import HexctlError, InputError, RecordingError, RobotFaultError
from hexctl.gait.encoding import Slots
from hexctl.gait.gait import make_gait
from hexctl.record.live import LiveView, open_window
from hexctl.robot.failure import parse_failure
from hexctl.robot.loader import load_meshes, load_robot
from hexctl.robot.model import Robot

MAX_BUDGET = 100_000


def new_spec(**options: Any) -> SessionSpec:
    """Return the spec of a new session from the options that were given; None means the default.

    Raises InputError for anything that is not allowed, before a session exists.
    """
    if options["failed_leg"] is None:
        raise InputError("--failed-leg: is missing; allowed: 1..6 (or --resume SESSION)")
    parse_failure(options["failed_leg"], options["failure"] or "locked")
    simulated = options["backend"] in (None, "sim")
    if not simulated and options["world"] is not None:
        raise InputError(
            f"--world: got {options['world']} with --backend {options['backend']}; allowed: with sim"
        )
    given = {name: value for name, value in options.items() if value is not None}
    wanted_prior = given.pop("prior", None)
    if not simulated:
        given["world"] = None
    robot = load_robot(given.get("robot", "ant"))
    spec = SessionSpec(**given, robot_fingerprint=robot.fingerprint)
    _check_numbers(spec)
    objective = make_objective(spec.objective)
    if spec.objective not in OBJECTIVES:
        spec = replace(spec, objective_label=objective.label, objective_unit=objective.unit)
    check_robot_options(spec)
    if spec.optimizer != BAYES:
        make_optimizer(spec.optimizer, GaitSpace((spec.failed_leg,)), spec.seed)
    _robot, _world, plan = _walk_parts(spec)
    note_of(spec, robot, plan)
    return with_prior(
        spec,
        PriorKey.of(robot, plan),
        serves=serving(robot, plan),
        optimizer=options["optimizer"],
        wanted=wanted_prior,
        note=print_note,
    )


def check_resumed_alone(resume: str, **options: Any) -> None:
    """Raise InputError for options that a resumed session would silently not follow."""
    given = [
        f"--{re.sub('_(m|s|deg)$', '', name).replace('_', '-').replace('credentials', 'keys')}"
        for name, value in options.items()
        if value is not None
    ]
    if given:
        raise InputError(
            f"--resume: got {', '.join(given)} too, but a session goes on as it was begun; "
            f"allowed: --resume {resume} alone, or with --budget"
        )


def _check_numbers(spec: SessionSpec) -> None:
    if not 1 <= spec.budget <= MAX_BUDGET:
        raise InputError(f"--budget: got {spec.budget}; allowed: 1..{MAX_BUDGET}")
    if not 0 <= spec.confirm < spec.budget:
        raise InputError(
            f"--confirm: got {spec.confirm}; allowed: 0 to less than the budget of {spec.budget}"
        )
    if spec.seed < 0:
        raise InputError(f"--seed: got {spec.seed}; allowed: 0 or more")
    if spec.target_m is not None and not (math.isfinite(spec.target_m) and spec.target_m > 0):
        raise InputError(f"--target: got {spec.target_m}; allowed: above 0 m")
    if not math.isfinite(spec.heading_deg):
        raise InputError(f"--heading: got {spec.heading_deg}; allowed: any finite number")


def execute(
    spec: SessionSpec | None,
    *,
    resume: str | None,
    budget: int | None,
    record: bool,
    view: bool,
    as_json: bool,
) -> int:
    """Run a new session, or continue one, with another budget if there is one, and return the exit code."""
    if view and not record:
        raise InputError("--no-record: got --view too; allowed: one or the other")
    if spec is not None and record:
        load_meshes(spec.robot)  # refused before a session exists
    began_s = time.perf_counter()
    with ExitStack() as stack:
        store = stack.enter_context(SessionStore(RUNS))
        interrupt = stack.enter_context(StopOnInterrupt())
        try:
            session, servos = _begin(spec, resume, budget, store, stack, interrupt)
        except RobotStoppedError as error:
            print_note(f"hexctl: {error}")
            return code_of_stop(error)
        if session is None:
            print_note("hexctl: interrupted before a session began")
            return INTERRUPTED
        walked_before = len(session.trials)
        table = stack.enter_context(SessionTable(session, quiet=as_json))
        live = open_window(note_no_window) if view and servos is not None else None
        if live is not None:
            stack.enter_context(live)
        ended, trouble = _adapt(session, store, table, interrupt, servos, live, record=record)
    outcome = {**session.as_json(), "ended": ended, "wall_s": round(time.perf_counter() - began_s, 3)}
    print_result(json.dumps(outcome) if as_json else closing_lines(session, ended))
    if budget is not None and ended in ENDS and len(session.trials) == walked_before:
        print_note(f"hexctl: nothing to walk, {ENDS[ended]}; another target takes a new session")
    # After the result: a picture that fails must not cost it.
    _write_overview(session, store, record=record)
    if trouble is not None:
        print_note(f"hexctl: {trouble}; nothing is lost: {how_to_go_on(session.spec, session.name, trouble)}")
        return code_of_stop(trouble)
    if view and session.trials and ended != "interrupted":
        _show(session.name)
    if ended == "interrupted":
        return INTERRUPTED
    return DONE if session.best is not None else ABORTED


def _show(name: str) -> None:
    """Open a session; where there is no screen, that is no reason for the search to have failed."""
    try:
        view_runs([name], RUNS)
    except RecordingError as error:
        print_note(f"hexctl: {error}")


def _begin(
    spec: SessionSpec | None,
    resume: str | None,
    budget: int | None,
    store: SessionStore,
    stack: ExitStack,
    interrupt: StopOnInterrupt,
) -> tuple[Session | None, Guard | None]:
    """Return the session, new or continued and held, and its robot, connected; no session if interrupted.

    A session to be continued is held before its robot is touched, a new one made when its robot is there.
    """
    session = None
    if spec is None:
        stack.enter_context(store.held(store.load(resume or "").name))
        # As it stands now that nobody else adds to it.
        session = store.load(resume or "")
        if budget is not None:
            session.spec = _extended(session, budget)
        spec = session.spec
    robot, world, plan = _walk_parts(spec)
    note = note_of(spec, robot, plan)
    if note is not None:
        print_note(f"hexctl: {note}")
    servos = stack.enter_context(connected(spec, robot, plan))
    if session is None:
        spec = as_it_stands(at_home(spec, servos), robot, world, plan, servos, interrupt.requested)
        if interrupt.requested():
            return None, servos
        session = store.create(spec)
        stack.enter_context(store.held(session.name))
    return session, servos


def _extended(session: Session, budget: int) -> SessionSpec:
    """Return a session's spec with another budget; raises InputError for one that is walked already."""
    walked = len(session.trials)
    if budget <= walked:
        raise InputError(f"--budget: got {budget}, of which {walked} are walked; allowed: more than {walked}")
    spec = replace(session.spec, budget=budget)
    _check_numbers(spec)
    return spec


def _adapt(
    session: Session,
    store: SessionStore,
    table: SessionTable,
    interrupt: StopOnInterrupt,
    servos: Guard | None,
    live: LiveView | None,
    *,
    record: bool,
) -> tuple[str, RobotFaultError | RecordingError | None]:
    """Return why the search ended, and what is wrong with the robot or its recordings if it was that."""
    spec = session.spec
    robot, world, plan = _walk_parts(spec)

    def plan_for(slots: Slots) -> TrialPlan:
        return _with_slots(plan, slots)

    optimizer = make_search(spec, robot, plan)
    walker = TrialRunner(
        spec=spec,
        robot=robot,
        world=world,
        plan_for=plan_for,
        folder=store.folder_of(session.name) if record else None,
        stop_requested=interrupt.requested,
        live=live,
        meshes=load_meshes(spec.robot) if record else {},
    )
    walk = walker.walk
    if servos is not None:
        operator = Prompt(spec, interrupt.requested) if spec.ask else None
        walk = ResetFreeRunner(runner=walker, servos=servos, arena=arena_of(spec), operator=operator).walk
    loop = AdaptLoop(session, store, optimizer, walk, stop_requested=interrupt.requested, on_trial=table.add)
    try:
        return loop.run(), None
    except (RobotFaultError, RecordingError) as error:
        return "stopped", error


def _walk_parts(spec: SessionSpec) -> tuple[Robot, World | None, TrialPlan]:
    """Return robot, world and the plan with the demo gait, refused if it cannot be walked."""
    robot = load_robot(spec.robot)
    if robot.fingerprint != spec.robot_fingerprint:
        raise InputError(
            f"session: robot {spec.robot} is not the one that it began with; "
            "allowed: the same robot file, or a new session"
        )
    world = load_world(spec.world) if spec.world is not None else None
    plan = TrialPlan(
        gait=make_gait(robot, "demo"),
        heading_rad=math.radians(spec.heading_deg),
        duration_s=spec.duration_s,
        failure=parse_failure(spec.failed_leg, spec.failure),
        self_rotation=spec.self_rotation,
    )
    check_plan(robot, plan)
    return robot, world, plan


def _with_slots(plan: TrialPlan, slots: Slots) -> TrialPlan:
    return replace(plan, gait=replace(plan.gait, slots=slots))


def _write_overview(session: Session, store: SessionStore, *, record: bool) -> None:
    """Write the session's overview beside its trials; `hexctl view` makes it too, so trouble is a warning."""
    if not record or not session.trials:
        return
    from hexctl.adapt.overview import write_overview

    try:
        write_overview(session, store.folder_of(session.name))
    except HexctlError as error:
        typer.echo(f"hexctl: no overview: {error}", err=True)
