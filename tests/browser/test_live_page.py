"""The live view: a robot as its joints are measured, its readings, and nothing to move it with."""

import signal
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Browser

from hexctl.browser.live_page import LivePage, joint_table, posed
from hexctl.ik.legs import foot_positions_body
from hexctl.palette import FAILED_COLORS
from hexctl.robot.failure import Failure
from hexctl.robot.loader import load_robot
from hexctl.robot.rotations import matrix_of, quaternion_about
from hexctl.teleop.picture_relay import Picture
from hexctl.types import N_JOINTS, RobotState, ServoReadings
from tests.server.processes import program, served

ROBOT = load_robot("phantomx")


def a_state() -> RobotState:
    """A robot that measures joints and servos, and neither where it is nor how it lies."""
    unknown = np.full(N_JOINTS, np.nan)
    servos = ServoReadings(
        ages_s=np.zeros(N_JOINTS),
        efforts=np.linspace(-0.5, 0.5, N_JOINTS),
        currents_a=unknown,
        voltages_v=np.full(N_JOINTS, 11.5),
        temperatures_c=np.linspace(30.0, 47.0, N_JOINTS),
    )
    return RobotState(
        joint_positions_rad=ROBOT.stance_angles_rad + 0.1,
        stamp_s=1.0,
        measured=True,
        servos=servos,
        battery_v=11.4,
    )


@pytest.fixture
def page() -> Iterator[LivePage]:
    with LivePage(ROBOT, {}, place="tcp/127.0.0.1:7447") as running:
        yield running


def show(page: LivePage, state: RobotState, *failures: Failure, ticks: int = 26) -> None:
    for tick in range(ticks):
        page.show(state, failures, 0.02 * tick)


def test_an_unknown_pose_is_a_robot_that_stands_on_the_floor() -> None:
    state = posed(ROBOT, a_state())
    feet_m = foot_positions_body(ROBOT, state.joint_positions_rad)
    assert state.base_position_world is not None
    assert state.base_position_world[2] + feet_m[:, 2].min() == pytest.approx(ROBOT.foot_radius_m)
    tilted = posed(ROBOT, replace(a_state(), base_quaternion_world=quaternion_about((1, 0, 0), 0.2)))
    turn = matrix_of(np.asarray(tilted.base_quaternion_world))
    assert tilted.base_position_world is not None
    lowest_m = (feet_m @ turn.T)[:, 2].min() + tilted.base_position_world[2]
    assert lowest_m == pytest.approx(ROBOT.foot_radius_m)


def test_it_draws_what_is_measured_and_colours_what_has_failed(page: LivePage) -> None:
    state = replace(a_state(), base_position_world=np.array([0.4, -0.3, 0.12]))
    show(page, state, Failure(leg=3, kind="limp"))
    assert page._drawn._base.position == pytest.approx([0.4, -0.3, 0.12])
    assert page._world.position == pytest.approx([-0.4, 0.3, 0.0])
    assert tuple(page._drawn._links[1].batched_colors[2]) == FAILED_COLORS["femur"]
    assert "leg 3 limp" in page._state.content


def test_readings_of_servos_are_a_table_of_what_is_known(page: LivePage) -> None:
    show(page, a_state())
    assert "11.40 V" in page._state.content
    lines = page._joints.content.splitlines()
    assert len(lines) == 2 + N_JOINTS
    assert "temperature" in lines[0]
    assert "current" not in lines[0]
    assert "47.0" in lines[-1]
    assert joint_table(replace(a_state(), servos=None)).count("\n") == 1 + N_JOINTS


def test_the_camera_is_shown_as_it_is_and_its_absence_said() -> None:
    with LivePage(ROBOT, {}, place="here", picture_url="http://127.0.0.1:9/") as page:
        show(page, a_state(), ticks=2)
        assert "no picture" in page._seen.content
        assert page._pictures is not None
        page._pictures._closing.set()
        page._pictures._thread.join(10)
        page._pictures.newest = Picture(1, b"\xff\xd8jpeg")
        show(page, a_state(), ticks=25)
        assert "data:image/jpeg;base64,/9hqcGVn" in page._seen.content


def test_nothing_on_the_page_can_be_operated(page: LivePage) -> None:
    show(page, a_state())
    viser = page._server.viser
    assert not viser.gui._gui_input_handle_from_uuid
    assert not viser.gui._command_handle_from_uuid
    nodes = viser.scene._handle_from_node_name
    assert "/world/robot/base/femur" in nodes
    assert not any(node._impl.click_cb or node._impl.drag_cb for node in nodes.values())


@pytest.mark.realtime
def test_a_served_robot_is_in_the_browser_while_nobody_can_move_it(tmp_path: Path, browser: Browser) -> None:
    with (
        served(tmp_path) as robot,
        program(tmp_path, "view", "hexctl", "view", "--live", "--connect", robot.endpoint) as viewer,
    ):
        viewer.wait_for("Ctrl-C ends it")
        url = next(word for word in viewer.said().split() if word.startswith("http://127.0.0.1"))
        look(browser, url)
        viewer.signal(signal.SIGINT)
        assert viewer.process.wait(30) == 0


def look(browser: Browser, url: str) -> None:
    page = browser.new_page()
    page.set_default_timeout(60_000)
    page.goto(url)
    page.wait_for_selector("text=/joints (measured|as commanded)/")
    page.wait_for_selector("text=1 coxa")
    assert page.locator("button:has-text('STOP')").count() == 0
    assert page.locator("input:visible").count() == 0
    page.close()
