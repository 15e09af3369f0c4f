"""GIF and MP4: times, captions and files. A stand-in draws, but where real pictures are the matter."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from PIL import Image, ImageSequence

from hexctl.errors import InputError
from hexctl.export.export_options import PictureOptions
from hexctl.export.pictures import write_pictures
from hexctl.export.render import NoRendererError, open_context
from hexctl.recording.recorded_trial import LEG_CONDITIONS, RecordedTrial


class Drawn:
    """Stands in for the renderer: a picture whose brightness is the tick, and a note of what was drawn."""

    rows: list[int]

    def __init__(self, trial: RecordedTrial, camera: str, width_px: int, height_px: int) -> None:
        self.size_px, self.camera = (width_px, height_px), camera

    def draw(self, row: int) -> Any:
        Drawn.rows.append(row)
        width_px, height_px = self.size_px
        return np.full((height_px, width_px, 3), min(row, 250), dtype=np.uint8)

    def close(self) -> None:
        pass


@pytest.fixture
def drawn(monkeypatch: Any) -> type[Drawn]:
    Drawn.rows = []
    monkeypatch.setattr("hexctl.export.pictures.RunRenderer", Drawn)
    return Drawn


def write(path: Path, *runs: RecordedTrial, **options: Any) -> list[tuple[int, int]]:
    told: list[tuple[int, int]] = []
    write_pictures(list(runs), path, PictureOptions(**options), lambda *one: told.append(one))
    return told


@pytest.mark.usefixtures("drawn")
def test_a_gif_takes_as_long_as_the_walk(walk: RecordedTrial, tmp_path: Path) -> None:
    told = write(tmp_path / "a.gif", walk, width_px=96)
    with Image.open(tmp_path / "a.gif") as gif:
        assert gif.size == (96, 72)
        assert gif.info["loop"] == 0
        # Pictures that do not differ from the one before are one that stays longer.
        shown_ms = sum(frame.info["duration"] for frame in ImageSequence.Iterator(gif))
    assert shown_ms / 1000 == pytest.approx(walk.time_s[-1], abs=0.05)
    assert told[-1][0] == told[-1][1] == shown_ms / 50


def test_a_part_of_the_walk(walk: RecordedTrial, tmp_path: Path, drawn: Any) -> None:
    write(tmp_path / "a.gif", walk, from_s=1.0, duration_s=0.5, fps=10, width_px=64)
    assert set(drawn.rows) == {50, 55, 60, 65, 70}
    with pytest.raises(InputError, match="from_s: got 99; allowed: below"):
        write(tmp_path / "b.gif", walk, from_s=99.0)


@pytest.mark.usefixtures("drawn")
def test_an_mp4_that_decodes(walk: RecordedTrial, tmp_path: Path) -> None:
    write(tmp_path / "a.mp4", walk, duration_s=1.0, width_px=97, captions=("slow",))
    with av.open(str(tmp_path / "a.mp4")) as file:
        stream = file.streams.video[0]
        assert stream.codec_context.name == "h264"
        frames = [frame.to_ndarray(format="rgb24") for frame in file.decode(video=0)]
        assert stream.average_rate == 50
    assert len(frames) == 50
    assert frames[0].shape[1] in (96, 98)
    assert frames[40].mean() > frames[0].mean()


@pytest.mark.usefixtures("drawn")
def test_captions(walk: RecordedTrial, tmp_path: Path) -> None:
    write(tmp_path / "a.gif", walk, duration_s=0.2, captions=("a caption",), width_px=100)
    with Image.open(tmp_path / "a.gif") as gif:
        picture = np.asarray(gif.convert("L"))
    assert picture.shape == (76 + 26, 100)
    assert np.ptp(picture[76:].astype(int)) > 50
    with pytest.raises(InputError, match="captions: got 1 for 2 recordings"):
        write(tmp_path / "b.gif", walk, walk, captions=("one",))


def test_what_is_out_of_range_is_refused(walk: RecordedTrial, tmp_path: Path) -> None:
    cases: tuple[tuple[dict[str, Any], str], ...] = (
        ({"camera": "below"}, "camera: got below; allowed: side, top, follow"),
        ({"width_px": 20}, "width_px: got 20; allowed: 64 to 1920"),
        ({"fps": 200.0}, "fps: got 200; allowed: 1 to 50"),
    )
    for options, told in cases:
        with pytest.raises(InputError, match=told):
            PictureOptions(**options)
    with pytest.raises(InputError, match="got 3 recordings; allowed: one, or two for a race"):
        write(tmp_path / "a.gif", walk, walk, walk)
    with pytest.raises(InputError, match="camera: got follow for two recordings; allowed: side, top"):
        write(tmp_path / "a.gif", walk, walk, camera="follow")


def test_a_leg_that_fails_for_a_moment_has_its_colour_in_a_gif(
    walk: RecordedTrial, tmp_path: Path, monkeypatch: Any
) -> None:
    conditions = np.zeros_like(walk.leg_conditions)
    conditions[65:75, 4] = LEG_CONDITIONS.index("failed")

    class Blushing(Drawn):
        def draw(self, row: int) -> Any:
            red = 250 if conditions[row, 4] else 0
            return np.full((48, 64, 3), (red, 20, 30), dtype=np.uint8)

    Drawn.rows = []
    monkeypatch.setattr("hexctl.export.pictures.RunRenderer", Blushing)
    write(tmp_path / "a.gif", replace(walk, leg_conditions=conditions), width_px=64, fps=10)
    with Image.open(tmp_path / "a.gif") as gif:
        red = {frame.convert("RGB").getpixel((5, 5))[0] for frame in ImageSequence.Iterator(gif)}
    assert min(red) < 20
    assert max(red) > 230


@pytest.mark.slow
def test_a_real_gif_is_small(walk: RecordedTrial, tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    try:
        open_context(16, 16).free()
    except NoRendererError as error:
        pytest.skip(str(error))
    write(tmp_path / "a.gif", walk, from_s=1.0, duration_s=1.0, fps=10)
    with Image.open(tmp_path / "a.gif") as gif:
        assert gif.size == (480, 360)
        assert len(gif.convert("RGB").getcolors(10**6) or ()) > 8
    # 3 MB for 10 s at 20 pictures a second.
    assert (tmp_path / "a.gif").stat().st_size / 10 < 3e6 / 200 * 1.3
