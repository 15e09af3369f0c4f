"""Event files: named pipes that the test writes."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from hexctl.teleop.event_file import EVENT, LOOK_S, MOST_BYTES, EventFiles


class Pipes:
    """Event files of a folder, their ends to write to, and a clock."""

    def __init__(self, folder: Path, most: int | None) -> None:
        self.folder, self.now_s = folder, 0.0
        self.files = EventFiles(lambda: sorted(folder.iterdir()), most=most, now_s=lambda: self.now_s)
        self.ends: list[int] = []

    def plug(self, name: str) -> int:
        """Plug a device in; its end to write to."""
        os.mkfifo(self.folder / name)
        self.ends.append(os.open(self.folder / name, os.O_RDWR))
        self.now_s += LOOK_S
        self.files.look()
        return self.ends[-1]


@pytest.fixture(params=[None, 1])
def pipes(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Pipes]:
    pipes = Pipes(tmp_path, request.param)
    yield pipes
    pipes.files.close()
    for end in pipes.ends:
        os.close(end)


def test_events_may_come_in_parts(pipes: Pipes) -> None:
    end = pipes.plug("event1")
    data = EVENT.pack(1, 2, 1, 304, 1) + EVENT.pack(1, 2, 3, 0, -5)
    came = []
    for start in range(0, len(data), 7):
        os.write(end, data[start : start + 7])
        came.append(list(pipes.files.events()))
    assert [event for some in came for event in some] == [(1, 304, 1), (3, 0, -5)]
    assert not list(pipes.files.events())


def test_more_than_one_read_holds_comes_at_once(pipes: Pipes) -> None:
    end = pipes.plug("event1")
    many = 2 * MOST_BYTES // EVENT.size + 3
    os.write(end, b"".join(EVENT.pack(0, 0, 3, 1, value) for value in range(many)))
    assert [value for _, _, value in pipes.files.events()] == list(range(many))


def test_further_devices_are_opened_up_to_the_most_and_looked_for_once_in_a_while(pipes: Pipes) -> None:
    first, second = pipes.plug("event1"), pipes.plug("event2")
    for end in (first, second):
        os.write(end, EVENT.pack(0, 0, 1, 304, 1))
    opened = len(pipes.files.opened)
    assert len(list(pipes.files.events())) == opened
    pipes.files.close()
    pipes.now_s += LOOK_S
    pipes.files.look()
    assert len(pipes.files.opened) == opened
    pipes.files.close()
    pipes.files.look()
    assert not pipes.files.opened, "it has just looked"


def test_a_device_that_is_pulled_out_is_let_go_of_and_may_come_back(pipes: Pipes) -> None:
    pipes.plug("event1")
    os.close(pipes.ends.pop())
    assert not list(pipes.files.events())
    assert not pipes.files.opened
    (pipes.folder / "event1").unlink()
    pipes.plug("event1")
    assert pipes.files.opened


def test_what_cannot_be_opened_is_left_out(tmp_path: Path) -> None:
    files = EventFiles(lambda: [tmp_path / "missing"])
    files.look()
    assert not files.opened
    assert not list(files.events())
