"""Self-description of robots: who started one, and which ones may be commanded without being named."""

import os
import socket
from dataclasses import replace

import pytest

from hexctl.errors import InputError
from hexctl.wire.description import RobotIdentity, check_may_command, user_name
from hexctl.wire.links import DEFAULT_ENDPOINT, Link, load_link

OURS = RobotIdentity.of_this_process("ant", "sim")
NEIGHBOURS = replace(OURS, user="mallory")


def test_a_robot_of_this_process_is_ours() -> None:
    assert OURS.is_ours
    assert str(OURS) == (
        f"ant (sim), started by {user_name()} on {socket.gethostname()}, process {os.getpid()}"
    )
    assert RobotIdentity.of_answer({**OURS.to_json(), "stopped": None}) == OURS


@pytest.mark.parametrize("other", [NEIGHBOURS, replace(OURS, host="elsewhere")])
def test_a_robot_of_another_user_or_computer_is_not_commanded_by_default(other: RobotIdentity) -> None:
    by_default = load_link()
    with pytest.raises(InputError, match=rf"started by {other.user} on {other.host}.*--connect tcp/127"):
        check_may_command(other, by_default)
    check_may_command(OURS, by_default)
    for named in (load_link(endpoint=DEFAULT_ENDPOINT), load_link("loopback"), Link()):
        check_may_command(other, named)


@pytest.mark.parametrize(
    "said",
    [
        {"robot": "ant", "backend": "sim"},
        {"robot": "ant", "backend": "sim", "host": 5, "user": ["x"], "pid": "1"},
        {"robot": "ant", "backend": "sim", "host": "a\nb", "user": "", "pid": None},
    ],
    ids=["older server", "wrong types", "unprintable"],
)
def test_a_robot_that_does_not_say_who_started_it_is_accepted_with_a_note(said: dict[str, object]) -> None:
    identity = RobotIdentity.of_answer(said)
    assert not identity.known
    assert str(identity) == "ant (sim), which does not say who started it"
    check_may_command(identity, load_link())
