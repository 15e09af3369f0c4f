"""The robot of `hexctl adapt`, where it is one that stays between trials: options, connecting, advice."""

import math
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

from hexctl.adapt.arena import Arena, check_radius
from hexctl.adapt.objectives import OBJECTIVES, make_objective
from hexctl.adapt.runner import RobotStoppedError, await_ready
from hexctl.adapt.search import knows_stances
from hexctl.adapt.session import SessionSpec
from hexctl.adapt.stance import connected_deflection_rad, simulated_deflection_rad
from hexctl.backends.base import connection_notes
from hexctl.backends.clock import request_realtime_priority
from hexctl.backends.registry import BackendOptions, check_options, make_servos
from hexctl.backends.sim.world import World
from hexctl.cli.console import ABORTED, FAULT, FAULTS, print_note
from hexctl.cli.operator import check_answerable
from hexctl.control.guard import Guard
from hexctl.control.plan import TrialPlan
from hexctl.control.result import progress_floor_m
from hexctl.control.trial import StopRequested
from hexctl.errors import HexctlError, InputError, RobotFaultError
from hexctl.gait.gait import ideal_speed_m_s
from hexctl.robot.loader import load_robot_file
from hexctl.robot.model import Robot


def check_robot_options(spec: SessionSpec) -> None:
    """Raise InputError for options that do not belong to the session's robot or contradict one another."""
    check_options(
        spec.backend,
        connect=spec.connect,
        credentials=spec.credentials,
        insecure=spec.insecure,
        link=spec.link,
    )
    if spec.simulated and (spec.arena_m is not None or spec.ask):
        raise InputError(
            f"--{'ask' if spec.ask else 'arena'}: got it with --backend sim, where each trial begins at the "
            "same place; allowed: with a robot that stays where a walk ends"
        )
    if (spec.arena_m is not None or spec.ask) and spec.heading_deg and spec.self_rotation != "none":
        raise InputError(
            f"--heading: got {spec.heading_deg:g} with --{'ask' if spec.ask else 'arena'}, where the line is "
            "wherever it fits; allowed: with --self-rotation none, as seen from the body"
        )
    if spec.ask:
        _check_asking(spec)


def _check_asking(spec: SessionSpec) -> None:
    if spec.arena_m is not None:
        raise InputError("--arena: got it with --ask; allowed: with a robot that knows where it is")
    if spec.early_stop:
        raise InputError("--early-stop: got it with --ask; allowed: with a robot that knows where it is")
    if make_objective(spec.objective).needs_course:
        usable = [name for name, objective in OBJECTIVES.items() if not objective.needs_course]
        raise InputError(
            f"--objective: got {spec.objective} with --ask; allowed: {' or '.join(usable)}, "
            "for which the end of a walk is enough"
        )
    check_answerable()


def note_of(spec: SessionSpec, robot: Robot, plan: TrialPlan) -> str | None:
    """Return what a person should know before the robot moves, or None.

    Raises InputError for an arena that is too small.
    """
    if spec.arena_m is not None:
        speed_m_s = ideal_speed_m_s(robot, plan.gait, plan.motion(0.0))
        least_m = progress_floor_m(robot, plan, plan.duration_s)
        return check_radius(spec.arena_m, ideal_m=speed_m_s * plan.duration_s, least_m=least_m)
    if spec.simulated or spec.ask:
        return None
    return (
        "each trial begins where the last one ended, so the robot will wander; --arena RADIUS keeps it near"
    )


@contextmanager
def connected(spec: SessionSpec, robot: Robot, plan: TrialPlan) -> Iterator[Guard | None]:
    """Keep the robot of a session connected; None where each trial makes a simulation of its own.

    Raises RobotFaultError for a robot that cannot be reached, is stopped or cannot say where it is and must.
    """
    if spec.simulated:
        yield None
        return
    request_realtime_priority()
    options = BackendOptions(
        robot=robot,
        failure=plan.failure,
        seed=spec.seed,
        robot_file=load_robot_file(spec.robot),
        connect=spec.connect,
        credentials=Path(spec.credentials) if spec.credentials is not None else None,
        insecure=spec.insecure,
        link=spec.link,
    )
    robot_there = make_servos(spec.backend, options)
    servos = Guard(robot_there)
    try:
        servos.connect()
        for note in connection_notes(robot_there, plan.failure):
            print_note(f"hexctl: {note}")
        yield servos
    finally:
        # The result comes after the robot was let go: a link that fails at that must not cost it.
        with suppress(RobotFaultError):
            servos.close()


def at_home(spec: SessionSpec, servos: Guard | None) -> SessionSpec:
    """Return the spec of a session that begins where the robot is now.

    Raises RobotStoppedError for a robot that is stopped, RobotFaultError for one that cannot say where it is
    and must.
    """
    if servos is None or spec.ask:
        return spec
    with _nothing_begun(spec):
        position = await_ready(servos).base_position_world
    if spec.arena_m is None or position is None:
        return spec
    return replace(spec, home_m=[float(position[0]), float(position[1])])


def as_it_stands(
    spec: SessionSpec,
    robot: Robot,
    world: World | None,
    plan: TrialPlan,
    servos: Guard | None,
    stop_requested: StopRequested,
) -> SessionSpec:
    """Return the spec of a session that knows how its robot stands, where that tells its optimizer anything.

    A connected robot stands up for that. Not where a person puts it down: it then moves only when that person
    says so, and by then the first gait is chosen.
    Raises RobotStoppedError for a robot that is stopped meanwhile, RobotFaultError for one that has gone.
    """
    if spec.ask or not knows_stances(spec):
        return spec
    if servos is None:
        sag_rad = simulated_deflection_rad(robot, world, plan, spec.seed)
    else:
        with _nothing_begun(spec):
            sag_rad = connected_deflection_rad(servos, plan, stop_requested)
    if sag_rad is None:
        if not stop_requested():
            print_note("hexctl: how the robot stands is not known (joints not measured, or not at rest)")
        return spec
    return replace(spec, sag_rad=[None if math.isnan(angle) else angle for angle in sag_rad.tolist()])


@contextmanager
def _nothing_begun(spec: SessionSpec) -> Iterator[None]:
    """Say of a robot that is stopped what to do before there is a session; raises RobotStoppedError again."""
    try:
        yield
    except RobotStoppedError as error:
        advice = ", ".join([*_clearing(spec, error), "begin again"])
        raise RobotStoppedError(f"{error}; {advice}", error.reason) from error


def arena_of(spec: SessionSpec) -> Arena | None:
    """Return the arena of a session, if it has one."""
    if spec.arena_m is None or spec.home_m is None:
        return None
    return Arena(home_m=(spec.home_m[0], spec.home_m[1]), radius_m=spec.arena_m)


def code_of_stop(error: HexctlError) -> int:
    """Return the exit code of a session that its robot, or a full disk, ended."""
    reason = error.reason.partition(":")[0] if isinstance(error, RobotStoppedError) else "fault"
    return FAULT if reason in FAULTS else ABORTED


def how_to_go_on(spec: SessionSpec, name: str, error: HexctlError) -> str:
    """Return what to do before a session that something ended goes on."""
    return ", ".join([*_clearing(spec, error), f"go on with: hexctl adapt --resume {name}"])


def _clearing(spec: SessionSpec, error: HexctlError) -> list[str]:
    """Return what a stop wants done; this end's own guard begins anew with the next session."""
    if not isinstance(error, RobotStoppedError) or code_of_stop(error) == FAULT:
        return []
    at = f" --connect {spec.connect}" if spec.connect else ""
    clear = [f"clear the stop (hexctl estop --clear{at})"] if spec.backend == "zenoh" else []
    return ["stand it up", *clear] if error.reason == "fell" else clear
