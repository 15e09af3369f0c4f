"""Legs of a served simulation fail on request while a walk over the link does not know: in real time."""

import math
import random
import threading
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Self

import pytest

from hexctl.backends.zenoh.subscriber import LatestValues, StateSubscriber
from hexctl.backends.zenoh.zenoh_client import ZenohServos
from hexctl.cli.console import ABORTED, code_of
from hexctl.client.remote import remote_robots
from hexctl.control.log import TickLog
from hexctl.robot.failure import FailureEvent
from hexctl.robot.failure_grammar import parse_failure_event, parse_healing
from hexctl.runs.run import RunResult, run
from hexctl.runs.run_spec import RunSpec
from hexctl.types import JointTargets, RobotState
from hexctl.wire.links import Role
from tests.server.processes import served

pytestmark = pytest.mark.realtime

#: How often a machine may be too busy for a walk in real time; the robot then stops for the silence.
ATTEMPTS = 3

#: Share of the messages that are lost, commands and states.
LOST = 0.1


class Failing:
    """A recorder that asks a served simulation for failures at times of the walk that it records."""

    block_ticks = 1

    def __init__(self, endpoint: str, events: Sequence[FailureEvent]) -> None:
        self._endpoint, self._events = endpoint, events
        self._walked_s, self._bell = -1.0, threading.Condition()
        self._thread = threading.Thread(target=self._ask)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._tell(math.inf)
        self._thread.join()

    def write_block(self, log: TickLog, start: int, stop: int) -> None:
        """Take how far the walk is."""
        self._tell(0.02 * log.walked_ticks)

    def _tell(self, walked_s: float) -> None:
        with self._bell:
            self._walked_s = walked_s
            self._bell.notify()

    def _ask(self) -> None:
        with remote_robots(Role.CONTROLLER, connect=self._endpoint) as robots:
            for event in self._events:
                self._await(event.at_s)
                if math.isinf(self._walked_s):
                    return
                if event.failure is None:
                    robots.heal(event.leg)
                else:
                    robots.fail(f"{event.leg}:{event.failure}")

    def _await(self, at_s: float) -> None:
        with self._bell:
            self._bell.wait_for(lambda: self._walked_s >= at_s)


def walked_over_the_link(folder: Path, events: list[FailureEvent], **options: Any) -> RunResult:
    """A walk of a served simulation with failures; once more where the machine was too busy for it."""
    for attempt in range(ATTEMPTS):
        (place := folder / str(attempt)).mkdir()
        with served(place, backend="sim") as robot, Failing(robot.endpoint, events) as recorder:
            spec = RunSpec(backend="zenoh", connect=robot.endpoint, gait="tripod", **options)
            done = run(spec, recorders=(recorder,))
        if done.trial.stopped not in ("expired", "state"):
            return done
    pytest.fail("this machine is too busy for a walk in real time")


def test_a_leg_that_fails_and_heals_over_the_link_is_met_as_in_this_process(tmp_path: Path) -> None:
    events = [parse_failure_event("5:limp@3"), parse_healing("5@5")]
    how: dict[str, Any] = {"policy": "glide", "duration_s": 12.0}
    linked = walked_over_the_link(tmp_path, events, **how)
    alone = run(RunSpec(gait="tripod", failure="5:limp@3", heal=["5@5"], **how))
    for done in (alone, linked):
        assert (done.trial.status, done.trial.hold) == ("ok", "line")
        noticed, healed = done.trial.noticed
        assert (noticed.failure.leg, noticed.failure.kind, healed.healed) == (5, "limp", True)
        assert 3.0 < noticed.at_s < 4.5
        assert done.trial.deviation is not None
        assert done.trial.deviation.final < 0.03
    assert linked.trial.distance_m == pytest.approx(alone.trial.distance_m, rel=0.1)
    assert [event.partition("@")[0] for event in linked.outcome["events"]] == ["5:limp", "5"]


@pytest.mark.long
def test_servos_that_echo_and_lose_messages_stop_for_a_missing_leg(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is left are contacts and pose; the policy is that of a real robot."""
    chance = random.Random(1)
    put, write, newest = LatestValues.put, ZenohServos.write, StateSubscriber.newest

    def echoing(self: StateSubscriber, clock_s: float) -> RobotState:
        return replace(newest(self, clock_s), measured=False, joint_torques_nm=None)

    def sending(self: ZenohServos, targets: JointTargets) -> JointTargets:
        return targets if chance.random() < LOST else write(self, targets)

    def keeping(self: LatestValues, kind: str, sample: Any) -> None:
        if chance.random() >= LOST:
            put(self, kind, sample)

    for where, name, instead in (
        (StateSubscriber, "newest", echoing), (ZenohServos, "write", sending), (LatestValues, "put", keeping)
    ):  # fmt: skip
        monkeypatch.setattr(where, name, instead)
    done = walked_over_the_link(tmp_path, [parse_failure_event("5:missing@4")], duration_s=12.0)
    (noticed,) = done.trial.noticed
    assert (noticed.failure.leg, noticed.did) == (5, "stopped")
    assert done.trial.status == "aborted"
    assert done.trial.stopped is not None
    assert done.trial.stopped.startswith("leg 5 "), "how it failed is not always known"
    assert 4.0 < noticed.at_s < 7.5
    assert code_of(done.trial) == ABORTED
    assert done.log["phase"][-1] == 3, "softly, to a stand"
