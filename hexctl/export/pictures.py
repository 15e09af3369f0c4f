"""Pictures that move, drawn by MuJoCo itself without a screen: GIF and MP4 of one walk, or of two abreast."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hexctl.errors import InputError, MissingExtraError, argument
from hexctl.export.recordings import OnProgress, Trials, title_of
from hexctl.export.render import CAMERAS, RunRenderer
from hexctl.palette import BACKGROUND, TEXT_COLOR
from hexctl.record.recorded_trial import RecordedTrial


@dataclass(frozen=True, slots=True, kw_only=True)
class PictureOptions:
    """How GIF and MP4 look.

    Attributes:
        camera: `side`, `top` or `follow`.
        width_px: width of the picture; two runs share it.
        fps: pictures per second; None for 20 in a GIF and 50 in an MP4.
        from_s: first second of the recording that is shown.
        duration_s: how much of it is shown; None for all of it.
        captions: a line below each run; None for its robot and failure.
    """

    camera: str = "follow"
    width_px: int = 480
    fps: float | None = None
    from_s: float = 0.0
    duration_s: float | None = None
    captions: tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        if self.camera not in CAMERAS:
            raise InputError(f"{argument('camera')}: got {self.camera}; allowed: {', '.join(CAMERAS)}")
        ranges = {
            "width_px": WIDTHS_PX,
            "fps": RATES_HZ,
            "from_s": (0, math.inf),
            "duration_s": (0, math.inf),
        }
        for name, (low, high) in ranges.items():
            value = getattr(self, name)
            if value is not None and not low <= value <= high:
                raise InputError(f"{argument(name)}: got {value:g}; allowed: {low:g} to {high:g}")


#: Ranges of widths and of pictures per second.
WIDTHS_PX, RATES_HZ = (64, 1920), (1, 50)
#: Pictures per second where none are asked for: a GIF is several times as large as an MP4.
GIF_FPS, MP4_FPS = 20.0, 50.0

#: Height of a pane by its width: one run, and two abreast.
ONE_PANE, TWO_PANES = 0.75, 1.0
#: Height of a caption, and that of its letters.
CAPTION_PX, LETTER_PX = 26, 14

#: Colours of a GIF, and the pictures from which they are taken.
GIF_COLORS, PALETTE_FRAMES = 48, 6

Picture = NDArray[np.uint8]


def write_pictures(trials: Trials, path: Path, options: PictureOptions, on_progress: OnProgress) -> None:
    """Draw one walk, or two abreast, into a new GIF or MP4, by the ending of its name.

    Walks that stand abreast begin to walk at the same moment; the shorter one stands still at its end.

    Raises InputError for more runs or other captions than that, MissingExtraError without MuJoCo, Pillow or
    PyAV, and HexctlError where the machine has nothing that draws without a screen.
    """
    if len(trials) > 2:
        raise InputError(f"export: got {len(trials)} recordings; allowed: one, or two abreast")
    runs = list(trials)
    captions = _captions(runs, options.captions)
    gif = path.suffix == ".gif"
    fps = options.fps or (GIF_FPS if gif else MP4_FPS)
    if gif:
        fps = 100 / round(100 / fps)  # a GIF counts in hundredths of a second
    times_s = _times_s(runs, options, fps)
    with _Panes(runs, captions, options) as panes:
        (_write_gif if gif else _write_mp4)(path, _Film(panes, times_s, fps, on_progress))


class _Panes:
    """Draws all runs at a time of the film into one picture."""

    def __init__(
        self, runs: Sequence[RecordedTrial], captions: Sequence[str] | None, options: PictureOptions
    ) -> None:
        width_px = _even(options.width_px / len(runs))
        height_px = _even(width_px * (ONE_PANE if len(runs) == 1 else TWO_PANES))
        self._runs, self._starts_s = runs, _starts_s(runs)
        self._renderers: list[RunRenderer] = []
        self._bars = None if captions is None else [_caption(text, width_px) for text in captions]
        self._size_px, self._camera = (width_px, height_px), options.camera

    def __enter__(self) -> "_Panes":
        for run in self._runs:
            self._renderers.append(RunRenderer(run, self._camera, *self._size_px))
        return self

    def __exit__(self, *_: object) -> None:
        for renderer in self._renderers:
            renderer.close()

    def picture(self, time_s: float) -> Picture:
        """The picture at a time, (height, width, 3)."""
        panes = []
        for index, renderer in enumerate(self._renderers):
            pane = renderer.draw(int(self._rows(index, [time_s])[0]))
            panes.append(pane if self._bars is None else np.vstack([pane, self._bars[index]]))
        return np.hstack(panes)

    def first_of_each_look(self, times_s: Sequence[float]) -> NDArray[np.intp]:
        """Indices of the first times at which legs are drawn in the colours of other conditions."""
        conditions = [run.leg_conditions[self._rows(index, times_s)] for index, run in enumerate(self._runs)]
        return np.asarray(np.unique(np.hstack(conditions), axis=0, return_index=True)[1])

    def _rows(self, index: int, times_s: Sequence[float]) -> NDArray[np.intp]:
        """Ticks of a run that are shown at times."""
        run = self._runs[index]
        shown_s = np.asarray(times_s) + self._starts_s[index] + 1e-6
        return np.asarray(np.clip(np.searchsorted(run.time_s, shown_s, side="right") - 1, 0, len(run) - 1))


@dataclass(frozen=True, slots=True)
class _Film:
    """A film that is to be written: what draws it, the times of its pictures, and their number per second."""

    panes: _Panes
    times_s: Sequence[float]
    fps: float
    on_progress: OnProgress

    def pictures(self) -> Iterator[Picture]:
        """All pictures in order; each counts as done when the next one is asked for."""
        for done, time_s in enumerate(self.times_s, start=1):
            yield self.panes.picture(time_s)
            self.on_progress(done, len(self.times_s))

    def sample(self) -> Picture:
        """A few pictures, one below another, with all colours of the film."""
        evenly = np.linspace(0, len(self.times_s) - 1, PALETTE_FRAMES).astype(int)
        missed = np.setdiff1d(self.panes.first_of_each_look(self.times_s), evenly)
        return np.vstack([self.panes.picture(self.times_s[index]) for index in (*evenly, *missed)])


def _starts_s(runs: Sequence[RecordedTrial]) -> list[float]:
    """Second of each recording at which the film begins: two walks begin together."""
    if len(runs) == 1:
        return [0.0]
    before_s = [float(run.time_s[-1] - run.walk_s[-1]) for run in runs]
    return [one - min(before_s) for one in before_s]


def _times_s(runs: Sequence[RecordedTrial], options: PictureOptions, fps: float) -> list[float]:
    """Times of the pictures in the film's own seconds."""
    whole_s = max(float(run.time_s[-1]) - start_s for run, start_s in zip(runs, _starts_s(runs), strict=True))
    if options.from_s >= whole_s:
        raise InputError(f"{argument('from_s')}: got {options.from_s:g}; allowed: below {whole_s:g}")
    length_s = whole_s - options.from_s
    if options.duration_s is not None:
        length_s = min(length_s, options.duration_s)
    return [options.from_s + index / fps for index in range(max(1, round(length_s * fps)))]


def _captions(runs: Sequence[RecordedTrial], given: tuple[str, ...] | None) -> Sequence[str] | None:
    """A line for each run; none for a single run unless it is given."""
    if given is not None:
        if len(given) != len(runs):
            raise InputError(
                f"{argument('captions')}: got {len(given)} for {len(runs)} recordings; allowed: one for each"
            )
        return given
    return None if len(runs) == 1 else [title_of(run) for run in runs]


def _caption(text: str, width_px: int) -> Picture:
    """A line of text as a bar below a picture, smaller where it does not fit."""
    from PIL import Image, ImageDraw, ImageFont

    bar = Image.new("RGB", (width_px, CAPTION_PX), BACKGROUND)
    draw, size_px = ImageDraw.Draw(bar), LETTER_PX
    while size_px > 7 and draw.textlength(text, font=ImageFont.load_default(size_px)) > width_px - 8:
        size_px -= 1
    font = ImageFont.load_default(size_px)
    draw.text((width_px / 2, CAPTION_PX / 2), text, fill=TEXT_COLOR, font=font, anchor="mm")
    return np.asarray(bar)


def _write_gif(path: Path, film: _Film) -> None:
    """Write a GIF whose pictures share one set of colours, undithered: what does not move costs nothing."""
    try:
        from PIL import Image
    except ModuleNotFoundError as error:
        raise MissingExtraError("a GIF", "pictures") from error
    palette = Image.fromarray(film.sample()).quantize(GIF_COLORS, method=Image.Quantize.FASTOCTREE)
    (first, *more) = (
        Image.fromarray(picture).quantize(palette=palette, dither=Image.Dither.NONE)
        for picture in film.pictures()
    )
    duration_ms = round(1000 / film.fps)
    first.save(path, save_all=True, append_images=more, duration=duration_ms, loop=0, optimize=False)


def _write_mp4(path: Path, film: _Film) -> None:
    """Write an MP4 (H.264) that browsers and slides play."""
    try:
        import av
    except ModuleNotFoundError as error:
        raise MissingExtraError("an MP4", "pictures") from error
    from fractions import Fraction

    height_px, width_px = film.panes.picture(film.times_s[0]).shape[:2]
    with av.open(str(path), "w", options={"movflags": "faststart"}) as file:
        stream = file.add_stream("libx264", rate=Fraction(film.fps).limit_denominator(1000))
        stream.width, stream.height, stream.pix_fmt = width_px, height_px, "yuv420p"
        stream.options = {"crf": "20", "preset": "medium"}
        for picture in film.pictures():
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")
            file.mux(stream.encode(frame))
        file.mux(stream.encode())


def _even(pixels: float) -> int:
    """An even number of pixels, as videos need."""
    return 2 * max(1, round(pixels / 2))
