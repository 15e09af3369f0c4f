"""Streams of plain pictures whose brightness a test sets."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import cv2
import numpy as np

from hexctl.vision.video.mjpeg import MjpegServer
from hexctl.vision.video.video_source import Frame, VideoSource
from hexctl.waiting import wait_for


def plain(brightness: int) -> np.ndarray:
    """Picture of one brightness."""
    return np.full((48, 64, 3), brightness, dtype=np.uint8)


class Feed:
    """A server that gets 50 pictures a second.

    Attributes:
        server: of the stream.
        brightness: of the pictures from now on.
    """

    def __init__(self, server: MjpegServer, brightness: int) -> None:
        self.server, self.brightness = server, brightness


@contextmanager
def feeding(brightness: int, port: int = 0) -> Iterator[Feed]:
    """Serve a stream until the block ends."""
    over = threading.Event()
    with MjpegServer(port) as server:
        feed = Feed(server, brightness)

        def run() -> None:
            while not over.wait(0.02):
                server.publish(cv2.imencode(".jpg", plain(feed.brightness))[1].tobytes())

        thread = threading.Thread(target=run)
        thread.start()
        try:
            yield feed
        finally:
            over.set()
            thread.join()


def wait_for_brightness(source: VideoSource, brightness: int) -> Frame:
    """First frame of a brightness."""

    def found() -> Frame | None:
        frame = source.read(0.1)
        return frame if frame is not None and abs(frame.gray().mean() - brightness) < 4 else None

    return wait_for(found, 10, f"no frame of brightness {brightness} came")
