"""`hexctl play` in a real browser: a leg broken by a click, keys, stop, several pages, a phone."""

import signal
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import viser
from playwright.sync_api import Browser, Page
from websockets.exceptions import WebSocketException
from websockets.sync.client import connect
from websockets.typing import Origin, Subprotocol

from hexctl.browser.play import Play
from hexctl.browser.play_options import PlayOptions
from hexctl.browser.play_panel import CLICKS, INTACT
from hexctl.browser.played_robot import PlayedRobot, simulation_of
from hexctl.errors import InputError, RobotFaultError
from hexctl.recording.recorded_trial import read_trial
from hexctl.robot.failure import Failure
from hexctl.robot.rotations import matrix_of
from hexctl.waiting import comes_true
from tests.server.processes import program

pytestmark = pytest.mark.realtime

#: A page without a graphics card on a busy computer.
PATIENCE_S = 60.0


@contextmanager
def playing(folder: Path, **options: Any) -> Iterator[Play]:
    """A running simulation with its page on a free port."""
    with Play(PlayOptions(page_port=0, **options), runs=folder) as play:
        ended, failed = threading.Event(), list[BaseException]()

        def run() -> None:
            try:
                play.run(ended.is_set)
            except BaseException as error:  # noqa: BLE001  raised below
                failed.append(error)

        thread = threading.Thread(target=run)
        thread.start()
        try:
            assert comes_true(lambda: play._panel is not None or bool(failed), PATIENCE_S)
            yield play
        finally:
            ended.set()
            thread.join(PATIENCE_S)
        assert not thread.is_alive()
        if failed:
            raise failed[0]


def played(play: Play) -> PlayedRobot:
    assert play._played is not None
    return play._played


def until(condition: Any) -> None:
    assert comes_true(condition, PATIENCE_S)


def opened(browser: Browser, play: Play, width: int = 1200, height: int = 800, **more: Any) -> Page:
    page = browser.new_context(viewport={"width": width, "height": height}, **more).new_page()
    page.set_default_timeout(1000 * PATIENCE_S)
    page.goto(play.url)
    page.wait_for_function("window.hexctl && window.hexctl.mode === 'driving'")
    page.wait_for_function("document.querySelectorAll('canvas').length > 1")
    return page


def status(page: Page) -> dict[str, Any]:
    told: dict[str, Any] = page.evaluate("window.hexctl")
    return told


def on_screen(play: Play, page: Page, point_world: Any) -> tuple[float, float]:
    """Where a page shows a point of the world, from its own camera."""
    clients = play._server.viser.get_clients()
    camera = next(iter(clients.values())).camera
    box = page.viewport_size
    assert box is not None
    at = np.asarray(point_world) + np.asarray(played(play)._world.position)
    x, y, z = matrix_of(np.asarray(camera.wxyz)).T @ (at - np.asarray(camera.position))
    focal = box["height"] / 2 / np.tan(camera.fov / 2)
    return box["width"] / 2 + focal * x / z, box["height"] / 2 + focal * y / z


def middle_of_link(play: Play, leg: int, link: int) -> Any:
    drawn = played(play)._robot
    turn, at_m = matrix_of(np.asarray(drawn._base.wxyz)), np.asarray(drawn._base.position)
    starts = drawn._links[link].batched_positions[leg - 1]
    ends = drawn._feet.batched_positions if link == 2 else drawn._links[link + 1].batched_positions
    return at_m + turn @ ((starts + ends[leg - 1]) / 2)


def test_a_click_breaks_a_leg_and_the_walk_recovers(tmp_path: Path, browser: Browser) -> None:
    with playing(tmp_path) as play:
        page = opened(browser, play)
        until(lambda: bool(play._server.viser.get_clients()))
        until(lambda: status(page)["speed_m_s"] > 0.05)
        leg = 6  # the nearest to the camera

        def click() -> bool:
            page.mouse.click(*on_screen(play, page, middle_of_link(play, leg, 2)))
            return comes_true(lambda: bool(played(play).simulation.failures), 5.0)

        assert any(click() for _ in range(6)), "no click hit the leg"
        (failure,) = played(play).simulation.failures
        assert failure.kind == CLICKS[0]
        page.wait_for_function(f"window.hexctl.broken_legs.includes({failure.leg})")
        page.wait_for_function("window.hexctl.failures.length > 0")
        assert f"leg {failure.leg}" in status(page)["failures"][0]
        assert "later" in page.inner_text("#hx-log")
        # It walks on without that leg.
        began_m = status(page)["distance_m"]
        page.wait_for_function(f"window.hexctl.distance_m > {began_m + 0.1}")
        until(lambda: play._panel is not None and play._panel._legs[failure.leg - 1].value == CLICKS[0])
        page.close()


def test_keys_drive_stop_and_stand(tmp_path: Path, browser: Browser) -> None:
    with playing(tmp_path) as play:
        played(play).cruise = (0.0, 0.0)
        page = opened(browser, play)
        page.wait_for_function("Math.abs(window.hexctl.velocity[0]) < 1e-3")
        page.keyboard.down("ArrowUp")
        page.wait_for_function("window.hexctl.source === 'page' && window.hexctl.velocity[0] > 0.05")
        page.keyboard.down("ArrowLeft")
        page.wait_for_function("window.hexctl.velocity[2] > 0.05")
        page.keyboard.up("ArrowLeft")
        page.keyboard.up("ArrowUp")
        page.wait_for_function("Math.abs(window.hexctl.velocity[0]) < 1e-3")
        page.keyboard.down("w")
        page.wait_for_function("window.hexctl.velocity[0] > 0.05")
        page.keyboard.press("x")
        page.wait_for_function("window.hexctl.stopped === 'stop button'")
        assert "stopped" in page.inner_text("#hx-what")
        page.wait_for_timeout(500)
        page.keyboard.press("1")
        page.wait_for_function("window.hexctl.stopped === null")
        page.keyboard.up("w")
        page.close()


def test_two_pages_share_the_robot_and_either_stops_it(tmp_path: Path, browser: Browser) -> None:
    with playing(tmp_path) as play:
        first, second = opened(browser, play), opened(browser, play)
        second.click("#hx-stop")
        first.wait_for_function("window.hexctl.stopped === 'stop button'")
        # Standing again does not set it off: it walked by itself before.
        first.click("[data-do=stand]")
        first.wait_for_function("window.hexctl.stopped === null")
        first.wait_for_timeout(500)
        assert status(first)["velocity"] == [0, 0, 0]
        first.close()
        second.close()


def test_sticks_work_on_a_phone_and_stop_is_in_view(tmp_path: Path, browser: Browser) -> None:
    with playing(tmp_path) as play:
        played(play).cruise = (0.0, 0.0)
        for width, height in ((390, 844), (844, 390)):
            page = opened(browser, play, width, height, has_touch=True, is_mobile=True)
            for control in ("#hx-stop", "#hx-walk", "#hx-turn"):
                box = page.locator(control).bounding_box()
                assert box is not None
                assert box["x"] >= 0
                assert box["y"] >= 0
                assert box["x"] + box["width"] <= width
                assert box["y"] + box["height"] <= height
            box = page.locator("#hx-walk").bounding_box()
            assert box is not None
            x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
            page.mouse.move(x, y)
            page.mouse.down()
            page.mouse.move(x, y - 0.4 * box["height"])
            page.wait_for_function("window.hexctl.velocity[0] > 0.03")
            page.close()  # with the stick held
            until(lambda: play._session is not None and not play._session.drive.velocity.array.any())


def test_choices_take_effect_without_a_restart(tmp_path: Path) -> None:
    with playing(tmp_path) as play:
        robot = played(play)
        drive = robot.drive
        robot.soon(lambda: setattr(drive, "gait", "ripple"))
        until(lambda: drive.gait_now.slots == (2, 4, 6, 3, 1, 5))
        robot.soon(lambda: setattr(drive, "hold", "none"))
        robot.soon(lambda: play.change_recovery("walk-on"))
        until(lambda: play.recovery_name == "walk-on" and drive.hold == "none")
        robot.soon(lambda: robot.change_leg(5, Failure(leg=5, kind="limp")))
        until(lambda: bool(drive.noticed))
        assert drive.noticed[0].did == "walked on"
        robot.soon(lambda: robot.change_leg(5, None))
        until(lambda: not robot.simulation.failures)


def test_another_robot_in_another_world_beside_a_grey_one(tmp_path: Path) -> None:
    with playing(tmp_path, race=True) as play:
        first = played(play)
        rival = first.rival
        assert rival is not None
        until(lambda: first.drive.velocity.forward_m_s > 0.05)
        first.soon(lambda: first.change_leg(2, Failure(leg=2, kind="locked")))
        until(lambda: bool(first.drive.noticed))
        assert [one.leg for one in simulation_of(rival).failures] == [2]
        assert rival.gait_now == first.drive.gait
        assert first.drive.gait_now != first.drive.gait
        play.begin(robot="phantomx", world="steps", race=False)
        until(lambda: played(play) is not first)
        second = played(play)
        until(lambda: second.drive.mode == "driving")
        assert (second.drive.robot.name, second.rival) == ("phantomx", None)
        assert second._floor.heights_m is not None
        assert not second.simulation.failures
        assert play._panel is not None
        until(lambda: [one.value for one in play._panel._legs] == [INTACT] * 6)


def test_a_robot_file_that_is_gone_leaves_the_page_as_it_was(tmp_path: Path) -> None:
    with playing(tmp_path) as play:
        first = played(play)
        play.begin(robot=str(tmp_path / "none.yaml"))
        until(lambda: played(play) is not first)
        until(lambda: any("none.yaml" in line for line in played(play).log))
        assert played(play).drive.robot.name == "ant"


def test_a_push_moves_the_body_and_the_recording_has_it(tmp_path: Path) -> None:
    with playing(tmp_path) as play:
        robot = played(play)
        robot.cruise = (0.0, 0.0)
        until(lambda: robot.drive.at_rest and robot.drive.mode == "driving")
        assert "rrd" in play.record()
        before_m = robot.simulation.true_state().base_position_world
        assert before_m is not None
        robot.soon(lambda: robot.push(np.pi / 2))

        def moved_m() -> float:
            now_m = robot.simulation.true_state().base_position_world
            assert now_m is not None
            return float(now_m[1] - before_m[1])

        until(lambda: moved_m() > 0.004)
        shown: list[str] = []
        play.open_recording(shown.append)
        until(lambda: any("http://127.0.0.1" in text for text in shown))
        (path,) = tmp_path.glob("play-*.rrd")
        y_m = read_trial(path).base_position_world[:, 1]
        assert y_m.max() - y_m[0] > 0.004


def test_bad_options_are_refused(tmp_path: Path) -> None:
    for options in ({"robot": "nobody"}, {"world": "nowhere"}, {"recovery": "none"}):
        with pytest.raises(InputError, match=next(iter(options))):
            Play(PlayOptions(page_port=0, **options), runs=tmp_path)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="page_port"):
        PlayOptions(page_port=70_000)
    with playing(tmp_path) as play, pytest.raises(RobotFaultError, match="page"):
        Play(PlayOptions(page_port=play._server.port))


def test_ten_pages_a_flood_and_a_hidden_tab_leave_the_robot_its_ticks(
    tmp_path: Path, browser: Browser
) -> None:
    with playing(tmp_path) as play:
        page = opened(browser, play)
        own = Origin(play.url.rstrip("/"))
        viser_version = Subprotocol(f"viser-v{viser.__version__}")
        address = play.url.replace("http", "ws")
        with ExitStack() as stack:
            for _ in range(9):
                watcher = connect(address, origin=own, subprotocols=[viser_version], proxy=None)
                reader = threading.Thread(target=lambda one: list(one), args=(watcher,), daemon=True)
                stack.callback(watcher.close)
                reader.start()
            flooding = connect(address + "hexctl", origin=own, proxy=None)
            stack.callback(flooding.close_socket)
            flooding.socket.settimeout(0.1)
            with suppress(OSError, WebSocketException):
                for _ in range(5000):
                    flooding.send('{"v": [9, 9, "junk"]}')
            # Another tab in front: this one's timers and pictures rest.
            front = page.context.new_page()
            front.bring_to_front()
            ticks, at_s = play._session.drive.guard.clock.index, time.monotonic()  # type: ignore[union-attr]
            page.keyboard.down("ArrowUp")
            time.sleep(3.0)
            clock = play._session.drive.guard.clock  # type: ignore[union-attr]
            passed = (clock.index - ticks) * clock.period_s / (time.monotonic() - at_s)
            # Either it keeps 50 Hz, or it says how many ticks were late.
            assert passed > 0.97 or status(page)["late"] > 0
            page.bring_to_front()
            page.click("#hx-stop")
            until(lambda: played(play).drive.stopped == "stop button")
        page.close()


def test_ctrl_c_ends_it_with_a_complete_recording(tmp_path: Path, browser: Browser) -> None:
    with program(tmp_path, "play", "hexctl", "play", "--page-port", "0", "--no-open-browser") as running:
        running.wait_for("Ctrl-C ends it")
        url = next(word for word in running.said().split() if word.startswith("http://127.0.0.1"))
        page = browser.new_page()
        page.set_default_timeout(1000 * PATIENCE_S)
        page.goto(url)
        page.click("button:has-text('Record')")
        page.wait_for_selector("text=recording to")
        page.wait_for_timeout(1500)
        running.signal(signal.SIGINT)
        assert running.wait() == 130
        page.wait_for_function("document.getElementById('hx-what').textContent === 'not connected'")
        page.close()
    (path,) = tmp_path.glob("**/play-*.rrd")
    assert len(read_trial(path).time_s) > 50
    assert "Traceback" not in running.said()
