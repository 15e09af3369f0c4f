"""A leg fails in mid-walk: the robot some moments later, walking on and recovering."""

import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from matplotlib.axes import Axes

from hexctl.backends.clock import PERIOD_S
from hexctl.backends.sim.servos import SimServos
from hexctl.control.guard import Guard
from hexctl.control.log import TickLog
from hexctl.control.monitor.monitored_walk import MonitoredWalk, watched_walk
from hexctl.control.monitor.recovery import GlideToStableGait, RecoveryPolicy, WalkOn
from hexctl.control.preparation import WalkStart
from hexctl.control.trial import run_trial
from hexctl.control.trial_plan import TrialPlan
from hexctl.gait.gait import make_gait
from hexctl.ik.legs import link_points_body
from hexctl.palette import FAILED_COLORS, LINE_COLOR, VERDICT_COLORS, hex_color
from hexctl.robot.failure_grammar import parse_failure_event
from hexctl.robot.loader import load_robot
from hexctl.types import FloatArray
from pictures.picture import Picture

#: What fails, when, and the length of the walks.
EVENT, FAILS_S, DURATION_S = "5:limp@6", 6.0, 16.0

#: Moments that are drawn, from the failure on.
MOMENTS_S = (-0.5, 0.4, 1.2, 3.0, 6.0)

#: The walks: name and policy.
WALKS: tuple[tuple[str, type[RecoveryPolicy]], ...] = (("walks on", WalkOn), ("recovers", GlideToStableGait))

FAILED_COLOR, WHOLE_COLOR, BODY_COLOR = hex_color(FAILED_COLORS["femur"]), "#404550", "#b8c2d0"


@dataclass(frozen=True, slots=True)
class FailedWalk:
    """A walk in which a leg fails.

    Attributes:
        name: what the robot does about it.
        log: of its ticks.
        alarm_s: when it noticed, from the failure on.
        leg: which one.
    """

    name: str
    log: TickLog
    alarm_s: float
    leg: int

    def points_world(self, moment_s: float) -> FloatArray:
        """Joints and foot of each leg at a moment from the failure on, (6, 4, 3)."""
        row = self._row(moment_s)
        turned: FloatArray = np.zeros(9)
        mujoco.mju_quat2Mat(turned, self.log["base_quaternion_world"][row])
        points = link_points_body(load_robot("ant"), self.log["measured_rad"][row])
        placed: FloatArray = points @ turned.reshape(3, 3).T + self.log["base_position_world"][row]
        return placed

    def way_m(self) -> tuple[FloatArray, FloatArray]:
        """Times from the failure on, and the way along the line and to its left, (T,) and (T, 2)."""
        rows = self.log.rows_of("walk")
        position = self.log["base_position_world"][rows][:, :2]
        times_s = self.log["time_s"][rows]
        return times_s - times_s[0] - FAILS_S, position - position[0]

    def _row(self, moment_s: float) -> int:
        rows = self.log.rows_of("walk")
        return int(np.arange(len(self.log["time_s"]))[rows][round((FAILS_S + moment_s) / PERIOD_S)])


def walk(name: str, policy: type[RecoveryPolicy]) -> FailedWalk:
    """Walk straight ahead on the flat floor until a leg fails, and beyond."""
    robot, log, walks = load_robot("ant"), TickLog(), list[MonitoredWalk]()
    plan = TrialPlan(gait=make_gait(robot, "tripod"), hold="line", duration_s=DURATION_S)

    def made(start: WalkStart) -> MonitoredWalk:
        walks.append(watched_walk(policy())(start))
        return walks[0]

    with Guard(SimServos(robot, events=[parse_failure_event(EVENT)])) as guard:
        run_trial(guard, plan, made, (log,), soft_stop=False)
    noticed = walks[0].noticed_failures()[0]
    return FailedWalk(name, log, noticed.at_s - FAILS_S, noticed.failure.leg)


def draw_failure_strip(_folder: Path) -> Picture:
    """Draw moments of both walks, and deviation and speed over time."""
    import matplotlib as mpl

    mpl.use("agg")
    import matplotlib.pyplot as plt

    walks = [walk(*one) for one in WALKS]
    figure = plt.figure(figsize=(13.0, 6.2), layout="constrained")
    strips, curves = figure.subfigures(2, 1, height_ratios=(1.5, 1.0))
    axes = strips.subplots(len(walks), len(MOMENTS_S))
    for row, one in zip(axes, walks, strict=True):
        for ax, moment_s in zip(row, MOMENTS_S, strict=True):
            _draw_moment(ax, one, moment_s)
        row[0].set_ylabel(one.name, fontsize=12)
    for ax, moment_s in zip(axes[0], MOMENTS_S, strict=True):
        when = f"{moment_s:g} s after" if moment_s > 0 else f"{-moment_s:g} s before"
        ax.set_title(f"{when} leg {walks[0].leg} goes limp", fontsize=10)
    _draw_curves(curves.subplots(1, 2), walks)
    drawing = io.BytesIO()
    figure.savefig(drawing, format="png", dpi=110)
    plt.close(figure)
    return Picture.from_png(drawing.getvalue())


def _draw_moment(ax: Axes, one: FailedWalk, moment_s: float) -> None:
    """The robot at a moment, walking to the right; `VIEW` looks at it from the right and from above."""
    points = one.points_world(moment_s)
    centre = points[:, 0].mean(axis=0)
    flat = (points - [centre[0], centre[1], 0.0]) @ VIEW.T
    body = flat[[0, 1, 2, 3, 4, 5, 0], 0]
    ax.fill(*body.T, color=BODY_COLOR, zorder=2)
    for leg, chain in enumerate(flat, 1):
        color, width = (FAILED_COLOR, 3.0) if leg == one.leg and moment_s > 0 else (WHOLE_COLOR, 2.0)
        ax.plot(*chain.T, color=color, linewidth=width, solid_capstyle="round", zorder=3)
        foot = points[leg - 1, -1]
        shadow = (np.array([foot[0] - centre[0], foot[1] - centre[1], 0.0])) @ VIEW.T
        ax.plot(*shadow, "o", color="#00000030", markersize=7, zorder=1)
    ax.set_aspect("equal")
    ax.set_xlim(-0.33, 0.33)
    ax.set_ylim(-0.13, 0.26)
    ax.set_xticks([])
    ax.set_yticks([])


#: Where a point of the world is in the picture: x to the right, and y and height upward.
VIEW: FloatArray = np.array([[1.0, 0.25, 0.0], [0.0, 0.45, 0.9]])


def _draw_curves(axes: Sequence[Axes], walks: Sequence[FailedWalk]) -> None:
    """Deviation from the line and speed over time."""
    colors = (FAILED_COLOR, hex_color(VERDICT_COLORS["holds"]))
    cycle = round(1 / load_robot("ant").gait.pace_hz / PERIOD_S)
    for one, color in zip(walks, colors, strict=True):
        times_s, way_m = one.way_m()
        axes[0].plot(times_s, 100 * way_m[:, 1], color=color, label=one.name)
        speed = (way_m[cycle:, 0] - way_m[:-cycle, 0]) / (cycle * PERIOD_S)
        axes[1].plot(times_s[cycle:], 100 * speed, color=color)
    for ax in axes:
        ax.axvline(0.0, color=WHOLE_COLOR, linewidth=1.0)
        ax.axvline(walks[-1].alarm_s, color=WHOLE_COLOR, linewidth=1.0, linestyle=":")
        ax.set_xlabel("time since the failure, s (dotted: noticed)")
        ax.set_xlim(-2.0, DURATION_S - FAILS_S)
    axes[0].axhline(0.0, color=hex_color(LINE_COLOR), linewidth=1.0)
    axes[0].set_ylabel("left of the line, cm")
    axes[1].set_ylabel("speed over a cycle, cm/s")
    axes[1].set_ylim(bottom=0.0)
    axes[0].legend(fontsize=9)
