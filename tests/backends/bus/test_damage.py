"""Bytes that are no answers are named: ids used twice, noise, wrong baud rates. No wall clock."""

import random
from collections.abc import Callable

import pytest

from hexctl.backends.bus import tools
from hexctl.backends.bus.damage import Damage
from hexctl.backends.bus.servo_bus import BusCounters
from hexctl.backends.bus.tools import (
    bus_of,
    check_no_unexpected_ids,
    packets_of,
    scan_bus,
    set_servo_id,
    the_servo,
)
from hexctl.errors import InputError, RobotFaultError
from tests.backends.bus.boards import MODELS, BoardLine, MemoryLine, a_map
from tests.backends.fake_time import FakeTime

FAMILIES = (*MODELS, ("lx16a", "lx16a"))
IDS = range(10)

Plug = Callable[[MemoryLine], MemoryLine]


@pytest.fixture
def plug(monkeypatch: pytest.MonkeyPatch) -> Plug:
    """Makes a line the one that the tools open."""

    def plugged(line: MemoryLine) -> MemoryLine:
        monkeypatch.setattr(tools, "SerialLine", lambda *_: line)
        return line

    return plugged


def scanned(driver: str) -> tuple[list[int], list[Damage]]:
    damages: list[Damage] = []
    found = scan_bus("memory", driver, 1_000_000, ids=IDS, on_damage=damages.append)
    return [each.servo_id for each in found], damages


@pytest.mark.parametrize(("driver", "model"), FAMILIES)
@pytest.mark.parametrize("others", [True, False])
def test_two_servos_with_one_id_are_named_by_a_scan(
    plug: Plug, driver: str, model: str, others: bool
) -> None:
    faults = ["same-id:1:femur"]
    if not others:
        faults += [f"mute:{leg}:{kind}" for leg in range(1, 7) for kind in ("coxa", "femur", "tibia")][2:]
    line = plug(BoardLine(a_map(driver, model), *faults))
    _, damages = scanned(driver)
    assert [each.garbled or each.doubled for each in damages] == [(1,)]
    assert all(words in damages[0].description("memory") for words in ("several servos", "id 1", "same id"))
    with pytest.raises(RobotFaultError, match="several servos"):
        the_servo(line, driver, 1)


@pytest.mark.parametrize(("driver", "model"), FAMILIES)
def test_no_id_is_given_to_two_servos(
    plug: Plug, driver: str, model: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tools, "IDS", tuple(IDS))
    mute = [f"mute:{leg}:{kind}" for leg in range(1, 7) for kind in ("coxa", "femur", "tibia")][2:]
    line = plug(BoardLine(a_map(driver, model), "same-id:1:femur", *mute))
    assert isinstance(line, BoardLine)
    with pytest.raises(InputError, match=r"got several|several servos"):
        set_servo_id("memory", driver, 1_000_000, 7)
    assert [servo.servo_id for servo in line.board._servos][:2] == [1, 1]


@pytest.mark.parametrize(("driver", "model"), FAMILIES)
def test_two_servos_that_lost_their_ids_are_unexpected(driver: str, model: str) -> None:
    bus_map = a_map(driver, model)
    bus_map = type(bus_map)(**{**vars(bus_map), "ids": bus_map.ids + 1})
    line = BoardLine(bus_map, "lost-id:2:coxa", "lost-id:5:femur")
    found = bus_of(bus_map, line, BusCounters()).find()
    with pytest.raises(RobotFaultError, match="id 1 are damaged"):
        check_no_unexpected_ids(line, bus_map, found)


@pytest.mark.parametrize(("driver", "model"), FAMILIES)
def test_noise_is_named(plug: Plug, driver: str, model: str) -> None:
    plug(BoardLine(a_map(driver, model), "noise:1"))
    _, damages = scanned(driver)
    assert all(each.noisy for each in damages)
    assert "unsolicited bytes" in damages[0].description("memory")


class RandomLine(MemoryLine):
    """A line that answers each packet with bytes that mean nothing, as at a wrong baud rate."""

    def __init__(self) -> None:
        super().__init__(FakeTime())
        self._random = random.Random(4)

    def _put(self, data: bytes, deadline_s: float) -> None:
        self.coming.append((self.time.now(), self._random.randbytes(9)))


class TwiceLine(MemoryLine):
    """Two servos with the id 1, of which one answers after the other: their return delays differ."""

    def __init__(self, driver: str, protocol: int) -> None:
        super().__init__(FakeTime())
        self._packets = packets_of(driver, protocol)

    def _put(self, data: bytes, deadline_s: float) -> None:
        packet, _ = self._packets.take(data)
        if packet is None or packet[0] != 1:
            return
        names_question = self._packets.names_question
        size = self._packets.answer_size(packet[1], packet[2]) or 0
        answer = self._packets.status(1, packet[1] if names_question else 0, bytes(size))
        for delay_s in (0.001, 0.0016):
            self.coming.append((self.time.now() + delay_s, answer))


@pytest.mark.parametrize("driver", ["dynamixel", "feetech", "lx16a"])
def test_answers_that_mean_nothing_are_named(plug: Plug, driver: str) -> None:
    plug(RandomLine())
    found, damages = scanned(driver)
    assert found == []
    assert "at many ids: a wrong baud rate" in damages[0].description("memory")
    assert "cannot be understood" in damages[0].description("memory")


@pytest.mark.parametrize(("driver", "protocol"), [("dynamixel", 2), ("feetech", 1), ("lx16a", 1)])
def test_two_answers_to_one_question_are_two_servos(plug: Plug, driver: str, protocol: int) -> None:
    plug(TwiceLine(driver, protocol))
    _, damages = scanned(driver)
    assert [each.doubled or each.garbled for each in damages] == [(1,)]
    assert "the same id" in damages[0].description("memory")


@pytest.mark.parametrize(("driver", "model"), FAMILIES)
@pytest.mark.parametrize(
    "fault", [(), ("bad-cable:1:coxa:0.2",), ("garble:0.1",), ("echo",), ("mute:1:tibia",)]
)
def test_nothing_is_said_of_servos_that_mostly_answer(
    plug: Plug, driver: str, model: str, fault: tuple[str, ...]
) -> None:
    plug(BoardLine(a_map(driver, model), *fault))
    found, damages = scanned(driver)
    assert damages == []
    assert found == [each for each in range(1, 10) if "mute" not in str(fault) or each != 3]
