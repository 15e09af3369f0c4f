"""Self-description of robots: model, protocol, and who started it."""

from dataclasses import replace

import numpy as np
import pytest

from hexctl.errors import InputError, MessageError, RobotFaultError
from hexctl.types import JOINT_NAMES
from hexctl.wire.description import (
    RobotIdentity,
    check_may_command,
    check_same_robot,
    decode_json,
    describe,
    encode_json,
    robot_of,
)
from hexctl.wire.links import DEFAULT_ENDPOINT, Link, load_link
from tests.robots import shipped

OURS = RobotIdentity.of_this_process("ant", "sim")
NEIGHBOURS = replace(OURS, user="mallory")


@pytest.mark.parametrize("other", [NEIGHBOURS, replace(OURS, host="elsewhere")])
def test_a_robot_of_another_user_or_computer_is_not_commanded_by_default(other: RobotIdentity) -> None:
    by_default = load_link()
    with pytest.raises(InputError, match=f"{other.user} on {other.host}"):
        check_may_command(other, by_default)
    check_may_command(OURS, by_default)
    for named in (load_link(connect=DEFAULT_ENDPOINT), load_link("loopback"), Link()):
        check_may_command(other, named)


@pytest.mark.parametrize(
    "said",
    [
        {"robot": "ant", "backend": "sim"},
        {"robot": "ant", "backend": "sim", "host": 5, "user": ["x"], "pid": "1"},
        {"robot": "ant", "backend": "sim", "host": "a\nb", "user": "", "pid": None},
    ],
    ids=["nothing", "wrong types", "unprintable"],
)
def test_a_robot_that_does_not_say_who_started_it_is_commanded_only_by_name(said: dict[str, object]) -> None:
    identity = RobotIdentity.of_answer(said)
    assert str(identity) == "ant (sim), started by ? on ?"
    with pytest.raises(InputError, match="connect tcp/127"):
        check_may_command(identity, load_link())
    check_may_command(identity, load_link("loopback"))


@pytest.mark.parametrize("name", ["ant", "phantomx"])
def test_a_robot_recognises_its_own_description(name: str) -> None:
    answer = decode_json(encode_json(describe(shipped(name))))
    check_same_robot(answer, shipped(name))
    check_same_robot(answer, robot_of(answer))


def test_another_robot_is_refused_with_the_place_where_it_differs() -> None:
    answer = describe(shipped())
    answer["robot"]["mount_positions_body"][2][1] += 0.001
    with pytest.raises(RobotFaultError, match=r"mount_positions_body\[2\]\[1\] is .* there and .* here"):
        check_same_robot(answer, shipped())


def test_another_protocol_or_other_joints_are_refused() -> None:
    with pytest.raises(RobotFaultError, match="protocol 2"):
        check_same_robot({**describe(shipped()), "protocol": 2}, shipped())
    with pytest.raises(RobotFaultError, match="other joints"):
        check_same_robot({**describe(shipped()), "joints": list(JOINT_NAMES[::-1])}, shipped())
    with pytest.raises(RobotFaultError):
        check_same_robot({}, shipped())


@pytest.mark.parametrize("payload", [b"", b"{", b"[]", b"1", b"\xff", b"[" * 60_000, b"x" * 70_000])
def test_what_is_no_json_object_is_refused(payload: bytes) -> None:
    with pytest.raises(MessageError, match="JSON: got"):
        decode_json(payload)


@pytest.mark.parametrize("spoil", [{}, {"protocol": 1, "robot": {"name": "x"}}, {"protocol": 1, "robot": 5}])
def test_a_description_of_no_robot_is_refused(spoil: dict[str, object]) -> None:
    with pytest.raises(RobotFaultError, match="describes itself"):
        robot_of(spoil)


def test_a_robot_with_masses_and_friction_of_its_own_arrives_whole() -> None:
    body = replace(shipped().body, com_m=(0.01, 0.0, 0.02), inertia_kg_m2=(1e-4, 1e-4, 1.5e-4))
    robot = replace(
        shipped(),
        body=body,
        joint_dry_friction_nm=np.full(18, 0.1),
        joint_no_load_speed_rad_s=np.full(18, 7.0),
        joint_stiffness_nm_per_rad=np.arange(1.0, 19.0),
        link_coms_m=np.full((3, 2), 0.01),
    )
    answer = decode_json(encode_json(describe(robot)))
    assert robot_of(answer) == robot
    assert robot_of(answer).fingerprint == robot.fingerprint
    check_same_robot(answer, robot)
    with pytest.raises(RobotFaultError, match=r"another one: body\.com_m"):
        check_same_robot(answer, replace(robot, body=shipped().body))
