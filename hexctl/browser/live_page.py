"""A robot on the network in a browser, read-only: as its measured joints have it, with its readings."""

import base64
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import Self

import numpy as np

from hexctl.backends.clock import PERIOD_S, WallClock
from hexctl.browser.floor_scene import FloorScene
from hexctl.browser.robot_scene import RobotScene
from hexctl.browser.scene_server import SceneServer, light_scene
from hexctl.ik.legs import foot_positions_body
from hexctl.recording.scene import LEVEL
from hexctl.robot.failure import Failure, in_words
from hexctl.robot.meshes import Meshes
from hexctl.robot.model import Robot
from hexctl.robot.rotations import matrix_of, roll_pitch_rad, yaw_rad
from hexctl.teleop.drive_session import Travel
from hexctl.teleop.picture_relay import PictureRelay
from hexctl.types import JOINT_KINDS, JOINTS_PER_LEG, N_JOINTS, FloatArray, RobotState, all_finite
from hexctl.waiting import StopRequested

#: Ticks between two pictures of the scene, and between two readings.
SCENE_TICKS, READING_TICKS = 2, 25


class LivePage:
    """Serves the page; a context manager. It has texts only, so nothing on it can move a robot.

    Args:
        place: of the robot, for the page's title.
        port: 0 takes any free one.
        picture_url: stream or picture of a camera, as for `hexctl drive`; None for none.

    Raises InputError for the URL, RobotFaultError for a port in use.
    """

    def __init__(
        self, robot: Robot, meshes: Meshes, *, place: str, port: int = 0, picture_url: str | None = None
    ) -> None:
        self._robot, self._travel = robot, Travel()
        self._pictures = None if picture_url is None else PictureRelay(picture_url)
        self._picture = 0
        self._server = SceneServer(port, title=f"{robot.name} live")
        viser = self._server.viser
        light_scene(viser, robot)
        viser.gui.set_panel_label(f"{robot.name} at {place}")
        self._state, self._joints = viser.gui.add_markdown(""), viser.gui.add_markdown("")
        self._seen = viser.gui.add_html("")
        self._world = viser.scene.add_frame("/world", show_axes=False)
        self._ground = FloorScene(viser.scene, "/world/floor", LEVEL)
        self._drawn = RobotScene(viser.scene, "/world/robot", robot, meshes, LEVEL)
        self._ticks = 0

    def __enter__(self) -> Self:
        if self._pictures is not None:
            self._pictures.__enter__()
        return self

    def __exit__(self, *error: object) -> None:
        if self._pictures is not None:
            self._pictures.__exit__()
        self._server.__exit__()

    @property
    def url(self) -> str:
        """Address of the page."""
        return self._server.url

    def watch(
        self,
        read: Callable[[float], RobotState],
        *,
        stop_requested: StopRequested,
        failures: Callable[[], tuple[Failure, ...] | None],
    ) -> None:
        """Show states until a stop is requested; arguments and errors are those of `watch_states`."""
        clock = WallClock(PERIOD_S)
        while not stop_requested():
            self.show(read(clock.tick().time_s), failures() or (), clock.now_s)

    def show(self, state: RobotState, failures: Iterable[Failure], now_s: float) -> None:
        """Show a state, one per control period."""
        self._ticks += 1
        if self._ticks % SCENE_TICKS == 0 and all_finite(state.joint_positions_rad):
            self._show_robot(posed(self._robot, state), failures)
        if self._ticks % READING_TICKS == 1:
            self._travel.add(state, now_s)
            self._state.content = "  \n".join(self._lines(state, failures))
            self._joints.content = joint_table(state)
            self._show_picture()

    def _show_robot(self, state: RobotState, failures: Iterable[Failure]) -> None:
        position_m = state.base_position_world
        assert position_m is not None  # noqa: S101  it is posed
        if self._ticks == SCENE_TICKS:
            self._ground.begin(position_m, float(yaw_rad(np.asarray(state.base_quaternion_world))))
        self._ground.follow(position_m)
        self._drawn.show(state)
        self._drawn.color({one.leg: one for one in failures}, {})
        self._world.position = (-position_m[0], -position_m[1], 0.0)
        if self._ticks % READING_TICKS == 0:
            self._ground.draw_path()

    def _lines(self, state: RobotState, failures: Iterable[Failure]) -> Iterator[str]:
        yield f"**{'stopped: ' + state.stopped if state.stopped else 'not stopped'}**"
        if state.fault:
            yield f"fault: {state.fault}"
        if state.battery_v is not None:
            share = "" if state.battery_share is None else f", {state.battery_share:.0%}"
            yield f"battery {state.battery_v:.2f} V{share}"
        if state.current_a is not None:
            yield f"current {state.current_a:.2f} A"
        if state.base_quaternion_world is not None:
            angles = (*roll_pitch_rad(state.base_quaternion_world), yaw_rad(state.base_quaternion_world))
            names = ("roll", "pitch", "yaw")
            degrees = (math.degrees(float(angle)) for angle in angles)
            yield ", ".join(f"{name} {value:+.1f}°" for name, value in zip(names, degrees, strict=True))
        if self._travel.distance_m is not None:
            yield f"{self._travel.distance_m:.2f} m at {self._travel.speed_m_s or 0.0:.3f} m/s"
        if state.foot_contacts is not None:
            legs = [str(leg + 1) for leg in np.flatnonzero(state.foot_contacts)]
            yield f"feet on the floor: {', '.join(legs) or 'none'}"
        if broken := [f"leg {one.leg} {in_words(one)}" for one in failures]:
            yield f"failed: {', '.join(broken)}"
        yield "joints measured" if state.measured else "joints as commanded: the servos report none"
        yield from state.warnings

    def _show_picture(self) -> None:
        newest = None if self._pictures is None else self._pictures.newest
        if newest is not None and newest.number != self._picture:
            self._picture = newest.number
            coded = base64.b64encode(newest.jpeg).decode()
            self._seen.content = f'<img alt="camera" style="width:100%" src="data:image/jpeg;base64,{coded}">'
        elif newest is None and self._pictures is not None:
            self._picture, self._seen.content = 0, "no picture from the camera"


def posed(robot: Robot, state: RobotState) -> RobotState:
    """The state with a pose: an unknown place is over the origin, with the lowest foot on the floor."""
    quaternion = state.base_quaternion_world
    if quaternion is None:
        quaternion = LEVEL.quaternion_world
    position_m = state.base_position_world
    if position_m is None:
        feet_m = foot_positions_body(robot, state.joint_positions_rad) @ matrix_of(quaternion).T
        position_m = np.array([0.0, 0.0, robot.foot_radius_m - feet_m[:, 2].min()])
    return replace(state, base_position_world=position_m, base_quaternion_world=quaternion)


def joint_table(state: RobotState) -> str:
    """What single servos report, as a table in Markdown; empty if they report nothing."""
    columns: dict[str, FloatArray] = {"angle (°)": np.degrees(state.joint_positions_rad)}
    if state.joint_torques_nm is not None:
        columns["torque (N m)"] = state.joint_torques_nm
    if state.servos is not None:
        columns |= {
            "load (%)": 100 * state.servos.efforts,
            "temperature (°C)": state.servos.temperatures_c,
            "voltage (V)": state.servos.voltages_v,
            "current (A)": state.servos.currents_a,
        }
    known = {name: values for name, values in columns.items() if np.isfinite(values).any()}
    rows = [
        [f"{joint // JOINTS_PER_LEG + 1} {JOINT_KINDS[joint % JOINTS_PER_LEG]}"]
        + [
            _shown(float(values[joint]), 1 if "°" in name or "%" in name else 2)
            for name, values in known.items()
        ]
        for joint in range(N_JOINTS)
    ]
    lines = [["leg", *known], ["---"] * (1 + len(known)), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _shown(value: float, places: int) -> str:
    return f"{round(value, places) + 0.0:.{places}f}" if math.isfinite(value) else ""
