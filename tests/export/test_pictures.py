"""GIF and MP4 of walks: times, captions, what a scene shows, and races. A stand-in draws where it can."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexctl.errors import InputError
from hexctl.export.captions import FAILED_BADGE, messages_of
from hexctl.export.export_options import PictureOptions
from hexctl.export.pictures import write_pictures
from hexctl.export.race import WON_BADGE, RaceRenderer
from hexctl.export.render import NoRendererError, RunRenderer, open_context
from hexctl.recording.recorded_trial import LEG_CONDITIONS, RecordedEvent, RecordedTrial


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


def write(path: Path, *runs: RecordedTrial, kind: str = "gif", **options: Any) -> list[tuple[int, int]]:
    told: list[tuple[int, int]] = []
    write_pictures(list(runs), path, kind, PictureOptions(**options), lambda *one: told.append(one))
    return told


@pytest.mark.usefixtures("drawn")
def test_a_gif_takes_as_long_as_the_walk(walk: RecordedTrial, tmp_path: Path) -> None:
    from PIL import Image, ImageSequence

    told = write(tmp_path / "a", walk, width_px=96)
    with Image.open(tmp_path / "a") as gif:
        assert gif.size == (96, 72 + 6), "with a line of text"
        assert gif.info["loop"] == 0
        # Pictures that do not differ from the one before are one that stays longer.
        shown_ms = sum(frame.info["duration"] for frame in ImageSequence.Iterator(gif))
    assert shown_ms / 1000 == pytest.approx(walk.time_s[-1], abs=0.05)
    assert told[-1][0] == told[-1][1] == shown_ms / 50


def test_a_part_of_the_walk(walk: RecordedTrial, tmp_path: Path, drawn: Any) -> None:
    write(tmp_path / "a.gif", walk, from_s=1.0, duration_s=0.5, fps=10, width_px=64)
    assert walk.walk_s[sorted(set(drawn.rows))] == pytest.approx([1.0, 1.1, 1.2, 1.3, 1.4])
    with pytest.raises(InputError, match="from_s"):
        write(tmp_path / "b.gif", walk, from_s=99.0)
    drawn.rows.clear()
    unwalked = replace(walk, walk_s=np.zeros_like(walk.walk_s))
    write(tmp_path / "c.gif", unwalked, from_s=0.0, duration_s=0.5, fps=10, width_px=64)
    assert min(drawn.rows) == 0, "without a walk the recording counts"


@pytest.mark.usefixtures("drawn")
def test_a_film_of_one_walk_shows_the_time_and_marks_the_failure(walk: RecordedTrial, tmp_path: Path) -> None:
    from PIL import Image

    row = int(np.searchsorted(walk.time_s, 1.0))
    fails = replace(walk, events=(RecordedEvent(row, "WARN", "world: leg 5 locked"),))
    write(tmp_path / "a.gif", fails, fps=1, width_px=320, duration_s=3.0)
    with Image.open(tmp_path / "a.gif") as gif:
        bars = []
        for frame in range(3):
            gif.seek(frame)
            bars.append(np.asarray(gif.convert("RGB"))[240:].astype(int))
    marked = [int((np.abs(bar - FAILED_BADGE).max(axis=-1) < 12).sum()) for bar in bars]
    assert marked[0] == 0 < 100 < marked[1]
    counters = [bar[:, 270:] for bar in bars]
    assert (counters[0] == counters[1]).all(), "the counter stays at 0.0 s until the walk begins"
    assert (counters[1] != counters[2]).any()


@pytest.mark.usefixtures("drawn")
def test_an_mp4_that_decodes(walk: RecordedTrial, tmp_path: Path) -> None:
    write(tmp_path / "a", walk, kind="mp4", duration_s=1.0, width_px=97, captions=("slow",))
    import av

    with av.open(str(tmp_path / "a")) as file:
        stream = file.streams.video[0]
        assert stream.codec_context.name == "h264"
        frames = [frame.to_ndarray(format="rgb24") for frame in file.decode(video=0)]
        assert stream.average_rate == 50
    assert len(frames) == 50
    assert frames[0].shape[1] in (96, 98)
    assert frames[40].mean() > frames[0].mean()


def test_what_is_out_of_range_is_refused(walk: RecordedTrial, tmp_path: Path) -> None:
    for options in ({"camera": "below"}, {"width_px": 20}, {"fps": 200.0}):
        with pytest.raises(InputError, match=next(iter(options))):
            PictureOptions(**options)
    with pytest.raises(InputError, match="3 recordings"):
        write(tmp_path / "a.gif", walk, walk, walk)
    with pytest.raises(InputError, match="camera"):
        write(tmp_path / "a.gif", walk, walk, camera="follow")


@pytest.fixture
def _renderer(monkeypatch: Any) -> None:
    """Skip where nothing draws without a screen."""
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    try:
        open_context(16, 16).free()
    except NoRendererError as error:
        pytest.skip(str(error))


def test_without_a_renderer_one_line_says_what_to_install(walk: RecordedTrial, monkeypatch: Any) -> None:
    def missing(name: str) -> Any:
        raise ImportError(f"no {name}\nat all")

    monkeypatch.setattr("hexctl.export.render.import_module", missing)
    with pytest.raises(NoRendererError, match="libegl1") as refused:
        RunRenderer(walk, "side", 64, 48)
    assert "\n" not in str(refused.value)


def tinted(trial: RecordedTrial) -> tuple[list[int], list[int]]:
    """Numbers of red and of amber pixels in the first ticks, seen from above."""
    renderer = RunRenderer(trial, "top", 160, 120)
    red, amber = [], []
    for row in range(5):
        picture = renderer.draw(row).astype(int)
        warm = picture[..., 0] - picture[..., 2] > 60
        yellow = picture[..., 1] - picture[..., 2] > 60
        red.append(int((warm & ~yellow).sum()))
        amber.append(int((warm & yellow).sum()))
    renderer.close()
    return red, amber


@pytest.mark.long
@pytest.mark.usefixtures("_renderer")
def test_legs_have_the_colours_of_their_conditions_while_they_last(walk: RecordedTrial) -> None:
    conditions = np.zeros_like(walk.leg_conditions)
    for row, condition in enumerate(("whole", "noticed", "failed", "missing", "whole")):
        conditions[row, 4] = LEG_CONDITIONS.index(condition)
    red, amber = tinted(replace(walk, leg_conditions=conditions))
    assert [count > 80 for count in red] == [False, False, True, False, False]
    assert [count > 80 for count in amber] == [False, True, False, False, False]
    assert red[3] < red[2] / 2  # almost transparent
    assert [red[0], amber[0]] == [red[4], amber[4]] == [0, 0]


@pytest.mark.slow
@pytest.mark.usefixtures("_renderer")
def test_a_scene_has_the_slope_of_its_floor_and_a_robot_without_a_place_above_the_origin(
    walk: RecordedTrial,
) -> None:
    tilted = np.array([np.cos(0.1), 0.0, np.sin(0.1), 0.0])
    nowhere = np.full_like(walk.base_position_world, np.nan)
    strange = replace(walk, floor_quaternion=tilted, base_position_world=nowhere)
    renderer = RunRenderer(strange, "side", 64, 48)
    renderer.place(10)
    normal, position = renderer.data.geom("floor").xmat.reshape(3, 3)[:, 2], renderer.data.qpos[:3].copy()
    renderer.close()
    assert normal == pytest.approx([np.sin(0.2), 0.0, np.cos(0.2)], abs=1e-6)
    assert position == pytest.approx([0, 0, walk.robot.standing_height_m])


@pytest.mark.slow
@pytest.mark.usefixtures("_renderer")
def test_of_two_walks_the_faster_one_wins_a_race_and_the_failure_is_told_on_both_lanes(
    walk: RecordedTrial,
) -> None:
    row = int(np.searchsorted(walk.walk_s, 0.4))
    fails_s = float(walk.walk_s[row])
    pair = []
    for did, share in (("walked on", 1.0), ("glided", 3.0)):
        noticed = json.dumps([{"at_s": fails_s + 0.4, "leg": 5, "did": did}])
        position_m = walk.base_position_world.copy()
        position_m[:, 0] += (share - 1) * (position_m[:, 0] - position_m[0, 0])
        event = RecordedEvent(row, "WARN", "world: leg 5 locked")
        told = walk.properties | {"noticed": noticed}
        pair.append(replace(walk, properties=told, events=(event,), base_position_world=position_m))
    times_s = [index / 10 for index in range(int(10 * walk.time_s[-1]))]
    race = RaceRenderer(pair, [0.0, 0.0], ["a", "b"], times_s, camera="side", width_px=320)
    end = race.picture(float(walk.time_s[-1]) - 0.2)
    texts = [[message.text for message in messages_of(trial)] for trial in pair]
    race.close()
    won = [
        int((np.abs(bar.astype(int) - WON_BADGE).max(axis=-1) < 12).sum()) for bar in (end[:22], end[-22:])
    ]
    assert won[0] == 0
    assert won[1] > 100
    assert [len(lane) for lane in texts] == [1, 2], "the detection is told where the walk reacts to it"
