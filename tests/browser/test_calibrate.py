"""`hexctl calibrate --page` in a real browser, on simulated boards in real time."""

import re
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from playwright.sync_api import Browser, Page

from hexctl.backends.bus.bus_map import bus_map_of
from hexctl.backends.mock import MockServos
from hexctl.backends.pwm.pulse_board import pwm_map_of
from hexctl.control.calibration.operator import CalibrationResult
from hexctl.control.calibration.reference_pose import leg_pose_deg
from hexctl.control.drive.arbiter import COMMAND_EXPIRY_S
from hexctl.robot.loader import load_robot_file
from hexctl.robot.servos.servo_schema import ServosSection
from hexctl.teleop.calibration_page import calibrate_on_page
from hexctl.teleop.page_options import PagedCalibrationOptions
from hexctl.types import JOINT_NAMES, FloatArray, RobotState
from tests.backends.bus.boards import bus_board
from tests.backends.pwm.boards import pca9685_board
from tests.browser.pages import PATIENCE_S, PHONES, always_in_reach, drawn, open_page, until
from tests.robots import edited_file, put, shipped, with_ids
from tests.server.processes import program

pytestmark = pytest.mark.realtime

#: The chosen joint as the page draws it.
LIT = (240, 160, 48)


class Calibrating:
    """A calibration with its page, in a thread of the test."""

    def __init__(self, file: Path, **options: Any) -> None:
        self.url, self.result, self._file = "", list[CalibrationResult](), file
        self._options, self._end = PagedCalibrationOptions(page="127.0.0.1:0", **options), threading.Event()
        self._failed = list[BaseException]()
        self._thread = threading.Thread(target=self._run)

    def _run(self) -> None:
        try:
            self.result.append(
                calibrate_on_page(self._file, self._options, say=self._say, stop_requested=self._end.is_set)
            )
        except BaseException as error:  # noqa: BLE001  raised at the end
            self._failed.append(error)

    def _say(self, text: str) -> None:
        self.url = re.findall(r"http://\S+?/", text)[0]

    @property
    def ended(self) -> bool:
        return not self._thread.is_alive()

    def __enter__(self) -> "Calibrating":
        self._thread.start()
        deadline_s = time.monotonic() + PATIENCE_S
        while not (self.url or self._failed):
            assert time.monotonic() < deadline_s
            time.sleep(0.02)
        return self

    def __exit__(self, *error: object) -> None:
        self._end.set()
        self._thread.join(PATIENCE_S)
        assert not self._thread.is_alive()
        if self._failed:
            raise self._failed[0]


def shown(page: Page) -> dict[str, Any]:
    """The newest status that the page has."""
    status: dict[str, Any] = page.evaluate("now") or {}
    return status


def says(page: Page, **wanted: Any) -> None:
    """Wait until the page has values in its status."""
    until(page, lambda: wanted.items() <= shown(page).items(), f"{wanted} is not in {shown(page)}")


def ask(page: Page, selector: str, **wanted: Any) -> None:
    """Press a button, and wait for what it changes."""
    page.click(selector)
    says(page, **wanted)


def turn(page: Page, to_deg: float, near_deg: float) -> None:
    """Hold buttons until the page shows the chosen joint at an angle."""
    for share, near in ((1.0, 4.0), (0.15, near_deg)):
        while abs(missing := to_deg - shown(page)["angle_deg"]) > near:
            way = share if missing > 0 else -share
            box = page.locator(f'[data-share="{way:g}"]').bounding_box()
            assert box is not None
            page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
            page.mouse.down()
            before = missing
            deadline_s = time.monotonic() + PATIENCE_S
            while (left := to_deg - shown(page)["angle_deg"]) * before > 0 and abs(left) > near:
                assert time.monotonic() < deadline_s, f"it does not reach {to_deg}"
                page.wait_for_timeout(20)
            page.mouse.up()
            page.wait_for_timeout(250)


#: How the hobby servos are mounted: every third turns the other way, and horns are off by up to 12 degrees.
MOUNTED: dict[str, Any] = {
    name: {
        "sign": -1 if joint % 3 == 0 else 1,
        "offset_deg": (40 if joint % 3 == 2 else 0) + (7 * joint) % 25 - 12,
    }
    for joint, name in enumerate(JOINT_NAMES)
}

#: What the robot file knows of them: only how the tibias are meant to be mounted.
KNOWN = {"tibia": {"offset_deg": 40}}


@contextmanager
def hobby_robot(folder: Path) -> Iterator[tuple[Any, Any, Path]]:
    """A simulated PCA9685, the map that is true of it, and a file of it that is not calibrated."""
    true_map = pwm_map_of(ServosSection.model_validate(MOUNTED), "pca9685")
    # Board, browser and calibration share a busy computer for minutes.
    with patch("hexctl.backends.pwm.servos.MUTE_S", 20.0), pca9685_board(pwm_map=true_map) as board:
        section = {**KNOWN, "driver": "pca9685", "port": board.path, "if_computer_dies": "hold"}
        yield board, true_map, edited_file(folder, put("servos", section))


def true_deg(board: Any, true_map: Any) -> FloatArray:
    angles_deg: FloatArray = np.degrees(true_map.angles_rad(np.asarray(board.pulses_us())))
    return angles_deg


def calibrate_joint(
    page: Page, joint: int, angle: Callable[[], float], ends_deg: tuple[float, float]
) -> None:
    """Calibrate the chosen hobby servo as a person does who sees its true angle."""
    before, shown_deg = angle(), shown(page)["angle_deg"]
    room = 6 if shown_deg < 40 else -6
    turn(page, shown_deg + room, 1.0)
    if (angle() - before) * room < 0:
        sign = shown(page)["sign"]
        ask(page, 'section.motor [data-do="flip"]', sign=-sign)
    zero_deg = shown(page)["zero_deg"]
    for _ in range(4):  # what it shows is not true yet
        if abs(missing := zero_deg - angle()) < 0.3:
            break
        turn(page, shown(page)["angle_deg"] + missing, 0.15)
    page.click('[data-do="zero"]')
    until(page, lambda: abs(shown(page)["angle_deg"] - zero_deg) < 0.01, "the zero is not taken")
    for end_deg, which in zip(ends_deg, ("lower", "upper"), strict=True):
        turn(page, end_deg, 0.3)
        page.click(f'[data-do="{which}"]')
        until(page, lambda: (shown(page)["ends"][0] is None) == (which == "upper"), f"no {which} end")  # noqa: B023
    page.click('[data-do="save"]')
    until(page, lambda: joint in shown(page)["saved"], f"{JOINT_NAMES[joint]} is not saved: {shown(page)}")


@pytest.mark.parametrize("joints", ["leg1", pytest.param(None, marks=pytest.mark.long)])
def test_hobby_servos_are_calibrated_from_the_first_joint_to_the_last(
    joints: str | None, browser: Browser, tmp_path: Path
) -> None:
    with hobby_robot(tmp_path) as (board, true_map, file):
        stance_deg = np.degrees(shipped().stance_angles_rad)
        with Calibrating(file, joints=joints) as run:
            page = open_page(browser, run.url)
            says(page, owner="you", begun=False)
            ask(page, '[data-do="start"]', begun=True)
            page.wait_for_timeout(1500)  # legs are powered one after the other
            chosen = shown(page)["joints"]
            assert len(chosen) == (18 if joints is None else 3)
            for joint in chosen:
                says(page, joint=joint)
                ends = (stance_deg[joint] - 12, stance_deg[joint] + 12)
                calibrate_joint(page, joint, lambda: true_deg(board, true_map)[joint], ends)  # noqa: B023
            page.click('[data-do="finish"]')
            until(page, lambda: run.ended, "it does not end")
            assert run.result[0].saved == [JOINT_NAMES[joint] for joint in chosen]
        found = pwm_map_of(load_robot_file(file).content.servos, "pca9685")
        np.testing.assert_array_equal(found.signs[chosen], true_map.signs[chosen])
        np.testing.assert_allclose(found.offsets_deg[chosen], true_map.offsets_deg[chosen], atol=0.8)
        ends_deg = np.degrees([found.angles_rad(found.least), found.angles_rad(found.most)])
        np.testing.assert_allclose(np.sort(ends_deg, axis=0)[0][chosen], stance_deg[chosen] - 12, atol=1.5)


class LimpRobot(MockServos):
    """A robot behind a bus, whose joints a test moves by hand once they are limp."""

    def read(self) -> RobotState:
        return replace(super().read(), measured=True)

    def hold(self, true_deg: FloatArray) -> None:
        self._positions_rad = np.radians(true_deg)


@pytest.mark.parametrize("joints", ["leg1", pytest.param(None, marks=pytest.mark.long)])
def test_limp_servos_of_a_bus_are_calibrated_from_the_first_joint_to_the_last(
    joints: str | None, browser: Browser, tmp_path: Path
) -> None:
    true_map = bus_map_of(ServosSection.model_validate(MOUNTED), "feetech")
    robot = LimpRobot(shipped("phantomx"))
    with bus_board(true_map, servos=robot) as board:
        section = with_ids({**KNOWN, "driver": "feetech", "port": board.path, "if_computer_dies": "hold"})
        file = edited_file(tmp_path, put("servos", section), base="phantomx")
        with Calibrating(file, joints=joints) as run:
            page = open_page(browser, run.url)
            says(page, by_hand=True, owner="you")
            assert not page.locator("nav .hold >> visible=true").count()
            ask(page, '[data-do="start"]', begun=True)
            chosen, held_deg = shown(page)["joints"], np.linspace(-12, 14, 18)
            for joint in chosen:
                says(page, joint=joint)
                if joint % 3 == 0:
                    held_deg[joint : joint + 3] = leg_pose_deg(robot.robot, joint // 3)
                    robot.hold(held_deg)
                    page.click('[data-do="zero"]')
                    until(page, lambda: not shown(page)["said"] and shown(page)["undo"], "no pose is taken")
                    until(page, lambda: abs(shown(page)["angle_deg"] - held_deg[joint]) < 1, "wrong")  # noqa: B023
                for which, end_deg in (("lower", -100.0), ("upper", 60.0)):
                    held_deg[joint] = end_deg
                    robot.hold(held_deg)
                    page.click(f'[data-do="{which}"]')
                    until(page, lambda: (shown(page)["ends"][0] is None) == (which == "upper"), which)  # noqa: B023
                page.click('[data-do="save"]')
                until(page, lambda: joint in shown(page)["saved"], f"{shown(page)}")  # noqa: B023
        assert run.result[0].saved == [JOINT_NAMES[joint] for joint in chosen]
        assert list(robot.sent) == []  # no motor moved anything
    found = bus_map_of(load_robot_file(file).content.servos, "feetech")
    np.testing.assert_array_equal(found.signs[chosen], true_map.signs[chosen])
    np.testing.assert_allclose(found.offsets_deg[chosen], true_map.offsets_deg[chosen], atol=0.15)


@pytest.fixture
def hobby(tmp_path: Path) -> Iterator[tuple[Calibrating, Callable[[], FloatArray], Path]]:
    """A calibration of hobby servos, where their joints are, and the robot file."""
    with hobby_robot(tmp_path) as (board, true_map, file), Calibrating(file) as run:
        yield run, lambda: true_deg(board, true_map), file


Hobby = tuple[Calibrating, Callable[[], FloatArray], Path]


def begun(browser: Browser, run: Calibrating, **options: Any) -> Page:
    """A page that owns a calibration whose joints are held."""
    page = open_page(browser, run.url, **options)
    says(page, owner="you")
    ask(page, '[data-do="start"]', begun=True)
    page.wait_for_timeout(1500)  # legs are powered one after the other
    return page


def rests(joints_deg: Callable[[], FloatArray]) -> None:
    """Joints that a lost finger has moved rest within the expiry of a command, and stay."""
    time.sleep(COMMAND_EXPIRY_S + 0.3)
    before = joints_deg()
    time.sleep(0.5)
    np.testing.assert_array_equal(joints_deg(), before)


def test_a_page_closed_in_mid_jog_leaves_the_joint_at_rest_and_its_progress(
    hobby: Hobby, browser: Browser
) -> None:
    run, joints_deg, _ = hobby
    page = begun(browser, run)
    ask(page, '[data-joint="4"]', joint=4)
    ask(page, '[data-do="save"]', saved=[4], joint=5)
    begin_deg = joints_deg()
    page.keyboard.down("Shift")
    page.keyboard.down("ArrowUp")
    until(page, lambda: abs(joints_deg()[5] - begin_deg[5]) > 4, "it does not move")
    page.context.close()
    rests(joints_deg)
    np.testing.assert_allclose(np.delete(joints_deg() - begin_deg, 5), 0, atol=0.5)
    again = open_page(browser, run.url)
    says(again, owner="you", saved=[4], joint=5, begun=True)


def test_a_calibration_that_was_ended_goes_on_with_the_next_joint(browser: Browser, tmp_path: Path) -> None:
    with hobby_robot(tmp_path) as (_, _, file):
        with Calibrating(file) as run:
            ask(begun(browser, run), '[data-do="save"]', saved=[0])
        with Calibrating(file) as run:
            says(open_page(browser, run.url), saved=[0], joint=1, begun=False)


@pytest.mark.parametrize("lost", ["key up", "blur", "stop", "button up"])
def test_a_joint_moves_only_while_something_is_held(lost: str, hobby: Hobby, browser: Browser) -> None:
    run, joints_deg, _ = hobby
    page = begun(browser, run)
    begin_deg = joints_deg()
    if lost == "button up":
        page.hover('[data-share="1"]')
        page.mouse.down()
    else:
        page.keyboard.down("ArrowUp")
    until(page, lambda: abs(joints_deg()[0] - begin_deg[0]) > 0.9, "it does not move")
    if lost == "stop":
        ask(page, "#stop", stopped="stop button")
        page.keyboard.up("ArrowUp")
        page.keyboard.down("ArrowUp")
    elif lost == "blur":
        page.evaluate("window.dispatchEvent(new Event('blur'))")
    else:
        page.keyboard.up("ArrowUp") if lost == "key up" else page.mouse.up()
    rests(joints_deg)
    if lost == "stop":
        page.keyboard.up("ArrowUp")
        ask(page, '[data-do="go on"]', stopped=None)
        rests(joints_deg)
        before = joints_deg()[0]
        page.keyboard.down("ArrowDown")
        until(page, lambda: abs(joints_deg()[0] - before) > 0.4, "it does not go on")


def test_the_second_of_two_pages_hears_who_owns_the_robot_and_may_only_stop_it(
    hobby: Hobby, browser: Browser
) -> None:
    run, joints_deg, file = hobby
    first = begun(browser, run)
    second = open_page(browser, run.url)
    says(second, owner="127.0.0.1")
    assert "127.0.0.1" in second.inner_text("#speed")
    text, before = file.read_text(), joints_deg()
    for request in ("flip", "zero", "save", "choose 7", "finish"):
        second.evaluate("request => send({ do: request })", request)
    second.evaluate("jog(1)")
    rests(joints_deg)
    np.testing.assert_array_equal(joints_deg(), before)
    assert (file.read_text(), shown(first)["joint"], run.ended) == (text, 0, False)
    second.click("#stop")
    says(first, stopped="stop button")
    first.context.close()
    says(second, owner="you")


def test_a_page_of_another_origin_moves_nothing(hobby: Hobby, browser: Browser) -> None:
    run, joints_deg, file = hobby
    page = begun(browser, run)
    text, before = file.read_text(), joints_deg()
    foreign = browser.new_page()
    foreign.route(
        "http://other.test/",
        lambda route: route.fulfill(body="<title>other</title>", content_type="text/html"),
    )
    foreign.goto("http://other.test/")
    outcome = foreign.evaluate(
        """url => new Promise(done => {
          const socket = new WebSocket(url.replace(/^http/, "ws") + "drive", ["hexctl.drive.1"]);
          socket.onopen = () => done("open");
          socket.onerror = () => done("refused");
        })""",
        run.url,
    )
    assert outcome == "refused"
    rests(joints_deg)
    np.testing.assert_array_equal(joints_deg(), before)
    assert file.read_text() == text
    says(page, owner="you")


@pytest.mark.parametrize("how", ["finish", "Ctrl-C"])
def test_the_command_serves_the_page_and_says_what_is_saved(
    how: str, browser: Browser, tmp_path: Path
) -> None:
    with hobby_robot(tmp_path) as (_, _, file):
        words = ("hexctl", "calibrate", str(file), "--page", "127.0.0.1:0")
        with program(tmp_path, "calibrate", *words) as command:
            command.wait_for("calibrate on http")
            page = open_page(browser, re.findall(r"http://\S+?/", command.said())[0])
            says(page, owner="you")
            page.click('[data-do="start"]')
            ask(page, '[data-do="save"]', saved=[0])
            if how == "finish":
                page.click('[data-do="finish"]')
            else:
                command.signal(signal.SIGINT)
            assert command.wait() == (0 if how == "finish" else 130)
            assert f"saved leg1_coxa in {file}" in command.said()


def test_limits_that_exclude_the_stance_are_refused_in_the_page(hobby: Hobby, browser: Browser) -> None:
    run, _, file = hobby
    page, text = begun(browser, run), file.read_text()
    ask(page, '[data-joint="4"]', joint=4)  # it stands at 5 deg
    limits = shown(page)["limits"]
    for end_deg, which in ((-40.0, "lower"), (-20.0, "upper")):
        turn(page, end_deg, 0.5)
        page.click(f'[data-do="{which}"]')
    until(page, lambda: "leg2_femur" in shown(page)["said"], "it is not refused")
    assert shown(page)["limits"] == limits
    assert "leg2_femur" in page.inner_text("#said")
    assert file.read_text() == text


def test_changes_are_taken_back_one_by_one(hobby: Hobby, browser: Browser) -> None:
    run, joints_deg, _ = hobby
    page = begun(browser, run)
    before, angles_deg = {key: shown(page)[key] for key in ("sign", "offset_deg", "limits")}, joints_deg()
    ask(page, 'section.motor [data-do="flip"]', sign=-before["sign"])
    page.fill("#degrees", "12.5")
    ask(page, "#measured", angle_deg=12.5)
    ask(page, '[data-do="save"]', saved=[0])
    ask(page, "#undo", saved=[], joint=0)
    ask(page, "#undo", undo=False, **before)
    np.testing.assert_allclose(joints_deg(), angles_deg, atol=0.6)


@pytest.mark.parametrize("way", PHONES)
def test_on_a_phone_a_finger_jogs_and_stop_is_in_reach(way: str, hobby: Hobby, browser: Browser) -> None:
    run, joints_deg, _ = hobby
    page = begun(browser, run, size=PHONES[way], touch=True)
    assert always_in_reach(page, "#stop")
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    assert drawn(page, "above", LIT) > 30
    assert drawn(page, "side", LIT) > 30
    for selector in ('[data-share="0.15"]', '[data-share="-1"]'):
        assert always_in_reach(page, selector)
    page.locator('[data-do="save"]').scroll_into_view_if_needed()
    assert always_in_reach(page, '[data-do="save"]')
    assert always_in_reach(page, "#stop")
    before = joints_deg()[0]
    finger = page.context.new_cdp_session(page)
    box = page.locator('[data-share="1"]').bounding_box()
    assert box is not None
    where = [{"x": box["x"] + box["width"] / 2, "y": box["y"] + box["height"] / 2}]
    finger.send("Input.dispatchTouchEvent", {"type": "touchStart", "touchPoints": where})
    until(page, lambda: abs(joints_deg()[0] - before) > 3, "it does not move")
    finger.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
    rests(joints_deg)
