"""Targets of a served robot and of its clients: whole messages in JSON, requests, answers and states."""

import json
from collections.abc import Callable, Iterable
from contextlib import suppress
from functools import cache
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import numpy as np

from hexctl.backends.mock import MockServos
from hexctl.backends.zenoh.subscriber import LatestValues, StateSubscriber
from hexctl.backends.zenoh.zenoh_client import ask, granted
from hexctl.cli.network.status_command import status_rows
from hexctl.client import remote
from hexctl.client.remote import RemoteRobots
from hexctl.control.guard import Guard
from hexctl.errors import HexctlError, MessageError, RobotFaultError
from hexctl.robot.formats.json_model import robot_from_json, robot_to_json
from hexctl.server.leases import LeaseManager
from hexctl.server.requests import RequestHandler
from hexctl.server.ros.settings import LiveSettings, RosSettings, content
from hexctl.server.server import RobotServer
from hexctl.server.stops.latch import StopLatch
from hexctl.server.stops.stop_socket import StopSocket
from hexctl.server.transport import Arrival
from hexctl.types import N_JOINTS, ServoReadings
from hexctl.wire import ros_cdr
from hexctl.wire.description import (
    RobotIdentity,
    check_same_robot,
    decode_json,
    describe,
    encode_json,
    robot_of,
)
from hexctl.wire.links import CLEAR_COMMAND, KeyMap, Link
from hexctl.wire.pose import encode_pose
from hexctl.wire.ros import parameters
from hexctl.wire.ros.parameters import ParameterService
from hexctl.wire.zenoh_messages import CommandTag, encode_battery, encode_positions
from tests.control.posed import PosedMock
from tests.fuzz.target import BINARY_NUMBERS, JSON_WORDS, as_text, target
from tests.robots import shipped
from tests.server.bench import Item
from tests.server.ros.test_settings import request, wishes
from tests.wire.test_zenoh_messages import COMMAND_BYTES, STATE_BYTES

UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])


@cache
def _server() -> RobotServer:
    servos = PosedMock()
    server = RobotServer(servos, Link(), backend="mock")
    servos.connect()
    servos.clock.tick()
    return server


@target(
    *(
        request(one, names=["gait", "sit_after"])
        for one in (ParameterService.GET, ParameterService.GET_TYPES, ParameterService.DESCRIBE)
    ),
    request(ParameterService.LIST, prefixes=["gait"], depth=1),
    *(
        request(one, **wishes(gait="57", sit_after=9.0, level=True))
        for one in (ParameterService.SET, ParameterService.SET_ATOMICALLY)
    ),
    words=BINARY_NUMBERS,
)
def read_ros_parameters(data: bytes) -> None:
    """Each service is asked with the same bytes; what it answers can be read, and the settings stay valid."""
    live = LiveSettings(shipped(), RosSettings(ros_drive=True))
    for service in ParameterService:
        with suppress(MessageError):
            asked = parameters.decode_request(service, data)
            answer = parameters.encode_answer(service, content(live, service, asked))
            ros_cdr.decode(parameters.request_and_answer(service)[1], answer)
    live.now.gait_of(shipped())


def _readings() -> dict[str, Any]:
    nothing = np.full(N_JOINTS, np.nan)
    return ServoReadings(
        ages_s=np.zeros(N_JOINTS),
        efforts=nothing,
        currents_a=nothing,
        voltages_v=nothing + 1,
        temperatures_c=np.full(N_JOINTS, 35.0),
        errors=("",) * 17 + ("hot",),
    ).to_json()


STATUS: dict[str, Any] = {
    "robot": "ant",
    "backend": "sim",
    "host": "lab",
    "user": "alice",
    "pid": 4711,
    "stopped": "estop: key",
    "simulated": {"world": "flat", "failure": "none"},
    "failures": ["5:limp"],
    "posture": "idle",
    "stop": {"id": "0011223344556677", "since_s": 1.0, "kept": True, "clear_in_s": 0.5},
    "at_rest": True,
    "controller": "bob",
    "controller_since_s": 2.0,
    "battery_v": 11.1,
    "battery_share": 0.5,
    "pose": True,
    "commands": {"accepted": 1, "refused": 2, "malformed": 3},
    "servos": _readings(),
    "ticks": 5,
    "warnings": ["warm"],
    "servo_link": {"lost": 1},
    "ros": {"connected": True, "router": "tcp/a:1"},
    "malformed": {"poses": 1, "requests": 2},
}


def _seed(content: object) -> bytes:
    return json.dumps(content).encode()


def _keys(content: Iterable[str]) -> tuple[bytes, ...]:
    """Words of JSON and the keys of a message."""
    return (*JSON_WORDS, *(f'"{key}":'.encode() for key in content))


KINDS = ("command", "pose", "lease", "failure", "estop", "describe")


@target(
    bytes([0, len(COMMAND_BYTES)]) + COMMAND_BYTES + encode_positions(np.zeros(N_JOINTS), 1),
    b"\1\0" + encode_pose(np.zeros(3), UPRIGHT, stamp_ns=1),
    b'\2\0{"op": "acquire", "owner": "mallory"}',
    b'\3\0{"op": "fail", "failure": "5:limp"}',
    b'\4\0{"op": "clear", "id": "0011223344556677"}',
    b"E\0",
    words=(*JSON_WORDS, b'"op"', b'"renew"', b'"lease"', b'"release"', b'"heal"', b'"leg"', b'"stop"'),
)
def read_served(data: bytes) -> None:
    """Give a message to one key of a server: the first byte says which, the second where it ends."""
    if len(data) < 2:
        return
    kind, middle, rest = KINDS[data[0] % len(KINDS)], data[1], data[2:]
    item: Any = Item(rest[middle:], rest[:middle] or None)
    server = _server()
    server._admits_command(item.attachment)
    server._handle(Arrival(kind, item, 0.0))
    for answer in item.answers:
        decode_json(answer)
    if data[0] & 0x40:
        json.dumps(server.status(), allow_nan=False)


@target(
    b'l{"op": "acquire", "owner": "bob"}\nl{"op": "renew", "lease": "00"}\ne{"op": "clear"}',
    b'f{"op": "fail", "failure": "5:limp"}\nf{"op": "heal", "leg": 5}\ne\nu{"op": "stop"}',
    words=(*JSON_WORDS, b'"op"', b'"request"', b'"id"', b'"rest"', b'"release"'),
)
def read_requests(data: bytes) -> None:
    """Give lines of requests to a robot of their own, one after another."""
    servos = MockServos(shipped())
    with Guard(servos) as guard:
        handler = RequestHandler(guard, LeaseManager(), StopLatch(guard))
        guard.clock.now_s  # noqa: B018  the clock has begun
        for number, line in enumerate(data.split(b"\n")[:8]):
            what, payload = line[:1], line[1:]
            handle = {b"l": handler.lease, b"f": handler.failure}.get(what, handler.estop)
            answer = handle(payload, float(number))
            encode_json(answer)
            if what == b"u":
                handler.urgent(payload)


@cache
def _stop_answers() -> StopSocket:
    return StopSocket(Link(), "ant", StopLatch(Guard(MockServos(shipped()))), lambda: True)


@target(bytes(160))
def read_stop_socket(data: bytes) -> None:
    """Let a robot answer datagrams without certificates, of 160 bytes each."""
    socket = _stop_answers()
    for start in range(0, len(data), 160):
        answer = socket.answer(data[start : start + 160])
        assert answer is None or len(answer) == 160


@target(
    b"{}",
    _seed({"robot": "ant", "pid": 5, "host": "a", "user": "b"}),
    b'{"a": [1, {"b": null}]}',
    words=(*JSON_WORDS, b'{"a":' * 20),
)
def read_json(data: bytes) -> None:
    content = decode_json(data)
    str(RobotIdentity.of_answer(content))


@target(_seed(describe(shipped())), words=_keys(describe(shipped())["robot"]))
def read_description(data: bytes) -> None:
    content = decode_json(data)
    with suppress(RobotFaultError):
        check_same_robot(content, shipped())
    assert robot_of(content).name is not None


@target(_seed(STATUS), b"{}", words=_keys(STATUS))
def read_status(data: bytes) -> None:
    status_rows(decode_json(data), CLEAR_COMMAND)


class Answers:
    """A session in which every query gets the lines of an input as answers."""

    def __init__(self, data: bytes) -> None:
        self._lines = data.split(b"\n")[:3]

    def get(self, key: str, **about: object) -> list[Any]:
        """The answers."""
        return [SimpleNamespace(ok=SimpleNamespace(payload=line)) for line in self._lines]


@target(
    _seed({"lease": "00" * 16, "sequence": 5, "duration_s": 1.0}) + b"\n" + _seed({"error": "held by bob"}),
    _seed({"status": {**STATUS, "stop": {"id": "00", "clear_in_s": 0.0}}, "stopped": "estop"}),
    _seed({"status": {"simulated": {}}, "failures": []}),
    words=_keys(("lease", "sequence", "duration_s", "clear_in_s", "status")),
)
def read_answers(data: bytes) -> None:
    """Ask robots on a link for everything, and make of their answers what a client does."""
    session: Any = Answers(data)
    for answer in ask(session, "key"):
        with suppress(RobotFaultError):
            lease_id, sequence, duration_s = granted(answer)
            assert 0 < duration_s < 1000
            CommandTag(
                sequence=1, stamp_ns=0, time_to_live_ms=1, lease_id=lease_id, lease_sequence=sequence
            ).packed()
    robots = RemoteRobots(session, Link())
    for status in robots.statuses():
        str(RobotIdentity.of_answer(status))
    # Clients wait for answers, and for a stop that may not be cleared yet; inputs do not.
    with patch.multiple(
        remote, LOCKOUT_S=0.0, MOST_OTHERS_LOCKOUT_S=0.0, MOST_UNCLAIMED_LOCKOUT_S=0.0, ANSWER_TIMEOUT_S=0.0
    ):
        uses: tuple[Callable[[], object], ...] = (
            lambda: robots.stop("mine"),
            robots.clear,
            lambda: robots.fail("5:limp"),
            lambda: robots.heal(5),
        )
        for use in uses:
            with suppress(HexctlError):
                use()


def _packed(*messages: tuple[bytes, bytes]) -> bytes:
    return b"".join(
        len(payload).to_bytes(2, "little") + bytes([len(tag)]) + tag + payload for payload, tag in messages
    )


@target(
    _packed(
        (encode_positions(np.zeros(N_JOINTS), 1), STATE_BYTES),
        (encode_pose(np.zeros(3), UPRIGHT, stamp_ns=1), b""),
        (encode_battery(11.1, 0.5), b""),
        (_seed(STATUS), b""),
    ),
    _packed(
        (encode_positions(np.zeros(N_JOINTS), 1), STATE_BYTES),
        (b"", b""),
        (b"", b""),
        (_seed({"failures": ["5:limp"], "warnings": [1], "servos": {}}), b""),
    ),
    words=_keys(("failures", "servos", "warnings")),
)
def read_robot_state(data: bytes) -> None:
    """Put a state together from messages, each preceded by its size: joints, pose, battery and status."""
    latest = LatestValues()
    for kind in ("joint_states", "odom", "battery", "status"):
        size, data = int.from_bytes(data[:2], "little"), data[2:]
        tag_size, data = data[:1], data[1:]
        tag, data = data[: sum(tag_size)], data[sum(tag_size) :]
        latest.put(kind, Item(data[:size], tag))
        data = data[size:]
    subscriber = StateSubscriber(KeyMap.of("ant"), latest)
    _ = subscriber.failures
    state = subscriber.newest(1.0)
    assert state.joint_positions_rad.shape == (N_JOINTS,)


@target(
    robot_to_json(shipped()).encode(),
    robot_to_json(shipped("pexod")).encode(),
    given=as_text,
    words=JSON_WORDS,
)
def read_robot_json(text: str) -> None:
    robot = robot_from_json(text)
    assert robot_to_json(robot_from_json(robot_to_json(robot))) == robot_to_json(robot)
