"""Frames of files, streams and cameras."""

from pathlib import Path

import numpy as np
import pytest

from hexctl.errors import InputError, RobotFaultError
from hexctl.vision.video import video_source
from hexctl.vision.video.video_source import LiveVideo, open_video
from hexctl.vision.video.video_writer import VideoWriter
from hexctl.waiting import wait_for
from tests.server.processes import free_port
from tests.vision.feeding import feeding, plain, wait_for_brightness

pytestmark = pytest.mark.realtime


@pytest.mark.parametrize("name", ["seen.avi", "seen.mp4"])
def test_each_frame_of_a_file_comes_with_its_time(tmp_path: Path, name: str) -> None:
    with VideoWriter(tmp_path / name, fps=25) as writer:
        for number in range(5):
            writer.write(plain(50 * number), number / 25)
    with open_video(str(tmp_path / name)) as source:
        frames = list(source)
        assert source.ended
        assert source.read() is None
    assert [frame.number for frame in frames] == [1, 2, 3, 4, 5]
    assert [frame.at_s for frame in frames] == pytest.approx([0, 0.04, 0.08, 0.12, 0.16])
    assert [frame.gray().mean() for frame in frames] == pytest.approx([0, 50, 100, 150, 200], abs=4)
    assert not source.live


class Camera:
    """What OpenCV opens, with frames that the test gives it.

    Attributes:
        lost: whether it gives no more.
    """

    def __init__(self, brightnesses: list[int]) -> None:
        self._left = brightnesses
        self.lost = False

    def grab(self) -> bool:
        return bool(wait_for(lambda: self._left or self.lost, 10, "never closed")) and not self.lost

    def retrieve(self) -> tuple[bool, np.ndarray]:
        return True, plain(self._left.pop(0))

    def release(self) -> None:
        self.lost = True


def test_of_a_camera_only_the_newest_frame_is_kept() -> None:
    camera = Camera([10, 20, 30])
    with LiveVideo("0", lambda: camera, lambda _: None) as source:
        wait_for(lambda: source.dropped == 2, 10, "three frames never came")
        frame = source.read()
        assert frame is not None
        assert (frame.number, int(frame.picture.mean())) == (3, 30)
        assert source.read(0.01) is None
        camera.lost = True
    assert source.read() is None


def test_a_camera_that_is_lost_is_told_and_found_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(video_source, "REOPEN_S", 0.01)
    first, second = Camera([10]), Camera([20])
    openings: list[Camera | None] = [first, None, second]
    said: list[str] = []

    def opened() -> Camera:
        camera = openings.pop(0)
        if camera is None:
            raise RobotFaultError("not yet")
        return camera

    with LiveVideo("0", opened, said.append) as source:
        frame = source.read(10)
        assert frame is not None
        first.lost = True
        again = source.read(10)
        assert again is not None
        assert (int(again.picture.mean()), again.number) == (20, 2)
        second.lost = True
    assert said == ["camera 0 is lost; looking for it again", "camera 0 is there again"]


def test_a_stream_is_read_and_read_again_after_its_server_was_gone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(video_source, "REOPEN_S", 0.05)
    said: list[str] = []
    port = free_port()
    with feeding(100, port) as feed:
        source = open_video(feed.server.url, on_event=said.append)
        wait_for_brightness(source, 100)
    with source:
        wait_for(lambda: said, 10, "its loss was never told")
        with feeding(200, port):
            wait_for_brightness(source, 200)
    assert said[:2] == [
        f"camera {feed.server.url} is lost; looking for it again", f"camera {feed.server.url} is there again",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("source", "error", "said"),
    [
        ("ftp://camera", InputError, "allowed: a number such as 0"),
        ("no.mp4", InputError, "which is not there"),
        ("77", RobotFaultError, "there is no camera /dev/video77; cameras here: "),
        ("http://127.0.0.1:{port}/", RobotFaultError, "no video comes from"),
    ],
)
def test_what_is_no_camera_is_refused_in_one_line(source: str, error: type[Exception], said: str) -> None:
    with pytest.raises(error, match=said) as raised:
        open_video(source.format(port=free_port()))
    assert "\n" not in str(raised.value)


def test_a_file_that_is_no_video_is_refused(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "seen.mp4").write_text("no video")
    with pytest.raises(InputError, match=r"seen\.mp4: is no video"):
        open_video(str(tmp_path / "seen.mp4"))
    assert capfd.readouterr().err == ""
