"""The link: how long a command takes to come back as a state, and a bare Zenoh echo; and a long walk."""

import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

import numpy as np
import zenoh

from benchmarks.echo import BACK, THERE
from benchmarks.plans import ant
from benchmarks.rows import Bar, Row
from benchmarks.scale import Scale
from hexctl.backends.clock import PERIOD_S, WallClock
from hexctl.backends.zenoh.subscriber import LatestValues
from hexctl.backends.zenoh.zenoh_client import ZenohServos, ask
from hexctl.control.guard import Guard
from hexctl.control.log import TickLog
from hexctl.control.trial import run_trial
from hexctl.control.trial_plan import TrialPlan
from hexctl.gait.gait import make_gait
from hexctl.types import FloatArray, JointTargets
from hexctl.wire.links import KeyMap, Link, Role
from hexctl.wire.zenoh_messages import CommandTag, StateTag, encode_positions
from hexctl.wire.zenoh_session import open_session

#: Round trips of a window: a pause of the machine that hits one of the two spoils one window, not the figure.
WINDOW = 250

#: In seconds, on the same machine: what is lost after this is lost.
PATIENCE_S = 0.5


def link_rows(scale: Scale) -> Iterator[Row]:
    """Round trips at 50 Hz, the robot's and the bare echo's in turn, and a walk of minutes over the link."""
    ours, bare = _round_trips_us(round(scale.link_s / PERIOD_S))
    note = (
        f"command to state of a served mock over a bare echo, {len(ours)} of each in turn; "
        f"median over windows of {WINDOW}"
    )
    ratios = by_window(ours) / by_window(bare)
    yield Row("link.latency.p99.ratio", float(np.median(ratios)), "ratio", Bar(high=1.5), note)
    yield Row("link.latency.p50", float(np.percentile(ours, 50)), "us")
    yield from _walk_rows(scale.twin_s)


def _round_trips_us(times: int) -> tuple[FloatArray, FloatArray]:
    """Return round trips through a served mock robot and through a bare echo, each (times,) in us."""
    robot, echo = free_port(), free_port()
    with ExitStack() as stack:
        stack.enter_context(served(robot, "mock"))
        stack.enter_context(_process([sys.executable, "-m", "benchmarks.echo", str(echo)], "ready"))
        states = StateArrivals()
        link = Link(endpoint=f"tcp/127.0.0.1:{robot}")
        servos = stack.enter_context(ZenohServos(ant(), link=link, latest=states))
        link = Link(endpoint=f"tcp/127.0.0.1:{echo}")
        session = stack.enter_context(open_session(link, Role.CONTROLLER, KeyMap.of("echo")))
        return _alternate(servos, states, session, times)


def _alternate(
    servos: ZenohServos, states: "StateArrivals", session: zenoh.Session, times: int
) -> tuple[FloatArray, FloatArray]:
    """Send a command and an echo in turn, 10 ms apart, and note when each came back."""
    echoes = EchoArrivals(session)
    publisher = session.declare_publisher(
        THERE,
        congestion_control=zenoh.CongestionControl.DROP,
        priority=zenoh.Priority.REAL_TIME,
        express=True,
    )
    clock = WallClock(PERIOD_S / 2)
    stance = ant().stance_angles_rad
    sent: dict[str, list[float]] = {"ours": [], "bare": []}
    for sequence in range(1, times + 1):
        clock.tick()
        sent["ours"].append(time.perf_counter())
        servos.write(JointTargets(stance, 0.0))
        clock.tick()
        sent["bare"].append(time.perf_counter())
        tag = CommandTag(
            sequence=sequence,
            stamp_ns=time.monotonic_ns(),
            time_to_live_ms=200,
            lease_id=bytes(16),
            lease_sequence=1,
        )
        publisher.put(encode_positions(stance), attachment=tag.packed())
    time.sleep(PATIENCE_S)
    return since_us(states.first_s, sent["ours"]), since_us(echoes.first_s, sent["bare"])


class StateArrivals(LatestValues):
    """A controller's mailbox that notes when each command was first heard of in a state.

    Attributes:
        first_s: by sequence number of the command, on time.perf_counter.
    """

    def __init__(self) -> None:
        super().__init__()
        self.first_s: dict[int, float] = {}

    def put(self, kind: str, sample: zenoh.Sample) -> None:
        """Note the time, and keep the sample."""
        now_s = time.perf_counter()
        if kind == "joint_states" and sample.attachment is not None:
            self.first_s.setdefault(StateTag.unpacked(bytes(sample.attachment)).command_sequence, now_s)
        super().put(kind, sample)


class EchoArrivals:
    """Notes when each command came back from the echo.

    Attributes:
        first_s: by sequence number of the command, on time.perf_counter.
    """

    def __init__(self, session: zenoh.Session) -> None:
        self.first_s: dict[int, float] = {}
        session.declare_subscriber(BACK, self._note)

    def _note(self, sample: zenoh.Sample) -> None:
        now_s = time.perf_counter()
        if sample.attachment is not None:
            self.first_s[CommandTag.unpacked(bytes(sample.attachment)).sequence] = now_s


def since_us(first_s: dict[int, float], sent_s: list[float]) -> FloatArray:
    """Return how long each of the numbers 1, 2 ... took; one that never came took for ever."""
    took_s = [first_s.get(index, np.inf) - at_s for index, at_s in enumerate(sent_s, start=1)]
    return 1e6 * np.array(took_s)


def by_window(times_us: FloatArray) -> FloatArray:
    """Return the 99th percentile of each window of round trips; of all of them where they are fewer."""
    size = min(WINDOW, len(times_us))
    windows = times_us[: len(times_us) // size * size].reshape(-1, size)
    return np.percentile(windows, 99, axis=1)


def _walk_rows(duration_s: float) -> Iterator[Row]:
    """Walk on a simulated robot at the other end of the link; count commands that got lost."""
    port = free_port()
    link = Link(endpoint=f"tcp/127.0.0.1:{port}")
    with served(port, "sim"):
        plan = TrialPlan(gait=make_gait(ant(), "tripod"), duration_s=duration_s)
        log = TickLog()
        with Guard(ZenohServos(ant(), link=link)) as servos:
            run_trial(servos, plan, recorders=(log,))
        with open_session(link, Role.VIEWER, KeyMap.of("ant")) as session:
            counts = ask(session, KeyMap.of("ant").describe)[0]["status"]["commands"]
    dropped = sum(counts[kind] for kind in ("lost", "late", "out_of_order", "malformed", "overflowed"))
    note = f"commands of {len(log)} lost, late or refused on loopback"
    yield Row("link.twin.lost", dropped + counts["refused"], "commands", Bar(high=0), note)


@contextmanager
def served(port: int, backend: str, *options: str) -> Iterator["subprocess.Popen[str]"]:
    """Serve a robot in its own process until the block ends."""
    command = [sys.executable, "-u", "-m", "hexctl", "serve", "--backend", backend, *options]
    with _process([*command, "--listen", f"tcp/127.0.0.1:{port}"], "serving") as server:
        yield server


@contextmanager
def _process(command: list[str], ready: str) -> Iterator["subprocess.Popen[str]"]:
    """Run a process until the block ends; it has said that it is ready when the block begins."""
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        assert process.stdout is not None
        said = process.stdout.readline()
        if ready not in said:
            raise RuntimeError(f"{' '.join(command)} did not come up: {said}")
        yield process
    finally:
        process.terminate()
        process.wait(10)


def free_port() -> int:
    """Return a TCP port that is free now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
