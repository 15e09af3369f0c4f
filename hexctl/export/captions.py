"""Text on pictures: a caption below one walk, and the names, messages and distances of a race."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexctl.palette import BACKGROUND, TEXT_COLOR, Color

Picture = NDArray[np.uint8]

#: Heights of a caption, of its letters, and of the smallest letters.
CAPTION_PX, LETTER_PX, SMALLEST_PX = 26, 14, 7

#: Heights of a line of text and of its letters, as shares of the picture's width.
BAR_SHARE, LETTER_SHARE = 0.068, 0.039

#: A message is shown on its colour for this long, and the winner's until the end.
FLASH_S = 1.3


@dataclass(frozen=True, slots=True)
class Message:
    """A message on a walk, shown from a time of the film on."""

    at_s: float
    text: str
    color: Color
    flash_s: float = FLASH_S


def make_caption(text: str, width_px: int) -> Picture:
    """A line of text as a bar below a picture, with smaller letters if necessary."""
    from PIL import Image, ImageDraw

    bar = Image.new("RGB", (width_px, CAPTION_PX), BACKGROUND)
    draw = ImageDraw.Draw(bar)
    font = fitted_font(draw, text, LETTER_PX, width_px - 8)
    draw.text((width_px / 2, CAPTION_PX / 2), text, fill=TEXT_COLOR, font=font, anchor="mm")
    return np.asarray(bar)


class RaceBar:
    """A line of text on a walk: its name, the newest message, and its distance."""

    def __init__(self, caption: str, width_px: int, messages: list[Message]) -> None:
        self.messages = messages
        self._caption, self._size_px = caption, (width_px, even_pixels(BAR_SHARE * width_px))
        self._letter_px = max(SMALLEST_PX, round(LETTER_SHARE * width_px))

    def draw(self, time_s: float, distance_m: float) -> Picture:
        """The line at a time of the film."""
        from PIL import Image, ImageDraw

        width_px, height_px = self._size_px
        bar = Image.new("RGB", self._size_px, BACKGROUND)
        draw, edge_px, middle_px = ImageDraw.Draw(bar), self._letter_px / 2, height_px / 2
        shown = [message for message in self.messages if message.at_s <= time_s]
        name_px = width_px * (0.4 if self.messages else 0.8) - edge_px
        font = fitted_font(draw, self._caption, self._letter_px, name_px)
        draw.text((edge_px, middle_px), self._caption, fill=TEXT_COLOR, font=font, anchor="lm")
        if math.isfinite(distance_m):
            counter = f"{distance_m:.2f} m"
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
