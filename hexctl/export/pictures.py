"""Animations, drawn by MuJoCo without a screen: GIF and MP4 of one walk, or a race of two."""

from collections.abc import Iterator, Sequence
from itertools import chain
from pathlib import Path

import numpy as np

from hexctl.errors import InputError, MissingExtraError, argument
from hexctl.export import race
from hexctl.export.captions import Picture, TextBar, color_changes_s, even_pixels, messages_of, walk_begins_s
from hexctl.export.export_options import PictureOptions
from hexctl.export.race import RaceRenderer
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
    if options.captions and len(options.captions) != len(runs):
        got = f"{argument('captions')}: got {len(options.captions)} for {len(runs)} recordings"
        raise InputError(f"{got}; allowed: one for each")
    stage: Stage = _OneRun(runs[0], options) if len(runs) == 1 else _race(runs, options, times_s)
    try:
        pictures = _pictures(stage, times_s, on_progress)
        if gif:
            _write_gif(path, pictures, _sample(stage, times_s), fps)
        else:
            _write_mp4(path, pictures, fps)
    finally:
        stage.close()


def _race(runs: Sequence[RecordedTrial], options: PictureOptions, times_s: Sequence[float]) -> RaceRenderer:
    camera = options.camera or "side"
    if camera not in race.CAMERAS:
        raise InputError(
            f"{argument('camera')}: got {camera} for two recordings; allowed: {', '.join(race.CAMERAS)}"
        )
    return RaceRenderer(
        runs,
        _starts_s(runs),
        options.captions or [title_of(run) for run in runs],
        times_s,
        camera=camera,
        width_px=even_pixels(options.width_px or USUAL_WIDTH_PX),
    )


class _OneRun:
    """A walk with a line of text."""

    def __init__(self, run: RecordedTrial, options: PictureOptions) -> None:
        width_px = even_pixels(options.width_px or USUAL_WIDTH_PX)
        camera = options.camera or "follow"
        self._run = run
        self._renderer = RunRenderer(run, camera, width_px, even_pixels(width_px * HEIGHT_SHARE))
        caption = options.captions[0] if options.captions else title_of(run)
        self._bar = TextBar(caption, width_px, list(messages_of(run)))

    def picture(self, time_s: float) -> Picture:
        row = self._run.row_at(time_s)
        counter = f"{max(0.0, self._run.time_s[row] - walk_begins_s(self._run)):.1f} s"
        return np.vstack([self._renderer.draw(row), self._bar.draw(time_s, counter)])

    def moments_s(self) -> Sequence[float]:
        return [*color_changes_s(self._run), *(message.at_s for message in self._bar.messages)]

    def close(self) -> None:
        self._renderer.close()


#: Draws `picture` at a time of a film; colours and texts change at `moments_s`.
Stage = _OneRun | RaceRenderer


def _pictures(stage: Stage, times_s: Sequence[float], on_progress: OnProgress) -> Iterator[Picture]:
    """All pictures in order; each counts as done when the next one is requested."""
    for done, time_s in enumerate(times_s, start=1):
        yield stage.picture(time_s)
        on_progress(done, len(times_s))


def _sample(stage: Stage, times_s: Sequence[float]) -> Picture:
    evenly = np.linspace(0, len(times_s) - 1, PALETTE_FRAMES).astype(int)
    after = np.searchsorted(times_s, np.asarray(stage.moments_s(), dtype=float))
    shown = np.union1d(evenly, after[after < len(times_s)])
    return np.vstack([stage.picture(times_s[index]) for index in shown])


def _starts_s(runs: Sequence[RecordedTrial]) -> list[float]:
    """Second of each recording at which the film begins: two walks begin together."""
    walks_s = [walk_begins_s(run) for run in runs]
    return [walk_s - min(walks_s) for walk_s in walks_s]


def _times_s(runs: Sequence[RecordedTrial], options: PictureOptions, fps: float) -> list[float]:
    whole_s = max(float(run.time_s[-1]) - start_s for run, start_s in zip(runs, _starts_s(runs), strict=True))
    begins_s = 0.0
    if options.from_s is not None:
        walk_s = min(walk_begins_s(run) for run in runs)
        begins_s = walk_s + options.from_s
        if begins_s >= whole_s:
            allowed = f"below {whole_s - walk_s:g}"
            raise InputError(f"{argument('from_s')}: got {options.from_s:g}; allowed: {allowed}")
    length_s = whole_s - begins_s
    if options.duration_s is not None:
        length_s = min(length_s, options.duration_s)
    return [begins_s + index / fps for index in range(max(1, round(length_s * fps)))]


def _write_gif(path: Path, pictures: Iterator[Picture], sample: Picture, fps: float) -> None:
    """Pictures share one palette without dithering, so that static areas compress to nothing."""
    try:
        from PIL import Image
    except ModuleNotFoundError as error:
        raise MissingExtraError("a GIF", "pictures") from error
    palette = Image.fromarray(sample).quantize(GIF_COLORS, method=Image.Quantize.FASTOCTREE)
    (first, *more) = (
        Image.fromarray(picture).quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures
    )
    duration_ms = round(1000 / fps)
    first.save(path, "GIF", save_all=True, append_images=more, duration=duration_ms, loop=0, optimize=False)


def _write_mp4(path: Path, pictures: Iterator[Picture], fps: float) -> None:
    try:
        import av
    except ModuleNotFoundError as error:
        raise MissingExtraError("an MP4", "pictures") from error
    from fractions import Fraction

    with av.open(str(path), "w", format="mp4", options={"movflags": "faststart"}) as file:
        stream = file.add_stream("libx264", rate=Fraction(fps).limit_denominator(1000))
        first = next(pictures)
        stream.height, stream.width = first.shape[:2]
        stream.pix_fmt = "yuv420p"
        stream.options = {"crf": "20", "preset": "medium"}
        for picture in chain([first], pictures):
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")
            file.mux(stream.encode(frame))
        file.mux(stream.encode())
