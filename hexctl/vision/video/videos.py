"""Videos: frames of a camera, a network stream or a file, and files of what was seen."""

import os
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import cv2
import numpy as np

from hexctl.errors import InputError, RecordingError, RobotFaultError, argument
from hexctl.vision.detection.tags import Picture

#: Schemes of network streams: MJPEG over HTTP, as of phones and network cameras, and RTSP.
SCHEMES = ("http", "https", "rtsp")

#: What a source may be, for messages.
SOURCES = "a number such as 0, /dev/video0, an address (http://... or rtsp://...) or the file of a video"

#: A live source that cannot be opened, or sends nothing, for so long is lost.
OPEN_TIMEOUT_MS, READ_TIMEOUT_MS = 3000, 3000

#: A lost source is opened again after this.
REOPEN_S = 1.0

#: Code of the pictures by the ending of the file's name.
CODECS = {".mp4": "mp4v", ".avi": "MJPG"}

#: A longer time without pictures is left out.
MOST_GAP_S = 2.0


def hide_library_messages() -> None:
    """Silence FFmpeg: its errors are reported in one line instead.

    It reads the setting once, when the process opens its first video.
    """
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """A picture of a video.

    Attributes:
        picture: (H, W, 3), blue first, as OpenCV has it.
        at_s: of a live source, when it arrived, on time.monotonic; of a file, its time since the beginning.
    """

    picture: Picture
    at_s: float

    def gray(self) -> Picture:
        """The picture in grey, (H, W)."""
        return np.asarray(cv2.cvtColor(self.picture, cv2.COLOR_BGR2GRAY))


class VideoSource(ABC):
    """A sequence of frames; must be closed.

    Attributes:
        name: name of the source.
        live: whether the source sets the pace; unread frames are dropped.
        dropped: number of dropped frames.
        ended: whether the source has ended.
    """

    live = False

    def __init__(self, name: str) -> None:
        self.name = name
        self.dropped = 0
        self.ended = False

    @abstractmethod
    def read(self, timeout_s: float = 1.0) -> Frame | None:
        """The next frame, or the newest unread one of a live source.

        None after the timeout and after the end.
        """

    @abstractmethod
    def close(self) -> None:
        """End it; a second call changes nothing."""

    def __iter__(self) -> Iterator[Frame]:
        while not self.ended:
            frame = self.read()
            if frame is not None:
                yield frame

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def open_video(
    source: str,
    *,
    size_px: tuple[int, int] | None = None,
    fps: float | None = None,
    on_event: Callable[[str], None] = lambda _: None,
) -> VideoSource:
    """Open a camera, a network stream or a file.

    Args:
        source: number of a camera, its device, an address, or a file (`SOURCES`).
        size_px: requested width and height of a camera; None keeps its own.
        fps: requested frame rate of a camera; None keeps its own.
        on_event: called with a line when a live source is lost or found again, on its thread.

    Raises InputError for anything else, and RobotFaultError for a missing camera or stream.
    """
    hide_library_messages()
    scheme, colon, _ = source.partition("://")
    if colon:
        if scheme not in SCHEMES:
            raise InputError(f"{argument('camera')}: got {source!r}; allowed: {SOURCES}")
        return LiveVideo(source, lambda: _opened_stream(source), on_event)
    device = Path(f"/dev/video{source}") if source.isdecimal() else Path(source)
    if source.isdecimal() or device.is_char_device():
        return LiveVideo(source, lambda: _opened_device(device, size_px, fps), on_event)
    return VideoFile(device)


class VideoFile(VideoSource):
    """All frames of a file."""

    def __init__(self, path: Path) -> None:
        """Open it. Raises InputError for a missing file or no video."""
        super().__init__(str(path))
        if not path.is_file():
            raise InputError(
                f"{argument('camera')}: got {str(path)!r}, which is not there; allowed: {SOURCES}"
            )
        self._capture = quietly(lambda: cv2.VideoCapture(str(path), cv2.CAP_FFMPEG))
        if not self._capture.isOpened():
            raise InputError(f"{path}: is no video that can be read; allowed: MP4, AVI, MKV and others")

    def read(self, timeout_s: float = 1.0) -> Frame | None:
        """The next frame, or None after the last."""
        good, picture = (False, None) if self.ended else self._capture.read()
        if not good or picture is None:
            self.ended = True
            return None
        at_s = self._capture.get(cv2.CAP_PROP_POS_MSEC) / 1000
        return Frame(np.asarray(picture, dtype=np.uint8), at_s)

    def close(self) -> None:
        """Close the file."""
        self.ended = True
        self._capture.release()


class LiveVideo(VideoSource):
    """Frames of a camera or a stream, the newest one only, read by a thread that opens it again when lost."""

    live = True

    def __init__(self, name: str, opened: Callable[[], Any], on_event: Callable[[str], None]) -> None:
        """Open it and begin to read. Raises what `opened` raises."""
        super().__init__(name)
        self._opened, self._on_event = opened, on_event
        self._arrived = threading.Condition()
        self._newest: Frame | None = None
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, args=(opened(),), name="video", daemon=True)
        self._thread.start()

    def read(self, timeout_s: float = 1.0) -> Frame | None:
        """The newest unread frame, or None after the timeout."""
        with self._arrived:
            self._arrived.wait_for(lambda: self.ended or self._newest is not None, timeout_s)
            frame, self._newest = self._newest, None
            return frame

    def close(self) -> None:
        """End the thread, which takes as long as a frame of the source."""
        self._closing.set()
        with self._arrived:
            self.ended = True
            self._arrived.notify_all()
        self._thread.join((OPEN_TIMEOUT_MS + READ_TIMEOUT_MS) / 1000)

    def _run(self, capture: Any) -> None:
        """Read until closed, and reopen a lost source."""
        while True:
            self._take(capture)
            capture.release()
            if self._closing.is_set():
                return
            self._on_event(f"camera {self.name} is lost; looking for it again")
            found = self._found_again()
            if found is None:
                return
            capture = found
            self._on_event(f"camera {self.name} is there again")

    def _take(self, capture: Any) -> None:
        while not self._closing.is_set() and capture.grab():
            at_s = time.monotonic()
            good, picture = capture.retrieve()
            if not good:
                continue
            with self._arrived:
                self.dropped += self._newest is not None
                self._newest = Frame(np.asarray(picture, dtype=np.uint8), at_s)
                self._arrived.notify_all()

    def _found_again(self) -> Any:
        while not self._closing.wait(REOPEN_S):
            try:
                return self._opened()
            except RobotFaultError:
                continue
        return None


def _opened_stream(address: str) -> Any:
    """Capture of a network stream; raises RobotFaultError without one."""
    settings = [
        cv2.CAP_PROP_OPEN_TIMEOUT_MSEC,
        OPEN_TIMEOUT_MS,
        cv2.CAP_PROP_READ_TIMEOUT_MSEC,
        READ_TIMEOUT_MS,
    ]
    # Several threads would decode several pictures at a time, and give out each one late.
    capture = quietly(
        lambda: cv2.VideoCapture(address, cv2.CAP_FFMPEG, [*settings, cv2.CAP_PROP_N_THREADS, 1])
    )
    if not capture.isOpened():
        raise RobotFaultError(
            f"no video comes from {address}; is the camera on, on this network, and is it the address of the "
            "stream itself?"
        )
    return capture


def _opened_device(device: Path, size_px: tuple[int, int] | None, fps: float | None) -> Any:
    """Capture of a camera of this computer; raises RobotFaultError without one."""
    if not device.is_char_device():
        others = ", ".join(sorted(map(str, Path("/dev").glob("video*")))) or "none"
        raise RobotFaultError(f"there is no camera {device}; cameras here: {others}")
    if not os.access(device, os.R_OK | os.W_OK):
        raise RobotFaultError(f"camera {device} may not be used; is this user in the group video?")
    capture = quietly(lambda: cv2.VideoCapture(str(device), cv2.CAP_V4L2))
    if not capture.isOpened():
        raise RobotFaultError(f"camera {device} gives no pictures; does another program use it?")
    # Webcams send large pictures at full rate only as JPEG.
    capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*"MJPG"))
    if size_px is not None:
        capture.set(cv2.CAP_PROP_FRAME_WIDTH, size_px[0])
        capture.set(cv2.CAP_PROP_FRAME_HEIGHT, size_px[1])
    if fps is not None:
        capture.set(cv2.CAP_PROP_FPS, fps)
    capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
    return capture


def quietly(make: Callable[[], Any]) -> Any:
    """Result of a call with OpenCV's warnings silenced."""
    before = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        return make()
    finally:
        cv2.utils.logging.setLogLevel(before)


class VideoWriter:
    """Writes pictures into a new video, each for as long as it was the newest; close it.

    The file is made with the first picture, in its size.
    """

    def __init__(self, path: Path, fps: float = 30.0) -> None:
        """Prepare to write; the suffix selects the format.

        Raises InputError for a suffix not in `CODECS`.
        """
        if path.suffix.lower() not in CODECS:
            raise InputError(
                f"{argument('output')}: got {path}; allowed: names that end in {', '.join(CODECS)}"
            )
        hide_library_messages()
        self._path, self._fps, self._frames = path, fps, 0
        self._writer: Any = None
        self._last: Picture | None = None
        self._began_at_s = 0.0

    def write(self, picture: Picture, at_s: float) -> None:
        """Write a picture (H, W, 3), BGR, in the size of the first one, with its time in s.

        Raises RecordingError if writing fails.
        """
        if self._writer is None:
            self._begin((picture.shape[1], picture.shape[0]), at_s)
        due = int((at_s - self._began_at_s) * self._fps + 0.5) + 1
        if due - self._frames > MOST_GAP_S * self._fps:
            self._began_at_s += (due - self._frames - 1) / self._fps
            due = self._frames + 1
        for left in range(due - self._frames, 0, -1):
            self._writer.write(picture if left == 1 or self._last is None else self._last)
            self._frames += 1
        self._last = picture

    def close(self) -> None:
        """Finish the file; a second call changes nothing."""
        if self._writer is not None:
            self._writer.release()
            self._writer = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _begin(self, size_px: tuple[int, int], at_s: float) -> None:
        code = cv2.VideoWriter.fourcc(*CODECS[self._path.suffix.lower()])
        self._writer = quietly(
            lambda: cv2.VideoWriter(str(self._path), cv2.CAP_FFMPEG, code, self._fps, size_px)
        )
        if not self._writer.isOpened():
            self._writer = None
            raise RecordingError(f"{self._path}: the video cannot be written here")
        self._began_at_s = at_s
