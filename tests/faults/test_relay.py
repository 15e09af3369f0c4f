"""The relay of the matrix: it loses whole frames, holds them, or passes them on as they are."""

import re
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from faults.process import Program
from faults.programs.relay import Frames

pytestmark = pytest.mark.realtime


def frame(text: str) -> bytes:
    return len(text).to_bytes(2, "little") + text.encode()


def test_frames_are_whole_however_they_come() -> None:
    stream = b"".join(map(frame, ("one", "", "three")))
    for size in range(1, len(stream) + 1):
        frames = Frames()
        pieces = [stream[start : start + size] for start in range(0, len(stream), size)]
        assert [each for piece in pieces for each in frames.take(piece)] == list(
            map(frame, ("one", "", "three"))
        )


@contextmanager
def relayed(folder: Path, kind: str) -> Iterator[tuple[Program, socket.socket, socket.socket]]:
    """A relay, and sockets before and behind it."""
    tcp = kind == "tcp"
    behind = socket.socket(socket.AF_INET, socket.SOCK_STREAM if tcp else socket.SOCK_DGRAM)
    behind.bind(("127.0.0.1", 0))
    if tcp:
        behind.listen()
    relay = Program(folder, "relay", "faults.programs.relay", kind, str(behind.getsockname()[1]), "1")
    try:
        relay.wait_for("relay at")
        found = re.search(r"relay at (\d+)", relay.said())
        assert found is not None
        before = socket.socket(socket.AF_INET, behind.type)
        before.connect(("127.0.0.1", int(found[1])))
        end = behind.accept()[0] if tcp else behind
        end.settimeout(10)
        yield relay, before, end
    finally:
        relay.end()
        behind.close()


@pytest.mark.parametrize("kind", ["tcp", "udp"])
def test_what_is_cut_off_is_lost_and_what_comes_later_passes(kind: str, tmp_path: Path) -> None:
    with relayed(tmp_path, kind) as (relay, before, behind):
        before.send(frame("first"))
        assert behind.recv(100) == frame("first")
        relay.tell("cut")
        time.sleep(0.5)
        before.send(frame("lost"))
        time.sleep(0.5)
        relay.tell("clear")
        time.sleep(0.5)
        before.send(frame("later"))
        assert behind.recv(100) == frame("later")


def test_about_as_many_datagrams_are_lost_as_told(tmp_path: Path) -> None:
    with relayed(tmp_path, "udp") as (relay, before, behind):
        relay.tell("loss 0.3")
        time.sleep(0.5)
        for number in range(300):
            before.send(number.to_bytes(2, "little"))
            time.sleep(0.001)
        relay.tell("clear")
        time.sleep(0.5)
        before.send(b"end")
        came = 0
        while behind.recv(100) != b"end":
            came += 1
        assert 150 < came < 270
