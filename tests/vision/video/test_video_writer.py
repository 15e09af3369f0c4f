"""Videos of what was seen."""

from pathlib import Path

import numpy as np
import pytest

from hexctl.errors import InputError, RecordingError
from hexctl.vision.video.video_source import open_video
from hexctl.vision.video.video_writer import VideoWriter
from tests.vision.feeding import plain


def written(path: Path, times_s: list[float], fps: float = 10.0) -> list[int]:
    """Brightness of each frame, over ten, of a video of one picture after another, each brighter by ten."""
    with VideoWriter(path, fps) as writer:
        for number, at_s in enumerate(times_s):
            writer.write(plain(10 * number), at_s)
    with open_video(str(path)) as source:
        return [round(frame.picture.mean() / 10) for frame in source]


def test_a_picture_lasts_until_the_next_one_came(tmp_path: Path) -> None:
    assert written(tmp_path / "seen.avi", [7.0, 7.3, 7.4]) == [0, 0, 0, 1, 2]


def test_of_pictures_that_come_faster_some_are_left_out(tmp_path: Path) -> None:
    frames = written(tmp_path / "seen.avi", list(np.arange(0, 0.7, 0.03)))
    assert len(frames) == 8
    assert frames == sorted(set(frames))


def test_a_long_gap_is_left_out(tmp_path: Path) -> None:
    assert written(tmp_path / "seen.avi", [0.0, 0.1, 60.0, 60.1]) == [0, 1, 2, 3]


@pytest.mark.parametrize(("name", "said"), [("seen.gif", r"\.mp4, \.avi"), ("none/seen.mp4", "folder")])
def test_a_file_that_cannot_be_is_refused(tmp_path: Path, name: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        VideoWriter(tmp_path / name)


def test_pictures_of_another_size_and_after_the_end_are_refused(tmp_path: Path) -> None:
    with VideoWriter(tmp_path / "seen.avi") as writer:
        writer.write(plain(0), 0.0)
        with pytest.raises(InputError, match="got a picture of 64x24 px; allowed: 64x48"):
            writer.write(plain(0)[:24], 0.1)
    with pytest.raises(RecordingError, match="closed"):
        writer.write(plain(0), 1.0)


def test_a_file_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "seen.avi").mkdir()
    with VideoWriter(tmp_path / "seen.avi") as writer, pytest.raises(RecordingError, match=r"seen\.avi"):
        writer.write(plain(0), 0.0)
