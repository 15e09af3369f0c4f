"""Text on pictures: the name of a walk, its failures, and its time or distance."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexctl.palette import BACKGROUND, TEXT_COLOR, Color
from hexctl.recording.recorded_trial import RecordedTrial

Picture = NDArray[np.uint8]

#: Height of the smallest letters.
SMALLEST_PX = 7

#: Heights of a line of text and of its letters, as shares of the picture's width.
BAR_SHARE, LETTER_SHARE = 0.068, 0.039

#: A message is shown on its colour for this long, and the winner's until the end.
FLASH_S = 1.3

FAILED_BADGE: Color = (214, 52, 36)
DETECTED_BADGE: Color = (196, 120, 0)

#: Texts of failures, by the last word of the events of a recording.
VERBS = {
    "locked": "locks",
    "limp": "goes limp",
    "stuck": "sticks",
    "weak": "weakens",
    "missing": "breaks off",
}


@dataclass(frozen=True, slots=True)
class Message:
    """A message on a walk, shown from a time of the film on."""

    at_s: float
    text: str
    color: Color
    flash_s: float = FLASH_S


def messages_of(trial: RecordedTrial, start_s: float = 0.0) -> Iterator[Message]:
    """Failures, detections and reactions of a walk, in a film that begins at a second of its recording."""
    film_s = trial.time_s - start_s
    broke_s: dict[int, float] = {}
    for event in trial.events:
        found = re.match(r"world: (leg (\d)\b.*) (\w+)$", event.text)
        if found and found[3] in VERBS:
            broke_s[int(found[2])] = float(trial.walk_s[event.row])
            yield Message(float(film_s[event.row]), f"{found[1]} {VERBS[found[3]]}", FAILED_BADGE)
    for noticed in trial.noticed:
        if noticed["did"] != "walked on" and noticed["leg"] in broke_s:
            late_s = noticed["at_s"] - broke_s[noticed["leg"]]
            at_s = noticed["at_s"] + walk_begins_s(trial) - start_s
            yield Message(at_s, f"detected after {late_s:.1f} s", DETECTED_BADGE)


def walk_begins_s(trial: RecordedTrial) -> float:
    """Time of a recording at which the walk begins; 0 without a walk."""
    return float(trial.time_s[-1] - trial.walk_s[-1]) if trial.walk_s[-1] > 0 else 0.0


def color_changes_s(trial: RecordedTrial) -> list[float]:
    """Times of a recording at which the condition of a leg changes, which has a colour."""
    changes = np.flatnonzero((np.diff(trial.leg_conditions, axis=0) != 0).any(axis=1)) + 1
    return [float(at_s) for at_s in trial.time_s[changes]]


class TextBar:
    """A line of text on a walk: its name, the newest message, and a counter."""

    def __init__(self, caption: str, width_px: int, messages: list[Message]) -> None:
        self.messages = messages
        self._caption, self._size_px = caption, (width_px, even_pixels(BAR_SHARE * width_px))
        self._letter_px = max(SMALLEST_PX, round(LETTER_SHARE * width_px))

    def draw(self, time_s: float, counter: str) -> Picture:
        """The line at a time of the film, with a counter such as `0.52 m`."""
        from PIL import Image, ImageDraw

        width_px, height_px = self._size_px
        bar = Image.new("RGB", self._size_px, BACKGROUND)
        draw, edge_px, middle_px = ImageDraw.Draw(bar), self._letter_px / 2, height_px / 2
        shown = [message for message in self.messages if message.at_s <= time_s]
        name_px = width_px * (0.4 if self.messages else 0.8) - edge_px
        font = fitted_font(draw, self._caption, self._letter_px, name_px)
        draw.text((edge_px, middle_px), self._caption, fill=TEXT_COLOR, font=font, anchor="lm")
        font = fitted_font(draw, counter, self._letter_px, width_px / 5)
        draw.text((width_px - edge_px, middle_px), counter, fill=TEXT_COLOR, font=font, anchor="rm")
        if shown:
            self._draw_message(draw, shown[-1], flashes=time_s < shown[-1].at_s + shown[-1].flash_s)
        return np.asarray(bar)

    def _draw_message(self, draw: Any, message: Message, *, flashes: bool) -> None:
        width_px, height_px = self._size_px
        font = fitted_font(draw, message.text, self._letter_px, 0.38 * width_px)
        at, pad_px = (0.6 * width_px, height_px / 2), self._letter_px / 3
        if flashes:
            left, _, right, _ = draw.textbbox(at, message.text, font=font, anchor="mm")
            box = (left - pad_px, 0.12 * height_px, right + pad_px, 0.88 * height_px)
            draw.rounded_rectangle(box, radius=pad_px, fill=message.color)
        fill = TEXT_COLOR if flashes else _lighter(message.color)
        draw.text(at, message.text, fill=fill, font=font, anchor="mm")


def fitted_font(draw: Any, text: str, letter_px: int, room_px: float) -> Any:
    """Font in which a text fits, at most `letter_px` high."""
    from PIL import ImageFont

    while letter_px > SMALLEST_PX and draw.textlength(text, font=ImageFont.load_default(letter_px)) > room_px:
        letter_px -= 1
    return ImageFont.load_default(letter_px)


def even_pixels(pixels: float) -> int:
    """An even number of pixels, as videos need."""
    return 2 * max(1, round(pixels / 2))


def _lighter(color: Color) -> Color:
    red, green, blue = ((part + 255) // 2 for part in color)
    return red, green, blue
