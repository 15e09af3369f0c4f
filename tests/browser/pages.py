"""Pages that move a robot, in Chromium: opened, held, measured."""

import time
from collections.abc import Callable

from playwright.sync_api import Browser, Page

#: A page without a graphics card on a busy computer.
PATIENCE_S = 60.0

PHONES = {"upright": (390, 844), "on its side": (844, 390)}


def open_page(
    browser: Browser, url: str, size: tuple[int, int] = (1000, 800), *, touch: bool = False
) -> Page:
    """A page of its own browser profile."""
    view = {"width": size[0], "height": size[1]}
    page = browser.new_context(viewport=view, has_touch=touch).new_page()  # type: ignore[arg-type]
    page.goto(url)
    return page


def until(page: Page, done: Callable[[], bool], what: str) -> None:
    """Let the page run until something is so."""
    deadline_s = time.monotonic() + PATIENCE_S
    while not done():
        assert time.monotonic() < deadline_s, what
        page.wait_for_timeout(30)


def always_in_reach(page: Page, selector: str) -> bool:
    """Whether an element lies in the window completely, and nothing above it."""
    return bool(
        page.evaluate(
            """selector => {
              const one = document.querySelector(selector), box = one.getBoundingClientRect();
              const inside = box.width > 40 && box.height > 30 && box.left >= 0 && box.top >= 0
                && box.right <= innerWidth && box.bottom <= innerHeight;
              const middle = box.top + box.height / 2;
              const at = x => one.contains(document.elementFromPoint(box.left + x * box.width, middle));
              return inside && at(.1) && at(.5) && at(.9);
            }""",
            selector,
        )
    )


def drawn(page: Page, canvas: str, color: tuple[int, int, int]) -> int:
    """Number of pixels of a canvas near a colour."""
    return int(
        page.evaluate(
            """([id, color]) => {
              const canvas = document.getElementById(id);
              const data = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
              let count = 0;
              const near = k => color.every((value, c) => Math.abs(data[k + c] - value) < 12);
              for (let k = 0; k < data.length; k += 4) if (data[k + 3] > 200 && near(k)) count++;
              return count;
            }""",
            [canvas, list(color)],
        )
    )
