"""Targets that a person types: gaits, failures and when they come, faults, addresses, numbers."""

from collections.abc import Callable
from contextlib import suppress
from functools import partial

import typer

from hexctl.backends.mavlink.mavlink_transport import parse_port
from hexctl.backends.pwm.pca9685 import parse_i2c_port
from hexctl.backends.pwm.servo2040 import parse_servo2040_port
from hexctl.backends.serial_ports import SerialAddress
from hexctl.backends.sim.world import load_world
from hexctl.cli.shared_options import arena_of
from hexctl.cli.signature import checked
from hexctl.errors import HexctlError
from hexctl.gait.encoding import code_from_slots, slots_from_code
from hexctl.gait.gait import parse_slots
from hexctl.options import Range
from hexctl.robot.configs import find_config
from hexctl.robot.failure_grammar import (
    parse_failure_event,
    parse_failure_now,
    parse_healing,
    parse_kind,
    parse_legs,
    read_failures,
)
from hexctl.simulators.board_faults import BUS_FAULTS, parse_fault
from hexctl.simulators.camera.camera_faults import parse_camera_fault
from hexctl.simulators.camera.twin_camera import parse_point
from hexctl.simulators.pca9685_board import PCA9685_FAULTS
from hexctl.simulators.servo2040_board import SERVO2040_FAULTS
from hexctl.teleop.picture_relay import PictureRelay
from hexctl.vision.camera_options import parse_size
from hexctl.wire.links import Endpoint, KeyMap, is_loopback
from hexctl.wire.page_address import PageAddress
from hexctl.wire.ros.ros_names import RosNode
from tests.fuzz.target import NUMBERS, as_text, target

RANGES = (Range(low=0, whole=True), Range(low=1, high=6, whole=True), Range(), Range(low=0, above=True))

FAILURE_WORDS = (*NUMBERS, b"missing", b"unknown", b":", b"@", b",")


def _each(text: str, *parsers: Callable[[str], object]) -> None:
    """Give a text to some parsers, of which each may refuse it."""
    for parse in parsers:
        with suppress(HexctlError, typer.BadParameter):
            parse(text)


@target(
    b"tripod",
    b"57",
    b"5,1,2,4,3,6",
    b"1,1,1,1,1,1",
    given=as_text,
    words=(b"demo", b"wave", b"ripple", b",", b"auto", b"best:"),
)
def read_gait(text: str) -> None:
    for failed in ((), (5,), (2, 3)):
        with suppress(HexctlError):
            slots = parse_slots(text, failed)
            code = code_from_slots(slots)
            assert slots_from_code(code) == slots == parse_slots(",".join(map(str, slots)))


@target(
    b"locked",
    b"5:limp:femur",
    b"weak:tibia:0.3",
    b"3:stuck:coxa:-20",
    b"4:unknown,5:limp@8",
    b"5",
    given=as_text,
    words=FAILURE_WORDS,
)
def read_failure(text: str) -> None:
    with suppress(HexctlError):
        failure = parse_kind(5, text)
        if failure.kind != "weak":  # its share is rounded
            assert parse_kind(5, str(failure)).kind == failure.kind
    failures, events = read_failures(text, (1, 2))
    assert [one.leg for one in failures] == sorted({1, 2, *(one.leg for one in failures)})
    for event in events:
        assert parse_failure_event(str(event)).leg == event.leg


@target(
    b"5:locked@8",
    b"2:weak:0.3@1.5",
    b"5@20",
    b"6:stuck:tibia@3",
    b"5:limp",
    given=as_text,
    words=FAILURE_WORDS,
)
def read_failure_event(text: str) -> None:
    with suppress(HexctlError):
        parse_failure_now(text)
    with suppress(HexctlError):
        assert parse_healing(text).failure is None
    event = parse_failure_event(text)
    assert parse_failure_event(str(event)).leg == event.leg


@target(
    b"mute:5:coxa@10",
    b"hot:2:femur:72@5",
    b"lost-id:3:tibia@8",
    b"bad-cable:3:femur:0.2",
    b"brown-out@12",
    b"garble:0.01",
    b"wild-once@5",
    b"covered:2@14",
    b"moved:0.05,0,0@10",
    b"turned:-3",
    b"nack:0.5",
    b"trip:3@2",
    b"mute@10",
    given=as_text,
    words=(b"overload", b"unplug", b"replug", b"echo", b":", b"@", b"reset", b"9" * 400),
)
def read_fault(text: str) -> None:
    for kinds in (BUS_FAULTS, SERVO2040_FAULTS, PCA9685_FAULTS):
        _each(text, partial(parse_fault, kinds=kinds))
    _each(text, parse_camera_fault)


@target(
    b"5",
    b"0.25",
    b"-1.63,0,1.63",
    b"1280x720",
    b"auto",
    b"2,5",
    b"place.yaml",
    given=as_text,
    words=(*NUMBERS, b"_", b"9" * 5000, b"\xd9\xa1"),
)
def read_number(text: str) -> None:
    _each(text, parse_legs, checked(arena_of), checked(parse_size), checked(parse_point))
    _each(text, *(checked(each.parse) for each in RANGES))


def _endpoint(text: str) -> None:
    with suppress(HexctlError):
        KeyMap.of("ant").renamed({"command": text})
    with suppress(HexctlError):
        _ = RosNode(namespace=text).full_name
    endpoint = Endpoint.parse(text)
    _ = endpoint.is_loopback, endpoint.is_everywhere
    assert Endpoint.parse(str(endpoint)) == endpoint


def _page(text: str) -> None:
    with suppress(HexctlError):
        PictureRelay(text)
    is_loopback(text)
    address = PageAddress.parse(text)
    assert 0 <= address.port <= 65535
    _ = address.loopback


@target(
    b"tcp/127.0.0.1:7447",
    b"tls/robot.local:7447",
    b"tcp/[::1]:7447",
    b"/dev/ttyUSB0:1000000",
    b"udpout:127.0.0.1:14550",
    b"127.0.0.1:8080",
    b"http://127.0.0.1:8018/stream.mjpg",
    b"1",
    b"/dev/serial/by-path/pci-0000:00:14.0-usb-0:2:1.0-port0",
    b"hexctl/ant/command",
    b"/lab/ant",
    given=as_text,
    words=(b"quic/", b"udpin:", b"serial:", b"[::]", b"rtsp://", b"@", b"\xd9\xa1", b"9" * 5000),
)
def read_address(text: str) -> None:
    _each(text, _endpoint, _page, parse_port, SerialAddress.parse, parse_i2c_port, parse_servo2040_port)


@target(
    b"ant",
    b"PhantomX",
    b"flat",
    b"randomised:7",
    b"transfer:1048575",
    b"a.yaml",
    b"x/y",
    given=as_text,
    words=(b"rough", b"real:", b".yaml", b"\0", b"..", b"~"),
    times=10,
)
def read_config_name(text: str) -> None:
    _each(text, partial(find_config, "robots"))
    _each(text.replace("/", ""), load_world)  # no file of this computer
