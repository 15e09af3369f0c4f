"""A file of what was seen: pictures at their times become a video of a constant rate."""

from pathlib import Path
from typing import Any, Self

import cv2

from hexctl.errors import InputError, RecordingError, argument
from hexctl.vision.detection.tags import Picture
from hexctl.vision.video.video_source import hide_library_messages, quietly

#: Code of the pictures by the ending of the file's name.
CODECS = {".mp4": "mp4v", ".avi": "MJPG"}

#: A longer time without pictures is left out.
MOST_GAP_S = 2.0


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
