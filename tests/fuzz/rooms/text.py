"""Targets that a person types: gaits, failures and when they come, faults, addresses, numbers."""

from collections.abc import Callable
from contextlib import suppress

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
from hexctl.simulators.pca9685_board import PCA9685_FAULTS
from hexctl.simulators.servo2040_board import SERVO2040_FAULTS
from hexctl.teleop.picture_relay import PictureRelay
from hexctl.vision.camera_options import parse_size
from hexctl.vision.twin.camera_faults import parse_camera_fault
from hexctl.vision.twin.twin_camera import parse_point
from hexctl.wire.links import Endpoint, KeyMap, is_loopback
from hexctl.wire.page_address import PageAddress
from hexctl.wire.ros.ros_names import RosNode
from tests.fuzz.target import Target

RANGES = (Range(low=0, whole=True), Range(low=1, high=6, whole=True), Range(), Range(low=0, above=True))


def _of_text(read: Callable[[str], object]) -> Callable[[bytes], object]:
    """A reader of bytes as the command line gives them: what is no UTF-8 is escaped."""
    return lambda data: read(data.decode("utf-8", "surrogateescape"))


def _each(*parsers: Callable[[str], object]) -> Callable[[str], object]:
    """A reader that gives a text to all of some parsers, of which each may refuse it."""

    def read(text: str) -> None:
        for parse in parsers:
            with suppress(HexctlError, typer.BadParameter):
                parse(text)

    return read


def _gait(text: str) -> None:
    for failed in ((), (5,), (2, 3)):
        with suppress(HexctlError):
            slots = parse_slots(text, failed)
            code = code_from_slots(slots)
            assert slots_from_code(code) == slots == parse_slots(",".join(map(str, slots)))


def _failure(text: str) -> None:
    with suppress(HexctlError):
        failure = parse_kind(5, text)
        if failure.kind != "weak":  # its share is rounded
            assert parse_kind(5, str(failure)).kind == failure.kind
    failures, events = read_failures(text, (1, 2))
    assert [one.leg for one in failures] == sorted({1, 2, *(one.leg for one in failures)})
    for event in events:
        assert parse_failure_event(str(event)).leg == event.leg


def _event(text: str) -> None:
    with suppress(HexctlError):
        parse_failure_now(text)
    with suppress(HexctlError):
        assert parse_healing(text).failure is None
    event = parse_failure_event(text)
    assert parse_failure_event(str(event)).leg == event.leg


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


TARGETS = (
    Target(
        name="gait",
        read=_of_text(_gait),
        seeds=(b"tripod", b"57", b"5,1,2,4,3,6", b"1,1,1,1,1,1"),
        words=(b"demo", b"wave", b"ripple", b",", b"auto", b"best:"),
        most_bytes=100,
    ),
    Target(
        name="failure",
        read=_of_text(_failure),
        seeds=(
            b"locked",
            b"5:limp:femur",
            b"weak:tibia:0.3",
            b"3:stuck:coxa:-20",
            b"4:unknown,5:limp@8",
            b"5",
        ),
        words=(b"missing", b"nan", b"inf", b"1e400", b":", b"@", b","),
        most_bytes=100,
    ),
    Target(
        name="failure-event",
        read=_of_text(_event),
        seeds=(b"5:locked@8", b"2:weak:0.3@1.5", b"5@20", b"6:stuck:tibia@3", b"5:limp"),
        words=(b"missing", b"nan", b"inf", b"1e400", b":", b"@", b"unknown"),
        most_bytes=100,
    ),
    Target(
        name="fault",
        read=_of_text(
            _each(
                lambda text: parse_fault(text, BUS_FAULTS),
                lambda text: parse_fault(text, SERVO2040_FAULTS),
                lambda text: parse_fault(text, PCA9685_FAULTS),
                parse_camera_fault,
            )
        ),
        seeds=(
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
        ),
        words=(b"overload", b"unplug", b"replug", b"echo", b":", b"@", b"reset", b"9" * 400),
        most_bytes=500,
    ),
    Target(
        name="number",
        read=_of_text(
            _each(
                *(checked(each.parse) for each in RANGES),
                parse_legs,
                checked(arena_of),
                checked(parse_size),
                checked(parse_point),
            )
        ),
        seeds=(b"5", b"0.25", b"-1.63,0,1.63", b"1280x720", b"auto", b"2,5", b"place.yaml"),
        words=(b"nan", b"inf", b"1e400", b"_", b"9" * 400, b"9" * 5000, b"\xd9\xa1"),
        most_bytes=6000,
    ),
    Target(
        name="address",
        read=_of_text(
            _each(
                _endpoint,
                _page,
                parse_port,
                SerialAddress.parse,
                parse_i2c_port,
                parse_servo2040_port,
            )
        ),
        seeds=(
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
        ),
        words=(b"quic/", b"udpin:", b"serial:", b"[::]", b"rtsp://", b"@", b"\xd9\xa1", b"9" * 5000),
        most_bytes=6000,
    ),
    Target(
        name="config-name",
        read=_of_text(
            _each(
                lambda text: find_config("robots", text),
                lambda text: load_world(text.replace("/", "")),  # no file of this computer
            )
        ),
        seeds=(b"ant", b"PhantomX", b"flat", b"randomised:7", b"transfer:1048575", b"a.yaml", b"x/y"),
        words=(b"rough", b"real:", b".yaml", b"\0", b"..", b"~"),
        most_bytes=100,
        times=10,
    ),
)
