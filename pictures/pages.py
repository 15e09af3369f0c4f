"""The pages that move a robot, as a phone and a desktop show them."""

import re
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from playwright.sync_api import Page

from hexctl.backends.mock import MockServos
from hexctl.backends.pwm.pulse_board import pwm_map_of
from hexctl.control.drive.drive import Drive
from hexctl.robot.configs import find_config
from hexctl.robot.loader import load_robot_file
from hexctl.simulators.pca9685_board import Pca9685Board
from hexctl.teleop.calibration_page import calibrate_on_page
from hexctl.teleop.control_page import ControlPage, page_html
from hexctl.teleop.drive_session import DriveSession
from hexctl.teleop.page_options import PagedCalibrationOptions
from hexctl.testing.family_conformance import running
from hexctl.waiting import wait_for
from hexctl.wire.page_address import PageAddress
from pictures.chromium import chromium
from pictures.picture import Picture

PHONE, DESKTOP, STARTS_S = (390, 720), (860, 930), 60.0


#: Runs a robot with a page; it takes a call that is told the address, and one that asks for the end.
Run = Callable[[Callable[[str], None], Callable[[], bool]], object]


@contextmanager
def _opened(run: Run, size: tuple[int, int]) -> Iterator[Page]:
    """The page of a robot that runs in a thread meanwhile."""
    addresses, end = list[str](), threading.Event()
    thread = threading.Thread(target=run, args=(addresses.append, end.is_set))
    thread.start()
    try:
        wait_for(lambda: addresses, STARTS_S, "no page is served")
        with chromium() as browser:
            view = {"width": size[0], "height": size[1]}
            page = browser.new_page(viewport=view, device_scale_factor=1.5)  # type: ignore[arg-type]
            page.goto(re.findall(r"http://\S+?/", addresses[0])[0])
            yield page
    finally:
        end.set()
        thread.join()


def _wait(page: Page, expression: str) -> None:
    """Wait until an expression is true in a page, whose policy allows it no polling of its own."""
    deadline_s = time.monotonic() + STARTS_S
    while not page.evaluate(expression):
        if time.monotonic() > deadline_s:
            raise RuntimeError(f"the page: not {expression}")
        page.wait_for_timeout(50)


def _drive(say: Callable[[str], None], ended: Callable[[], bool]) -> None:
    with Drive("phantomx", realtime=True, failure="5:locked") as drive:
        session = DriveSession(drive)
        source = drive.arbiter.source("page")
        with ControlPage(
            PageAddress("127.0.0.1", 0), page_html("drive"), source, drive.share, session.ask
        ) as page:
            say(page.url)
            session.run([page], ended)


def draw_drive_phone(_: Path) -> Picture:
    """A phone whose left thumb walks a robot with a failed leg."""
    with _opened(_drive, PHONE) as page:
        stick = page.locator("#walk").bounding_box()
        _wait(page, "seen && seen.legs.length")
        if stick is not None:
            page.mouse.move(stick["x"] + stick["width"] * 0.6, stick["y"] + stick["height"] * 0.2)
            page.mouse.down()
        _wait(page, "seen.legs.filter(leg => leg.state === 'air').length > 1")
        return Picture.from_png(page.screenshot())


def draw_calibration(folder: Path) -> Picture:
    """The calibration of a robot with a simulated PCA9685, its femur lit."""
    file = folder / "freenove-big.yaml"
    file.write_bytes(find_config("robots", "freenove-big").read_bytes())
    robot = load_robot_file(file)
    board = Pca9685Board(MockServos(robot.robot), pwm_map_of(robot.content.servos, "pca9685"))
    options = PagedCalibrationOptions(page="127.0.0.1:0", port=board.path)

    def calibrate(say: Callable[[str], None], ended: Callable[[], bool]) -> None:
        calibrate_on_page(file, options, say=say, stop_requested=ended)

    with running(board), _opened(calibrate, DESKTOP) as page:
        for request in ("start", "choose 3", "save", "choose 4"):
            _wait(page, "now && now.owner === 'you'")
            page.evaluate("request => send({ do: request })", request)
        _wait(page, "now.joint === 4 && now.begun && now.saved.length")
        page.keyboard.down("Shift")
        page.keyboard.down("ArrowUp")
        _wait(page, "now.angle_deg > 35")
        page.keyboard.up("ArrowUp")
        page.wait_for_timeout(300)
        return Picture.from_png(page.screenshot())
