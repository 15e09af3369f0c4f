"""Animations, drawn by MuJoCo without a screen: GIF and MP4 of one walk, or a race of two."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from hexctl.errors import InputError, MissingExtraError, argument
from hexctl.export import race
from hexctl.export.captions import Picture, TextBar, even_pixels, messages_of
from hexctl.export.export_options import PictureOptions
from hexctl.export.recordings import OnProgress, Trials, title_of
from hexctl.export.render import RunRenderer
from hexctl.recording.recorded_trial import RecordedTrial

#: Default width of a picture.
USUAL_WIDTH_PX = 480

#: Default pictures per second: a GIF is several times as large as an MP4.
GIF_FPS, MP4_FPS = 20.0, 50.0

#: Height of a picture of one run, as a share of its width.
HEIGHT_SHARE = 0.75
#: Colours of a GIF, and the number of pictures from which they are taken.
GIF_COLORS, PALETTE_FRAMES = 48, 6


def write_pictures(
    trials: Trials, path: Path, kind: str, options: PictureOptions, on_progress: OnProgress
) -> None:
    """Draw one walk, or two as a race, into a new file; `kind` is `gif` or `mp4`.

    The walks of a race begin at the same moment; the shorter one stands still at its end.

    Raises InputError for more runs, and for unsuitable captions or cameras, MissingExtraError without MuJoCo,
    Pillow or PyAV, and HexctlError if the machine cannot draw without a screen.
    """
    if len(trials) > 2:
        raise InputError(f"export: got {len(trials)} recordings; allowed: one, or two for a race")
    runs = list(trials)
    gif = kind == "gif"
    fps = options.fps or (GIF_FPS if gif else MP4_FPS)
    if gif:
        fps = 100 / round(100 / fps)  # a GIF counts in hundredths of a second
    times_s = _times_s(runs, options, fps)
    _check_captions(options.captions, runs)
    stage = _OneRun(runs[0], options) if len(runs) == 1 else _Race(runs, options, times_s)
    try:
        (_write_gif if gif else _write_mp4)(path, _Film(stage, times_s, fps, on_progress))
    finally:
        stage.close()


class _Stage(Protocol):
    """Draws pictures of a film."""

    def picture(self, time_s: float) -> Picture:
        """The picture at a time, (height, width, 3)."""

    def moments_s(self) -> Sequence[float]:
        """Times of changed colours."""

    def close(self) -> None:
        """Free its resources."""


class _OneRun:
    def __init__(self, run: RecordedTrial, options: PictureOptions) -> None:
        width_px = even_pixels(options.width_px or USUAL_WIDTH_PX)
        camera = options.camera or "follow"
        self._run = run
        self._renderer = RunRenderer(run, camera, width_px, even_pixels(width_px * HEIGHT_SHARE))
        caption = options.captions[0] if options.captions else title_of(run)
        self._bar = TextBar(caption, width_px, list(messages_of(run)))

    def picture(self, time_s: float) -> Picture:
        scene = self._renderer.draw(self._run.row_at(time_s))
        return np.vstack([scene, self._bar.draw(time_s, f"{time_s:.1f} s")])

    def moments_s(self) -> Sequence[float]:
        return [*_color_changes_s(self._run), *(message.at_s for message in self._bar.messages)]

    def close(self) -> None:
        self._renderer.close()


class _Race:
    def __init__(
        self, runs: Sequence[RecordedTrial], options: PictureOptions, times_s: Sequence[float]
    ) -> None:
        camera, starts_s = options.camera or "side", _starts_s(runs)
        if camera not in race.CAMERAS:
            raise InputError(
                f"{argument('camera')}: got {camera} for two recordings; allowed: {', '.join(race.CAMERAS)}"
            )
        self._runs, self._starts_s = runs, starts_s
        self._renderer = race.RaceRenderer(
            runs,
            starts_s,
            options.captions or [title_of(run) for run in runs],
            times_s,
            camera=camera,
            width_px=even_pixels(options.width_px or USUAL_WIDTH_PX),
        )

    def picture(self, time_s: float) -> Picture:
        return self._renderer.draw(time_s)

    def moments_s(self) -> Sequence[float]:
        pairs = zip(self._runs, self._starts_s, strict=True)
        changes_s = [at_s - start_s for run, start_s in pairs for at_s in _color_changes_s(run)]
        return [*changes_s, *self._renderer.moments_s]

    def close(self) -> None:
        self._renderer.close()


def _color_changes_s(run: RecordedTrial) -> list[float]:
    changes = np.flatnonzero((np.diff(run.leg_conditions, axis=0) != 0).any(axis=1)) + 1
    return [float(at_s) for at_s in run.time_s[changes]]


@dataclass(frozen=True, slots=True)
class _Film:
    stage: _Stage
    times_s: Sequence[float]
    fps: float
    on_progress: OnProgress

    def pictures(self) -> Iterator[Picture]:
        """All pictures in order; each counts as done when the next one is requested."""
        for done, time_s in enumerate(self.times_s, start=1):
            yield self.stage.picture(time_s)
            self.on_progress(done, len(self.times_s))

    def sample(self) -> Picture:
        evenly = np.linspace(0, len(self.times_s) - 1, PALETTE_FRAMES).astype(int)
        after = np.searchsorted(self.times_s, np.asarray(self.stage.moments_s(), dtype=float))
        shown = np.union1d(evenly, after[after < len(self.times_s)])
        return np.vstack([self.stage.picture(self.times_s[index]) for index in shown])


def _starts_s(runs: Sequence[RecordedTrial]) -> list[float]:
    """Second of each recording at which the film begins: two walks begin together."""
    if len(runs) == 1:
        return [0.0]
    before_s = [float(run.time_s[-1] - run.walk_s[-1]) for run in runs]
    return [one - min(before_s) for one in before_s]


def _times_s(runs: Sequence[RecordedTrial], options: PictureOptions, fps: float) -> list[float]:
    whole_s = max(float(run.time_s[-1]) - start_s for run, start_s in zip(runs, _starts_s(runs), strict=True))
    from_s = options.from_s or 0.0
    if from_s >= whole_s:
        raise InputError(f"{argument('from_s')}: got {from_s:g}; allowed: below {whole_s:g}")
    length_s = whole_s - from_s
    if options.duration_s is not None:
        length_s = min(length_s, options.duration_s)
    return [from_s + index / fps for index in range(max(1, round(length_s * fps)))]


def _check_captions(captions: Sequence[str], runs: Sequence[RecordedTrial]) -> None:
    if captions and len(captions) != len(runs):
        raise InputError(
            f"{argument('captions')}: got {len(captions)} for {len(runs)} recordings; allowed: one for each"
        )


def _write_gif(path: Path, film: _Film) -> None:
    """Pictures share one palette without dithering, so that static areas compress to nothing."""
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
    first.save(path, "GIF", save_all=True, append_images=more, duration=duration_ms, loop=0, optimize=False)


def _write_mp4(path: Path, film: _Film) -> None:
    try:
        import av
    except ModuleNotFoundError as error:
        raise MissingExtraError("an MP4", "pictures") from error
    from fractions import Fraction

    height_px, width_px = film.stage.picture(film.times_s[0]).shape[:2]
    with av.open(str(path), "w", format="mp4", options={"movflags": "faststart"}) as file:
        stream = file.add_stream("libx264", rate=Fraction(film.fps).limit_denominator(1000))
        stream.width, stream.height, stream.pix_fmt = width_px, height_px, "yuv420p"
        stream.options = {"crf": "20", "preset": "medium"}
        for picture in film.pictures():
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")
            file.mux(stream.encode(frame))
        file.mux(stream.encode())
