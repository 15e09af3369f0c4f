"""The lease of a robot on a link that loses requests and answers."""

import json
from collections import Counter
from collections.abc import Iterator
from typing import Any

import pytest
import zenoh

from hexctl.backends.zenoh.zenoh_client import LeaseClient
from hexctl.errors import HexctlError
from hexctl.server.leases import LeaseManager
from hexctl.wire.links import KeyMap, Link, Role
from hexctl.wire.zenoh_session import open_session
from tests.backends.fake_time import FakeTime
from tests.server.processes import free_port

#: Of so many requests in a row one is obeyed and answered.
ANSWERED = 3


class LossyRobot:
    """Gives leases; of the requests after the first most are lost before they arrive.

    Attributes:
        heard: requests that arrived, by kind.
    """

    def __init__(self, session: zenoh.Session, key: str, time: FakeTime) -> None:
        self._time = time
        self.heard: Counter[str] = Counter()
        self._leases, self._asked = LeaseManager(), 0
        session.declare_queryable(key, self._answer)

    def _answer(self, query: zenoh.Query) -> None:
        assert query.payload is not None
        content: dict[str, Any] = json.loads(query.payload.to_bytes())
        op, now_s = content["op"], self._time.now()
        if op != "acquire":
            self._asked += 1
            if self._asked % ANSWERED:
                return
        self.heard[op] += 1
        answer: dict[str, Any] = {}
        try:
            if op == "acquire":
                lease = self._leases.acquire(content["owner"], now_s)
                answer = {"lease": lease.lease_id.hex(), "sequence": lease.sequence}
                answer["duration_s"] = self._leases.duration_s
            elif op == "renew":
                self._leases.renew(bytes.fromhex(content["lease"]), now_s)
        except HexctlError as error:
            answer = {"error": str(error)}
        query.reply(query.key_expr, json.dumps(answer).encode())


@pytest.fixture
def time() -> FakeTime:
    return FakeTime()


@pytest.fixture
def link(time: FakeTime) -> Iterator[tuple[LossyRobot, LeaseClient]]:
    at = Link(endpoint=f"tcp/127.0.0.1:{free_port()}")
    keys = KeyMap.of("ant")
    with open_session(at, Role.ROBOT, keys) as there, open_session(at, Role.CONTROLLER, keys) as here:
        yield LossyRobot(there, keys.lease, time), LeaseClient(here, keys.lease, time=time)


def test_requests_that_are_lost_are_sent_again(link: tuple[LossyRobot, LeaseClient]) -> None:
    robot, lease = link
    lease.acquire()
    for count in range(1, 6):
        lease.pause_watchdog(after=3)
        assert robot.heard["rest"] >= count
    lease.release()
    assert robot.heard["release"] == 1


def test_a_lease_outlasts_a_bad_link(link: tuple[LossyRobot, LeaseClient], time: FakeTime) -> None:
    robot, lease = link
    lease.acquire()
    time.sleep(60.0)
    assert lease.lost is None
    assert robot.heard["renew"] >= 60
    lease.release()
