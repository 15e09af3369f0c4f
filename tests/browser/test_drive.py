"""`hexctl drive --page` in a real browser: the robot is drawn, driven, stopped, on phones too."""

import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest
from playwright.sync_api import Browser, Page

from hexctl.control.drive.drive import Drive
from hexctl.teleop.control_page import ControlPage, page_html
from hexctl.teleop.drive_session import DriveSession
from hexctl.wire.page_address import PageAddress
from tests.browser.pages import PATIENCE_S, PHONES, always_in_reach, drawn, open_page, until

pytestmark = pytest.mark.realtime

#: Colours in which the page draws the body, and a failed leg.
BODY, FAILED = (51, 71, 92), (216, 67, 59)


class Driving:
    """A simulated robot with a page, in a thread of the test."""

    def __init__(self) -> None:
        self.url, self._failed = "", list[BaseException]()
        self._ready, self._end = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._run)

    def _run(self) -> None:
        try:
            with Drive("ant", realtime=True, failure="5:locked") as self.drive:
                self.session = DriveSession(self.drive)
                source = self.drive.arbiter.source("page")
                address = PageAddress("127.0.0.1", 0)
                with ControlPage(
                    address, page_html("drive"), source, self.drive.share, self.session.ask
                ) as page:
                    self.url = page.url
                    self._ready.set()
                    self.session.run([page], self._end.is_set)
        except BaseException as error:  # noqa: BLE001  raised at the end
            self._failed.append(error)
        finally:
            self._ready.set()

    def __enter__(self) -> "Driving":
        self._thread.start()
        assert self._ready.wait(PATIENCE_S)
        return self

    def __exit__(self, *error: object) -> None:
        self._end.set()
        self._thread.join(PATIENCE_S)
        if self._failed:
            raise self._failed[0]


@pytest.fixture
def driving() -> Iterator[Driving]:
    with Driving() as driven:
        yield driven


def middle(page: Page, selector: str) -> tuple[float, float]:
    box = page.locator(selector).bounding_box()
    assert box is not None
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def walks(page: Page, driving: Driving) -> None:
    until(page, lambda: abs(driving.drive.velocity.forward_m_s) > 0.005, "it does not walk")


def rests(page: Page, driving: Driving) -> None:
    until(page, lambda: driving.drive.velocity.forward_m_s == 0, "it does not rest")


def connected(browser: Browser, driving: Driving, **options: Any) -> Page:
    page = open_page(browser, driving.url, **options)
    until(page, lambda: "ant" in page.inner_text("#what"), "no status comes")
    return page


@pytest.mark.parametrize("way", PHONES)
def test_on_a_phone_the_robot_is_seen_driven_and_stopped(
    way: str, driving: Driving, browser: Browser
) -> None:
    page = connected(browser, driving, size=PHONES[way], touch=True)
    for selector in ("#stop", "#walk", "#turn"):
        assert always_in_reach(page, selector), selector
    assert page.evaluate("document.documentElement.scrollHeight <= innerHeight")
    until(page, lambda: drawn(page, "robot", BODY) > 200, "no robot is drawn")
    assert drawn(page, "robot", FAILED) > 60
    finger = page.context.new_cdp_session(page)
    x, y = middle(page, "#walk")
    finger.send("Input.dispatchTouchEvent", {"type": "touchStart", "touchPoints": [{"x": x, "y": y - 40}]})
    walks(page, driving)
    assert always_in_reach(page, "#stop")
    until(page, lambda: page.evaluate("seen.legs.some(leg => leg.state === 'air')"), "no foot is lifted")
    finger.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
    rests(page, driving)
    x, y = middle(page, "#stop")
    finger.send("Input.dispatchTouchEvent", {"type": "touchStart", "touchPoints": [{"x": x, "y": y}]})
    until(page, lambda: driving.drive.stopped == "stop button", "it is not stopped")
    until(page, lambda: "stopped" in page.inner_text("#said"), "nothing is said of the stop")


def test_a_page_closed_in_mid_drive_leaves_the_robot_at_rest(driving: Driving, browser: Browser) -> None:
    page, other = connected(browser, driving), connected(browser, driving)
    x, y = middle(page, "#walk")
    page.mouse.move(x, y - 40)
    page.mouse.down()
    walks(other, driving)
    until(other, lambda: "driven by 127.0.0.1" in other.inner_text("#speed"), "it does not say who drives")
    page.context.close()
    rests(other, driving)


def test_a_page_of_another_origin_drives_nothing(driving: Driving, browser: Browser) -> None:
    foreign = browser.new_page()
    foreign.route("http://other.test/", lambda route: route.fulfill(body="other", content_type="text/html"))
    foreign.goto("http://other.test/")
    outcome = foreign.evaluate(
        """url => new Promise(done => {
          const socket = new WebSocket(url.replace(/^http/, "ws") + "drive", ["hexctl.drive.1"]);
          socket.onopen = () => { socket.send('{"v": [1, 0, 0]}'); done("open"); };
          socket.onerror = () => done("refused");
        })""",
        driving.url,
    )
    assert outcome == "refused"
    time.sleep(0.5)
    assert driving.drive.velocity.forward_m_s == 0
    assert driving.drive.decision.source is None
