"""Two walks in one scene: lanes, finish line, messages and distances, where this machine can draw."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from hexctl.export.captions import FLASH_S
from hexctl.export.export_options import PictureOptions
from hexctl.export.pictures import write_pictures
from hexctl.export.race import CHEER_S, FAILED_BADGE, WON_BADGE, RaceRenderer
from hexctl.export.render import NoRendererError, open_context
from hexctl.recording.recorded_trial import RecordedEvent, RecordedTrial
from tests.export.test_lerobot import cut

WIDTH_PX = 320


@pytest.fixture(autouse=True)
def _renderer(monkeypatch: Any) -> None:
    """Skip where nothing draws without a screen."""
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    try:
        open_context(16, 16).free()
    except NoRendererError as error:
        pytest.skip(str(error))


def ahead(walk: RecordedTrial, share: float) -> RecordedTrial:
    """The walk with a body that comes further by a share."""
    assert walk.course_world is not None
    origin = walk.course_world[0]
    position_m = walk.base_position_world.copy()
    position_m[:, 0] = origin[0] + (position_m[:, 0] - origin[0]) * share
    return replace(walk, base_position_world=position_m)


def failing(walk: RecordedTrial, at_row: int, did: str) -> RecordedTrial:
    """The walk with a leg that fails at a tick and is noticed 0.4 s later."""
    at_s = float(walk.walk_s[at_row])
    noticed = [{"at_s": at_s + 0.4, "leg": 5, "did": did}]
    properties = walk.properties | {"noticed": json.dumps(noticed)}
    event = RecordedEvent(at_row, "WARN", "world: leg 5 locked")
    return replace(walk, properties=properties, events=(event,))


@pytest.fixture
def race(walk: RecordedTrial) -> Iterator[RaceRenderer]:
    row = int(np.searchsorted(walk.walk_s, 0.4))
    pair = [failing(walk, row, "walked on"), failing(ahead(walk, 3.0), row, "glided")]
    times_s = [index / 10 for index in range(int(10 * walk.time_s[-1]))]
    renderer = RaceRenderer(pair, [0.0, 0.0], ["a", "b"], times_s, camera="side", width_px=WIDTH_PX)
    yield renderer
    renderer.close()


def near(part: Any, color: tuple[int, int, int]) -> int:
    """Number of pixels of a colour."""
    return int((np.abs(part.astype(int) - color).max(axis=-1) < 12).sum())


def bars(picture: Any) -> tuple[Any, Any]:
    """The lines of text of the far and of the near lane."""
    bar_px = 22
    return picture[:bar_px], picture[-bar_px:]


def test_a_leg_that_locks_is_announced_on_both_lanes_and_its_detection_where_the_walk_reacts(
    race: RaceRenderer, walk: RecordedTrial
) -> None:
    locks_s = float(walk.time_s[np.searchsorted(walk.walk_s, 0.4)])
    before, then, later = (race.draw(locks_s + late_s) for late_s in (-0.1, 0.1, 0.5))
    assert [near(bar, FAILED_BADGE) > 100 for bar in bars(before)] == [False, False]
    assert [near(bar, FAILED_BADGE) > 100 for bar in bars(then)] == [True, True]
    assert [near(bar, FAILED_BADGE) > 100 for bar in bars(later)] == [True, False]
    gone = race.draw(locks_s + FLASH_S + 0.1)
    assert near(bars(gone)[0], FAILED_BADGE) < 100
    texts = [[message.text for message in racer.messages()] for racer in race.racers]
    assert texts == [["leg 5 locks"], ["leg 5 locks", "detected after 0.4 s"]]


def test_the_faster_walk_wins_before_the_end(race: RaceRenderer, walk: RecordedTrial) -> None:
    end_s = float(walk.time_s[-1])
    far, near_lane = bars(race.draw(end_s - 0.2))
    assert near(near_lane, WON_BADGE) > 100
    assert near(far, WON_BADGE) == 0
    assert near(bars(race.draw(end_s - CHEER_S - 0.5))[1], WON_BADGE) == 0


def test_the_picture_stays_still_but_for_what_moves(race: RaceRenderer) -> None:
    first, last = race.draw(0.0), race.draw(2.0)
    assert first.shape == last.shape
    changed = (first != last).any(axis=-1)
    assert 0.0 < changed.mean() < 0.3


def test_equal_walks_have_no_winner(walk: RecordedTrial) -> None:
    times_s = [0.0, 1.0, 2.0, 3.0]
    renderer = RaceRenderer([walk, walk], [0.0, 0.0], ["a", "b"], times_s, camera="top", width_px=WIDTH_PX)
    picture = renderer.draw(3.0)
    renderer.close()
    assert sum(near(bar, WON_BADGE) for bar in bars(picture)) == 0


def test_walks_without_a_known_place_have_no_distance_and_no_finish(walk: RecordedTrial) -> None:
    nowhere = replace(walk, base_position_world=np.full_like(walk.base_position_world, np.nan))
    renderer = RaceRenderer(
        [nowhere, nowhere], [0.0, 0.0], ["a", "b"], [0.0, 3.0], camera="side", width_px=WIDTH_PX
    )
    counters = [bar[:, -60:] for bar in bars(renderer.draw(3.0))]
    renderer.close()
    assert [int(np.ptp(counter)) < 60 for counter in counters] == [True, True]


def test_two_walks_begin_together_and_the_shorter_one_waits(walk: RecordedTrial, tmp_path: Path) -> None:
    short = cut(walk, len(walk) - 60)
    options = PictureOptions(width_px=200, fps=5)
    write_pictures([walk, short], tmp_path / "a.gif", options, lambda *_: None)
    with Image.open(tmp_path / "a.gif") as gif:
        width_px, height_px = gif.size
        assert width_px == 200
        assert 80 < height_px < 200
        assert gif.n_frames > 5
    times_s = [float(walk.time_s[-1])]
    renderer = RaceRenderer([walk, short], [0.0, 0.0], ["a", "b"], times_s, camera="side", width_px=64)
    rows = [racer.row(times_s[0]) for racer in renderer.racers]
    renderer.close()
    assert rows == [len(walk) - 1, len(short) - 1]
