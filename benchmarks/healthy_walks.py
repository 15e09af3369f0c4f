"""Walks of intact robots under the leg monitor, in batches: along a line, turning, and changing speed."""

import math
from dataclasses import replace
from functools import partial
from typing import Literal, get_args

import numpy as np

from hexctl.backends.sim.world import load_randomization
from hexctl.control.batch import SimTrial, run_sim_trials
from hexctl.control.monitor.monitored_walk import MonitoredWalk, recovering_walk
from hexctl.control.monitor.recovery import WalkOn
from hexctl.control.preparation import WalkStart
from hexctl.control.trial_plan import GaitChange, TrialPlan
from hexctl.control.trial_result import TrialResult
from hexctl.control.walks.velocity_walk import VelocityWalk
from hexctl.gait.gait import (
    NAMED_SLOTS,
    Gait,
    Motion,
    half_amplitude_turn_rate_rad_s,
    ideal_speed_m_s,
    make_gait,
)
from hexctl.robot.model import Robot
from hexctl.study.held_out import with_sensors
from hexctl.types import FloatArray, RobotState

#: Along a line; the same with two changes of gait; in a curve or on the spot; with a changing velocity.
Kind = Literal["line", "gaits", "turning", "changing"]
KINDS: tuple[Kind, ...] = get_args(Kind)

#: Walks of each kind in a world, and their length.
WALKS = {"line": 2, "gaits": 2, "turning": 3, "changing": 3}
DURATION_S = 30.0

#: How long a velocity lasts, the share of them that are zero, and when gaits change.
VELOCITY_S, STANDS, CHANGES_S = 3.0, 0.1, (10.0, 20.0)


def healthy_walks(robot: Robot, family: str, first: int, worlds: int) -> list[tuple[Kind, TrialResult]]:
    """Walks of an intact robot in members of a family; gaits, directions and velocities are drawn."""
    members = list(enumerate(load_randomization(family).members(first, worlds), first))
    walks: list[tuple[Kind, TrialResult]] = []
    for kind in KINDS:
        trials = [
            SimTrial(robot=robot, plan=plan, failures=None, world=with_sensors(world), seed=number)
            for number, world in members
            for plan in _plans(robot, kind, np.random.default_rng([number, KINDS.index(kind)]))
        ]
        velocities = np.random.default_rng(first)
        make = partial(_changing, velocities) if kind == "changing" else recovering_walk(WalkOn())
        walks += [(kind, result) for result in run_sim_trials(trials, 1, make, apart=True)]
    return walks


def _plans(robot: Robot, kind: Kind, random: np.random.Generator) -> list[TrialPlan]:
    return [_plan(robot, kind, random) for _ in range(WALKS[kind])]


def _plan(robot: Robot, kind: Kind, random: np.random.Generator) -> TrialPlan:
    def gait() -> Gait:
        return make_gait(robot, str(random.choice(list(NAMED_SLOTS))))

    plan = TrialPlan(gait=gait(), heading_rad=random.uniform(-math.pi, math.pi), duration_s=DURATION_S)
    if kind in ("line", "gaits"):
        times_s = CHANGES_S if kind == "gaits" else ()
        changes = tuple(GaitChange(gait=gait(), at_s=at_s) for at_s in times_s)
        return replace(plan, self_rotation="none", hold="line", changes=changes)
    if kind == "changing":
        return plan
    turn = float(random.choice((-1, 1)) * random.uniform(0.2, 1))
    rate_rad_s = turn * half_amplitude_turn_rate_rad_s(robot, plan.gait)
    return replace(plan, travel=float(random.choice((0.0, 0.5))), turn_rate_rad_s=rate_rad_s)


def _changing(random: np.random.Generator, start: WalkStart) -> MonitoredWalk:
    """Walks whose velocity, in any direction and with a turn in half of the time, changes in steps."""
    velocities = _velocities(random, start)

    def command(step: int, _state: RobotState) -> FloatArray:
        now: FloatArray = velocities[min(int(step * start.period_s / VELOCITY_S), len(velocities) - 1)]
        return now

    walk = VelocityWalk(start, command)
    walk.leave_plain()
    return MonitoredWalk(start, walk, WalkOn())


def _velocities(random: np.random.Generator, start: WalkStart) -> FloatArray:
    """Velocities of the body one after the other, (n, walks, 3)."""
    shape = math.ceil(DURATION_S / VELOCITY_S), len(start.plans)
    each = [(start.robot, plan.gait) for plan in start.plans]
    speeds = np.array([ideal_speed_m_s(*one, Motion()) for one in each])
    turns = np.array([half_amplitude_turn_rate_rad_s(*one) for one in each])
    ways_rad, speed_m_s = random.uniform(-math.pi, math.pi, shape), speeds * random.uniform(0.1, 1.0, shape)
    turns_rad_s = turns * random.uniform(-0.5, 0.5, shape) * (random.uniform(size=shape) < 0.5)
    velocities = np.stack((speed_m_s * np.cos(ways_rad), speed_m_s * np.sin(ways_rad), turns_rad_s), axis=-1)
    velocities[random.uniform(size=shape) < STANDS] = 0.0
    return velocities
