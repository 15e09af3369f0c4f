"""The page of `hexctl play`: a robot that has lost a leg, and walks on."""

import threading
from pathlib import Path

from hexctl.browser.play import Play
from hexctl.browser.play_options import PlayOptions
from hexctl.robot.failure import Failure
from hexctl.waiting import comes_true
from pictures.chromium import chromium
from pictures.picture import Picture

SIZE = {"width": 1200, "height": 760}

#: A page without a graphics card may take this long.
PATIENCE_S = 120.0

#: Walk before and after the failure is detected.
BEFORE_M, AFTER_M = 0.35, 0.4

BROKEN = Failure(leg=6, kind="locked")


def draw_play(folder: Path) -> Picture:
    """Break a leg in mid-walk, and wait until the robot has walked on without it."""
    ended = threading.Event()
    with Play(PlayOptions(page_port=0), runs=folder) as play, chromium() as browser:
        thread = threading.Thread(target=play.run, args=(ended.is_set,))
        thread.start()
        try:
            page = browser.new_page(viewport={"width": SIZE["width"], "height": SIZE["height"]})
            page.set_default_timeout(1000 * PATIENCE_S)
            page.goto(play.url + "?fixedDpr=1")  # as with a graphics card
            # The computer that draws is slow, not that of a reader.
            page.add_style_tag(content="#hx-late { display: none }")
            page.wait_for_function(f"window.hexctl && window.hexctl.distance_m > {BEFORE_M}")
            play.break_leg(BROKEN)
            page.wait_for_function("window.hexctl.failures.length > 0")
            walked_m = page.evaluate("window.hexctl.distance_m")
            page.wait_for_function(f"window.hexctl.distance_m > {walked_m + AFTER_M}")
            return Picture.from_png(page.screenshot(timeout=1000 * PATIENCE_S))
        finally:
            ended.set()
            comes_true(lambda: not thread.is_alive(), PATIENCE_S)
