"""Servos that answer on a bus, without a robot or with one whose ids are not those of its file.

Bytes that are no answers are named, too: ids used twice, noise, wrong baud rates.
"""

import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexctl.backends.bus import tools
from hexctl.backends.bus.bus_map import BusMap
from hexctl.backends.bus.bus_options import BusAddress, BusOptions, ScanOptions, ServoAssignmentOptions
from hexctl.backends.bus.damage import Damage
from hexctl.backends.bus.family import find_family
from hexctl.backends.bus.servo_bus import BusCounters
from hexctl.backends.bus.tools import (
    adopt,
    bus_of,
    check_no_unexpected_ids,
    scan_bus,
    set_servo_id,
    the_servo,
)
from hexctl.errors import InputError, RobotFaultError
from hexctl.simulators.register_servos import BusServo
from tests.backends.bus.boards import (
    FAMILIES,
    MODELS,
    AnsweringLine,
    BoardLine,
    MemoryLine,
    a_map,
    memory_bus,
    register_servo_of,
    servos_on,
    stance_counts,
)
from tests.robots import edited_file, put, shipped, with_ids

every_family = pytest.mark.parametrize(("driver", "model"), [*MODELS, ("lx16a", "lx16a")])


@every_family
def test_every_servo_is_found_with_what_it_is(driver: str, model: str) -> None:
    bus_map, baud = a_map(driver, model), find_family(driver).bauds[0]
    old = driver == "lx16a"  # reports no model
    with memory_bus(bus_map, "mute:1:femur", "hot:1:tibia:72") as bus:
        found = scan_bus(bus.path, driver, baud, ids=range(6))
    assert [each.servo_id for each in found] == [1, 3, 4, 5]
    assert {(each.model, each.baud) for each in found} == {(None if old else model, baud)}
    assert found[0].position == stance_counts(bus_map)[0]
    assert found[0].voltage_v == (7.4 if old else 12.0)
    assert [each.temperature_c for each in found[:2]] == [35.0, 72.0]
    assert old or "hot" in found[1].error


@pytest.mark.parametrize(("driver", "model"), FAMILIES)
def test_the_only_servo_on_a_bus_takes_an_id_and_keeps_it_without_power(driver: str, model: str) -> None:
    with memory_bus(a_map(driver, model), "only:2:coxa") as bus:
        found = set_servo_id(bus.path, driver, find_family(driver).bauds[0], 40)
        assert found.servo_id == 40
        servo = bus.board._servos[3]
        if isinstance(servo, BusServo):
            servo.restart()
        assert servo.servo_id == 40
        if driver == "feetech":
            assert register_servo_of(bus.board, 3).memory[55] == 1, "locked again"


@pytest.mark.parametrize(("driver", "model"), [("feetech", "sts3215"), ("lx16a", "lx16a")])
def test_with_more_servos_no_id_is_changed(driver: str, model: str) -> None:
    with memory_bus(a_map(driver, model)) as bus:
        with pytest.raises(InputError, match="servos that answer: got "):
            set_servo_id(bus.path, driver, find_family(driver).bauds[0], 40)
        assert [servo.servo_id for servo in bus.board._servos] == list(range(1, 19))


def test_an_id_or_a_driver_that_cannot_be_is_refused() -> None:
    with pytest.raises(InputError, match=r"new_id: got 254; allowed: 0\.\.252"):
        set_servo_id("/dev/nothing", "feetech", 1_000_000, 254)
    with pytest.raises(InputError, match="driver: got 'hitec'; allowed: dynamixel, feetech, lx16a"):
        scan_bus("/dev/nothing", "hitec", 1_000_000)


def test_servos_are_found_at_the_baud_that_they_have() -> None:
    with memory_bus(a_map("dynamixel", "xl430-w250"), baud=57_600) as bus:
        asked: list[tuple[int, int]] = []
        assert scan_bus(bus.path, "dynamixel", 1_000_000, ids=range(1, 4)) == []
        found = scan_bus(
            bus.path,
            "dynamixel",
            1_000_000,
            57_600,
            ids=range(1, 4),
            progress=lambda *each: asked.append(each),
        )
    assert [(each.servo_id, each.baud) for each in found] == [(1, 57_600), (2, 57_600), (3, 57_600)]
    assert asked == [(number, 12) for number in range(12)]


# A servo that has fallen back to the id 1.

LOST = r"leg 3 tibia \(id 29\)"


def _from_21(driver: str = "feetech", model: str = "sts3215") -> BusMap:
    """Servos with ids from 21: id 1 belongs to none."""
    return a_map(driver, model, first_id=21)


@pytest.mark.parametrize(("driver", "model"), FAMILIES)
def test_a_lost_servo_is_named_at_connect_and_adopted(driver: str, model: str) -> None:
    bus_map, robot = _from_21(driver, model), shipped("phantomx")
    with memory_bus(bus_map, "lost-id:3:tibia") as bus:
        with servos_on(bus, bus_map) as servos:
            note = servos.read().warnings[0]
        assert note.startswith("leg 3 tibia (id 29) does not answer")
        assert "hexctl servos adopt" in note
        servo = bus.board._servos[8]
        assert servo.servo_id == 1, "nothing is written at connect"
        joint, angle_deg, adopted = adopt(robot, bus_map, bus.path, find_family(driver).bauds[0])
        assert (joint, adopted.servo_id) == (8, 29)
        assert angle_deg is not None
        assert np.radians(angle_deg) == pytest.approx(robot.stance_angles_rad[8], abs=0.01)
        assert servo.servo_id == 29
        assert not servo.holds
        if isinstance(servo, BusServo):
            servo.restart()
            assert servo.servo_id == 29, "kept without power"
        with servos_on(bus, bus_map) as again:
            assert not [each for each in again.read().warnings if "lost its id" in each]


@pytest.mark.parametrize(
    ("faults", "message"),
    [
        ((), "none; exactly one"),
        (("mute:3:tibia",), f"{LOST} does not answer, and no servo with id 1"),
        (("lost-id:3:tibia", "mute:2:coxa"), rf"leg 2 coxa \(id 24\), {LOST}; exactly one"),
    ],
)
def test_nothing_is_written_unless_exactly_one_is_lost(faults: tuple[str, ...], message: str) -> None:
    with memory_bus(_from_21(), *faults) as bus:
        before = [servo.servo_id for servo in bus.board._servos]
        with pytest.raises(RobotFaultError, match=message):
            adopt(shipped("phantomx"), _from_21(), bus.path, 1_000_000)
        assert [servo.servo_id for servo in bus.board._servos] == before


@pytest.mark.parametrize("other", ["model", "place"])
def test_a_servo_of_another_model_or_place_is_left_alone(other: str) -> None:
    with memory_bus(_from_21(), "lost-id:3:tibia") as bus:
        servo = register_servo_of(bus.board, 8)
        if other == "model":
            servo.memory[3] = 5
        else:
            bus.robot._positions_rad[8] -= 3.2
            bus.time.sleep(0.2)
        message = "model number" if other == "model" else f"allowed for {LOST}"
        with pytest.raises(RobotFaultError, match=message):
            adopt(shipped("phantomx"), _from_21(), bus.path, 1_000_000)
        assert servo.servo_id == 1


def test_a_robot_file_with_id_1_has_none_to_lose() -> None:
    with pytest.raises(RobotFaultError, match="id 1 belongs to a joint"):
        adopt(shipped("phantomx"), a_map(), "/dev/nothing", 1_000_000)


# Ids that are not those of the robot file.


@pytest.mark.parametrize(("driver", "model"), FAMILIES)
def test_ids_that_are_off_by_one_are_refused(driver: str, model: str) -> None:
    with memory_bus(a_map(driver, model, first_id=2)) as bus:
        with pytest.raises(RobotFaultError, match=r"no answer from leg 1 coxa \(id 1\), .* no joint: 19"):
            servos_on(bus, a_map(driver, model)).connect()
        assert not any(servo.holds for servo in bus.board._servos)


@pytest.mark.parametrize(
    ("first_id", "file_id", "faults", "message"),
    [
        (3, 1, (), r"femur \(id 2\), but from ids of no joint: 19, 20;"),
        (21, 21, ("lost-id:3:tibia", "mute:2:coxa"), f"{LOST}, but from ids of no joint: 1;"),
    ],
)
def test_all_ids_that_differ_are_named(
    first_id: int, file_id: int, faults: tuple[str, ...], message: str
) -> None:
    with (
        memory_bus(a_map(first_id=first_id), *faults) as bus,
        pytest.raises(RobotFaultError, match=message),
    ):
        servos_on(bus, a_map(first_id=file_id)).connect()


# Options of a bus.


@pytest.fixture
def robot(tmp_path: Path) -> str:
    section = {"driver": "lx16a", "port": "/dev/ttyUSB7", "baud": 57_600, "model": "lx224"}
    return str(edited_file(tmp_path, put("servos", with_ids(section)), base="phantomx"))


def test_a_bus_is_where_the_options_say_else_the_robot_file(robot: str) -> None:
    assert BusOptions(robot=robot).address() == BusAddress("lx16a", "/dev/ttyUSB7", 57_600)
    assert BusOptions(robot=robot, port="x", baud=9600).address() == BusAddress("lx16a", "x", 9600)
    assert BusOptions(driver="feetech", port="x").address() == BusAddress("feetech", "x", 1_000_000)
    assert BusOptions(driver="feetech", port="x:57600").address().baud == 57_600
    servo_map = BusOptions(robot=robot).servo_map()
    assert servo_map is not None
    assert servo_map.ids.tolist() == list(range(1, 19))
    assert BusOptions(driver="feetech", port="x").servo_map() is None


def test_a_scan_asks_at_one_baud_rate_or_at_all_that_are_usual(robot: str) -> None:
    for bauds, asked in ((None, (57_600,)), (115_200, (115_200,)), ("all", (115_200,))):
        options = ScanOptions(robot=robot, bauds=bauds)
        assert options.bauds_at(options.address()) == asked


def test_only_servos_that_report_no_model_are_given_one(robot: str) -> None:
    lx16a, feetech = find_family("lx16a"), find_family("feetech")
    assert ServoAssignmentOptions(robot=robot).unreported_model(lx16a) == "lx224"
    assert ServoAssignmentOptions(robot=robot, model="hts35h").unreported_model(lx16a) == "hts35h"
    assert ServoAssignmentOptions().unreported_model(lx16a) == "lx16a"
    assert ServoAssignmentOptions(robot=robot).unreported_model(feetech) is None
    with pytest.raises(InputError, match="model: got hts35h"):
        ServoAssignmentOptions(model="hts35h").unreported_model(feetech)
    with pytest.raises(InputError, match="model: got sts3215"):
        ServoAssignmentOptions(model="sts3215").unreported_model(lx16a)


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"port": "x"}, "driver"),
        ({"driver": "feetech"}, "port"),
        ({"driver": "hitec"}, "driver"),
        ({"driver": "feetech", "port": "x", "baud": 9}, "baud"),
        ({"robot": "freenove-big"}, "robot"),
        ({"robot": None, "driver": "feetech"}, "driver"),
    ],
)
def test_a_bus_that_cannot_be_is_refused(options: dict[str, Any], named: str, robot: str) -> None:
    given = options if "robot" not in options or options["robot"] else {**options, "robot": robot}
    with pytest.raises(InputError, match=f"^{named}: "):
        BusOptions(**given).address()


# Bytes that are no answers.

IDS = range(10)

#: All servos of the simulated bus but the first two.
OTHERS_MUTE = [f"mute:{leg}:{kind}" for leg in range(1, 7) for kind in ("coxa", "femur", "tibia")][2:]

Plug = Callable[[MemoryLine], MemoryLine]


@pytest.fixture
def plug(monkeypatch: pytest.MonkeyPatch) -> Plug:
    """Makes a line the one that the tools open."""

    def plugged(line: MemoryLine) -> MemoryLine:
        monkeypatch.setattr(tools, "SerialLine", lambda *_, **__: line)
        return line

    return plugged


def scanned(driver: str) -> tuple[list[int], list[Damage]]:
    damages: list[Damage] = []
    found = scan_bus("memory", driver, 1_000_000, ids=IDS, on_damage=damages.append)
    return [each.servo_id for each in found], damages


@every_family
@pytest.mark.parametrize("others", [True, False])
def test_two_servos_with_one_id_are_named_by_a_scan(
    plug: Plug, driver: str, model: str, others: bool
) -> None:
    line = plug(BoardLine(a_map(driver, model), "same-id:1:femur", *([] if others else OTHERS_MUTE)))
    _, damages = scanned(driver)
    assert [each.garbled or each.doubled for each in damages] == [(1,)]
    assert all(words in damages[0].description("memory") for words in ("several servos", "id 1", "same id"))
    with pytest.raises(RobotFaultError, match="several servos"):
        the_servo(line, driver, 1)


@every_family
def test_no_id_is_given_to_two_servos(
    plug: Plug, driver: str, model: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tools, "IDS", tuple(IDS))
    line = plug(BoardLine(a_map(driver, model), "same-id:1:femur", *OTHERS_MUTE))
    assert isinstance(line, BoardLine)
    with pytest.raises(InputError, match=r"got several|several servos"):
        set_servo_id("memory", driver, 1_000_000, 7)
    assert [servo.servo_id for servo in line.board._servos][:2] == [1, 1]


@every_family
def test_two_servos_that_lost_their_ids_are_unexpected(driver: str, model: str) -> None:
    bus_map = a_map(driver, model, first_id=2)
    line = BoardLine(bus_map, "lost-id:2:coxa", "lost-id:5:femur")
    found = bus_of(bus_map, line, BusCounters()).find()
    with pytest.raises(RobotFaultError, match="id 1 are damaged"):
        check_no_unexpected_ids(line, bus_map, found)


@every_family
def test_noise_is_named(plug: Plug, driver: str, model: str) -> None:
    plug(BoardLine(a_map(driver, model), "noise:1"))
    _, damages = scanned(driver)
    assert all(each.noisy for each in damages)
    assert "unsolicited bytes" in damages[0].description("memory")


@pytest.mark.parametrize("driver", ["dynamixel", "feetech", "lx16a"])
def test_answers_that_mean_nothing_are_named(plug: Plug, driver: str) -> None:
    """As at a wrong baud rate."""
    rng = random.Random(4)

    def anything(_: bytes) -> list[tuple[float, bytes]]:
        return [(0.0, rng.randbytes(9))]

    plug(AnsweringLine(anything))
    found, damages = scanned(driver)
    assert found == []
    assert "at many ids: a wrong baud rate" in damages[0].description("memory")
    assert "cannot be understood" in damages[0].description("memory")


@pytest.mark.parametrize(("driver", "protocol"), [("dynamixel", 2), ("feetech", 1), ("lx16a", 1)])
def test_two_answers_to_one_question_are_two_servos(plug: Plug, driver: str, protocol: int) -> None:
    """One answers after the other: their return delays differ."""
    packets = find_family(driver).formats[protocol]

    def twice(asked: bytes) -> list[tuple[float, bytes]]:
        packet, _ = packets.take(asked)
        if packet is None or packet[0] != 1:
            return []
        size = packets.answer_size(packet[1], packet[2]) or 0
        answer = packets.status(1, packet[1] if packets.names_question else 0, bytes(size))
        return [(0.001, answer), (0.0016, answer)]

    plug(AnsweringLine(twice))
    _, damages = scanned(driver)
    assert [each.doubled or each.garbled for each in damages] == [(1,)]
    assert "the same id" in damages[0].description("memory")


@every_family
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
