"""Pictures of a network camera for the page, from one address that the operator gave.

Untrusted: bytes, pixels and time are bounded, nothing is decoded, no redirection or proxy is used.
"""

import http.client
import math
import re
import threading
import time
from dataclasses import dataclass
from typing import Self
from urllib.parse import SplitResult, urlsplit

from hexctl.errors import InputError, argument

#: Bytes and pixels of the largest picture, and bytes of a picture's head in a stream.
MOST_BYTES, MOST_PIXELS, MOST_HEAD_BYTES = 2_000_000, 5_000_000, 4096

#: Maximum time of an answer, and of each picture.
ANSWER_S = 5.0

#: Minimum time between two stored pictures, and from a failure to the next attempt.
PERIOD_S, RETRY_S = 0.1, 1.0

_TYPE_OF_STREAM = "multipart/x-mixed-replace"
_LENGTH = re.compile(rb"^content-length:\s*(\d{1,9})\s*$", re.IGNORECASE | re.MULTILINE)


class _PictureError(Exception):
    """The camera's answer is not a picture."""


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture as received; `number` counts from 1."""

    number: int
    jpeg: bytes


class PictureRelay:
    """Stores the newest picture of a camera, on its own thread; a context manager.

    Args:
        url: of a stream (MJPEG), or of a single JPEG, which is fetched repeatedly.

    Raises InputError for a URL other than `http` or `https`.
    """

    def __init__(self, url: str) -> None:
        self._url = _checked(url)
        self.newest: Picture | None = None
        self.trouble: str | None = None
        self._number, self._kept_s = 0, -math.inf
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="pictures", daemon=True)

    def __enter__(self) -> Self:
        """Start to fetch."""
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._closing.set()
        self._thread.join(2 * PERIOD_S)  # a silent camera must not delay the end

    def _run(self) -> None:
        while not self._closing.is_set():
            wait_s = PERIOD_S
            try:
                self._fetch()
            except (OSError, http.client.HTTPException, _PictureError, ValueError) as error:
                self.newest, self.trouble = None, _reason(error)
                wait_s = RETRY_S
            self._closing.wait(wait_s)

    def _fetch(self) -> None:
        connection = self._connected()
        try:
            path = (self._url.path or "/") + (f"?{self._url.query}" if self._url.query else "")
            connection.request("GET", path, headers={"Accept": f"image/jpeg, {_TYPE_OF_STREAM}"})
            answer = connection.getresponse()
            if answer.status != http.client.OK:
                raise _PictureError(f"the camera answers {answer.status}")
            incoming = _Incoming(answer)
            if answer.headers.get_content_type() != _TYPE_OF_STREAM:
                self._keep(incoming.rest())
                return
            boundary = answer.headers.get_param("boundary")
            if not isinstance(boundary, str) or not boundary:
                raise _PictureError("the camera's stream has no boundary")
            while not self._closing.is_set():
                began_s = time.monotonic()
                jpeg = incoming.part(boundary.removeprefix("--").encode())
                if self.newest is None or began_s - self._kept_s >= PERIOD_S:
                    self._keep(jpeg)
        finally:
            connection.close()

    def _connected(self) -> http.client.HTTPConnection:
        kind = http.client.HTTPSConnection if self._url.scheme == "https" else http.client.HTTPConnection
        host = self._url.hostname
        assert host is not None  # noqa: S101  checked when it was made
        return kind(host, self._url.port, timeout=ANSWER_S)

    def _keep(self, jpeg: bytes) -> None:
        width, height = jpeg_size(jpeg)
        if width * height > MOST_PIXELS:
            raise _PictureError(f"the picture has {width}x{height} pixels")
        self._number += 1
        self.newest, self.trouble = Picture(self._number, jpeg), None
        self._kept_s = time.monotonic()


class _Incoming:
    """Bytes of an answer, bounded in number and time."""

    def __init__(self, answer: http.client.HTTPResponse) -> None:
        self._answer = answer
        self._bytes = bytearray()
        self._until_s = time.monotonic() + ANSWER_S

    def rest(self) -> bytes:
        while self._more():
            pass
        return self._taken(len(self._bytes))

    def part(self, boundary: bytes) -> bytes:
        self._until_s = time.monotonic() + ANSWER_S
        self._taken(self._find(b"--" + boundary, MOST_BYTES))
        head = self._taken(self._find(b"\r\n\r\n", MOST_HEAD_BYTES) + 4)
        length = _LENGTH.search(head.replace(b"\r", b""))
        if length is None:
            return self._taken(self._find(b"\r\n--" + boundary, MOST_BYTES))
        size = int(length[1])
        while len(self._bytes) < size:
            self._need(MOST_BYTES)
        return self._taken(size)

    def _find(self, mark: bytes, most: int) -> int:
        searched = 0
        while (at := self._bytes.find(mark, searched)) < 0:
            searched = max(0, len(self._bytes) - len(mark))
            self._need(most)
        return at

    def _need(self, most: int) -> None:
        if len(self._bytes) > most:
            raise _PictureError(f"the picture has more than {most} bytes")
        if not self._more():
            raise _PictureError("the camera's stream has ended")

    def _more(self) -> bool:
        if time.monotonic() > self._until_s:
            raise _PictureError(f"the camera needs more than {ANSWER_S:g} s for a picture")
        got = self._answer.read1(65536)
        self._bytes += got
        if len(self._bytes) > MOST_BYTES + 65536:
            raise _PictureError(f"the picture has more than {MOST_BYTES} bytes")
        return bool(got)

    def _taken(self, count: int) -> bytes:
        taken = bytes(self._bytes[:count])
        del self._bytes[:count]
        return taken


def jpeg_size(jpeg: bytes) -> tuple[int, int]:
    """Width and height of a JPEG in px, by its header; raises ValueError for anything else."""
    if jpeg[:3] != b"\xff\xd8\xff":
        raise ValueError("what the camera sends is no JPEG")
    at = 2
    while at + 9 <= len(jpeg) and jpeg[at] == 0xFF:
        marker, length = jpeg[at + 1], int.from_bytes(jpeg[at + 2 : at + 4])
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            return int.from_bytes(jpeg[at + 7 : at + 9]), int.from_bytes(jpeg[at + 5 : at + 7])
        at += 2 + length
    raise ValueError("what the camera sends is a JPEG without a size")


def _reason(error: Exception) -> str:
    if isinstance(error, OSError) and error.strerror:
        return f"the camera cannot be reached ({error.strerror})"
    return str(error) or type(error).__name__


def _checked(url: str) -> SplitResult:
    try:
        parts = urlsplit(url)
        usable = parts.scheme in ("http", "https") and bool(parts.hostname) and parts.port != 0
        usable = usable and url.isascii() and url.isprintable() and " " not in url
    except ValueError:  # a port without a number
        usable = False
    if not usable or parts.username is not None:
        raise InputError(
            f"{argument('page_view')}: got {url!r}; allowed: the URL of a camera's stream or picture, "
            "without a user name, such as http://127.0.0.1:8018/stream.mjpg"
        )
    return parts
