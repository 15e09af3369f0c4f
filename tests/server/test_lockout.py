"""A stranger or a stubborn client wants a robot to move on: it is stopped all the same, and stays so."""

import os
import random
import signal
import socket
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexctl.backends.zenoh.zenoh_client import ask
from hexctl.client.remote import RemoteRobots
from hexctl.client.stop_client import ReadyStop, StopResult, estop
from hexctl.errors import HexctlError
from hexctl.wire.certificates import make_certificates
from hexctl.wire.links import KeyMap, Link, Role
from hexctl.wire.stop import LOCKOUT_S
from hexctl.wire.stop_datagram import DATAGRAM_BYTES, Kind, StopDatagram, find_stop_secret, mark_of
from hexctl.wire.zenoh_session import open_session
from tests.server.processes import Served, hexctl_process, program, repeated, served, swayed, wait_until
from tests.server.test_link_faults import wait_for_motion

pytestmark = pytest.mark.realtime

KEYS = KeyMap.of("ant")

#: How often in the soak test.
MANY = 100

#: A robot rests after this, in s, on a machine that has time for it, and on one that runs other tests beside.
RESTS_S, RESTS_ON_A_BUSY_MACHINE_S = 0.5, 2.0

#: A stop is confirmed after this, in s, under an attack that the network carries, and under one at the speed
#: of this computer.
CONFIRMED_S, CONFIRMED_AT_FULL_SPEED_S = 0.5, 2.0

#: The beginning of a TLS handshake that goes no further: a record of a client's hello, cut off.
ABORTED = bytes.fromhex("16030100c8010000c40303") + bytes(40)


@contextmanager
def aborted_handshakes(port: int) -> Iterator[None]:
    """One client that begins TLS handshakes and gives them up, twenty in a second."""

    def knock() -> None:
        with socket.create_connection(("127.0.0.1", port), timeout=1.0) as stranger:
            stranger.sendall(ABORTED)

    with repeated(knock, 0.05):
        time.sleep(1.0)
        yield


@contextmanager
def silent_connections(port: int) -> Iterator[None]:
    """One client with three hundred connections that say nothing; those that are closed are opened anew."""
    held: list[socket.socket] = []

    def hold() -> None:
        while len(held) < 300:
            stranger = socket.socket()
            stranger.setblocking(False)
            stranger.connect_ex(("127.0.0.1", port))
            held.append(stranger)
        for stranger in list(held):
            with suppress(BlockingIOError, OSError):
                if stranger.recv(1) == b"":
                    stranger.close()
                    held.remove(stranger)

    try:
        with repeated(hold, 0.2):
            time.sleep(1.0)
            yield
    finally:
        for stranger in held:
            stranger.close()


@contextmanager
def garbage(port: int, mark: bytes = b"") -> Iterator[None]:
    """Tens of thousands of random datagrams a second, of the right length, with the mark if it is known."""
    chance = random.Random(1)
    flood = [mark + chance.randbytes(DATAGRAM_BYTES - len(mark)) for _ in range(64)]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:

        def send() -> None:
            for _ in range(4):
                for data in flood:
                    stranger.sendto(data, ("127.0.0.1", port))

        with repeated(send, 0.002):
            yield


@contextmanager
def recorded_question(robot: Served, per_s: float) -> Iterator[None]:
    """The question of a client that was recorded on the network, sent again and again by another process."""
    recorded = StopDatagram(kind=Kind.ASK, nonce=b"recorded").packed(secret_of(robot))
    arguments = ("tests.server.programs", "flood", str(robot.port), recorded.hex(), str(per_s))
    with program(robot.log_path.parent, "flooder", *arguments) as flooder:
        flooder.wait_for("flooding")
        yield


@contextmanager
def both_ways(robot: Served, per_s: float) -> Iterator[None]:
    """An attack on sessions and on datagrams by a stranger who has no certificate."""
    with recorded_question(robot, per_s), aborted_handshakes(robot.port):
        yield


@dataclass
class Attacked:
    """A robot that is swayed over TLS, and a session to it from before it is attacked."""

    robot: Served
    link: Link
    session: Any

    def stop(
        self, attack: Callable[[Served], Any], *, times: int, ready: bool = False
    ) -> tuple[list[float], list[StopResult]]:
        """Stop the robot again and again while it is attacked, and clear the stop as who asked for it.

        Returns how long the robot still moved after each press, in s, and the client's results.
        """
        place: dict[str, Any] = {"connect": self.link.endpoint, "credentials": self.link.credentials}
        motions_s, results = [], []
        with attack(self.robot):
            for _ in range(times):
                wait_for_motion(self.robot)
                with ExitStack() as once:
                    armed = once.enter_context(ReadyStop(**place)) if ready else None
                    if armed is not None:
                        wait_until(lambda: "datagram" in armed.reach.ways, "the robot")  # noqa: B023
                    at_s = time.monotonic()
                    results.append(estop(**place) if armed is None else armed.wait_for_rest())
                time.sleep(0.1)
                motions_s.append(self.robot.log().moved_after(at_s))
                clear(self.session, self.link)
        return motions_s, results


@pytest.fixture(scope="module")
def attacked(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Attacked]:
    folder = tmp_path_factory.mktemp("attacked")
    keys = folder / "keys"
    make_certificates(keys, hosts=["127.0.0.1"], days=1)
    with swayed(folder, keys=keys) as robot:
        link = Link(endpoint=robot.endpoint, credentials=keys)
        with open_session(link, Role.CONTROLLER, KEYS) as session:
            yield Attacked(robot, link, session)


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Served, Any]]:
    """A robot that is swayed, and a session to it."""
    with (
        swayed(tmp_path_factory.mktemp("plain")) as robot,
        open_session(Link(endpoint=robot.endpoint), Role.CONTROLLER, KEYS) as session,
    ):
        yield robot, session


def clear(session: Any, link: Link) -> None:
    """Clear the stop as the person who asked for it, as soon as that is allowed."""
    (answer,) = RemoteRobots(session, link).clear()
    assert answer["stopped"] is None, answer


def secret_of(robot: Served) -> bytes:
    secret = find_stop_secret(Link(endpoint=robot.endpoint, credentials=robot.keys), Role.CONTROLLER)
    assert secret
    return secret


ATTACKS: dict[str, Callable[[Served], Any]] = {
    "aborted handshakes": lambda robot: aborted_handshakes(robot.port),
    "silent connections": lambda robot: silent_connections(robot.port),
    "garbage datagrams": lambda robot: garbage(robot.port),
    "garbage datagrams with the mark": lambda robot: garbage(robot.port, mark_of(secret_of(robot))),
    "both ways at 50,000/s": lambda robot: both_ways(robot, 50_000),
}

#: Attacks of the soak test, and the time in s in which a stop of each is confirmed.
LONG_ATTACKS: dict[str, tuple[Callable[[Served], Any], float]] = {
    **{name: (attack, CONFIRMED_S) for name, attack in ATTACKS.items()},
    "both ways at full speed": (lambda robot: both_ways(robot, 0), CONFIRMED_AT_FULL_SPEED_S),
}


@pytest.mark.parametrize("name", ATTACKS)
def test_a_robot_is_stopped_although_it_is_attacked(attacked: Attacked, name: str) -> None:
    motions_s, results = attacked.stop(ATTACKS[name], times=1)
    assert max(motions_s) <= RESTS_ON_A_BUSY_MACHINE_S
    assert all(result.at_rest for result in results)
    if name != "garbage datagrams with the mark":  # a flood of which the robot has to read each
        assert all("datagram" in result.ways for result in results)


@pytest.mark.soak
@pytest.mark.parametrize("ready", [False, True], ids=["estop", "ready"])
@pytest.mark.parametrize("name", LONG_ATTACKS)
def test_a_robot_is_stopped_a_hundred_times_of_a_hundred_although_it_is_attacked(
    attacked: Attacked, name: str, ready: bool
) -> None:
    times = int(os.environ.get("HEXCTL_TEST_STOPS", MANY))
    attack, confirmed_s = LONG_ATTACKS[name]
    motions_s, results = attacked.stop(attack, times=times, ready=ready)
    sys.stderr.write(
        f"\n{name}: {times} stops, median {np.median(motions_s):.3f}, max {max(motions_s):.3f} s\n"
    )
    assert len(results) == times
    assert max(motions_s) <= max(RESTS_S, confirmed_s)
    assert max(result.took_s for result in results) <= confirmed_s
    assert all(result.at_rest for result in results)


class StubbornClient:
    """Clears by the id of the status, takes the lease and commands, as fast as it is answered.

    Attributes:
        clears: answers to its clears so far.
        leases: leases that it was given.
    """

    def __init__(self, session: Any) -> None:
        self._session = session
        self.clears = self.leases = 0

    def act(self) -> None:
        wanted: list[dict[str, Any]] = [{}, {"id": ""}, {"id": "0" * 16}]
        with suppress(HexctlError):
            for described in ask(self._session, KEYS.describe):
                stop = described["status"]["stop"]
                quoted = {} if stop is None else {"id": stop["id"], "keys": stop["claims"]}
                wanted.append({**quoted, "owner": "somebody else"})
            for more in wanted:
                self.clears += len(ask(self._session, KEYS.estop, {"op": "clear", **more}))
            (answer,) = ask(self._session, KEYS.lease, {"op": "acquire", "owner": "stubborn"})
            self.leases += "lease" in answer


@pytest.mark.parametrize(
    ("times", "for_s"),
    [
        (1, LOCKOUT_S + 0.5),
        pytest.param(MANY, LOCKOUT_S + 0.5, marks=pytest.mark.soak),
        pytest.param(5, 60.0, marks=pytest.mark.soak),
    ],
)
def test_a_stop_stays_against_a_client_that_clears_and_commands_in_a_loop(
    plain: tuple[Served, Any], times: int, for_s: float
) -> None:
    """The controller of the robot takes each lease that there is, and commands, too."""
    robot, session = plain
    for _ in range(times):
        wait_for_motion(robot)
        stubborn = StubbornClient(session)
        with repeated(stubborn.act, 0.0):
            result = estop(connect=robot.endpoint)
            rest_s = time.monotonic()
            time.sleep(for_s)
            assert robot.log().moved_after(rest_s) == 0
            status = robot.status()
            assert status["stopped"] == "estop"
            assert status["stop"]["id"] == result.stop_id
            assert status["controller"] is None
        assert stubborn.leases == 0
        assert stubborn.clears > 1
        clear(session, Link(endpoint=robot.endpoint))


#: Viewers of one process; after `CLOSING_S` the robot has noticed that they are silent.
TOGETHER, CLOSING_S = 20, 12.0


@pytest.mark.long
@pytest.mark.parametrize("processes", [2, pytest.param(10, marks=pytest.mark.soak)])
def test_frozen_viewers_keep_out_no_controller(tmp_path: Path, processes: int) -> None:
    """Viewers that subscribe and whose processes are stopped, so that nothing is read."""
    with served(tmp_path) as robot, ExitStack() as stack:
        arguments = ("tests.server.programs", "view", robot.endpoint, str(TOGETHER))
        viewers = [
            stack.enter_context(program(tmp_path, f"viewers-{number}", *arguments))
            for number in range(processes)
        ]
        for one in viewers:
            one.wait_for("viewing")
        for one in viewers:
            one.signal(signal.SIGSTOP)
        time.sleep(CLOSING_S)
        for command in (
            ("status",),
            ("estop", "--clear"),
            ("run", "--backend", "zenoh", "--duration", "1", "--no-record"),
        ):
            result = hexctl_process(*command, "--connect", robot.endpoint)
            assert result.returncode == 0, (command, result.stderr)
        for one in viewers:
            one.signal(signal.SIGKILL)
