"""Faults: what is measured of a robot after one, which cells are run and how a run goes on."""

import random
import socket
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from faults.backend import BACKENDS
from faults.fault import FAULTS
from faults.injection import LongestWait
from faults.matrix import Matrix, jobs
from faults.measurement import (
    MOST_WAIT_S,
    Outcome,
    fell_after,
    goes_on,
    largest_steps,
    late_s,
    rest_after_s,
    told_after_s,
)
from faults.phase import PHASES
from faults.programs.relay import Condition, Frames, Queue
from faults.programs.truth import FAULT, STATE, TOLD, Truth, TruthWriter
from faults.results import Results
from faults.sense import cells, left_out, why_not
from faults.table import HOLDS, UNMEASURED, bars
from hexctl.types import FloatArray
from tests.server.processes import relayed

TIMES_S: FloatArray = np.linspace(0.0, 1.98, 100)


def outcome(**given: Any) -> Outcome:
    """A walk without a fault, but for what is given."""
    values: dict[str, Any] = {"fault": "none", "backend": "zenoh", "phase": "walking", "repetition": 0}
    values |= {"rest_s": None, "told_s": 1.0, "step": 1.0, "fell": False, "goes_on": True}
    return Outcome(**values | given)


def truth_of(angle_rad: FloatArray, *, cos_tilt: FloatArray | None = None) -> Truth:
    """A robot all of whose joints have an angle, (n,), and were told it when it changed."""
    joints_rad = np.repeat(angle_rad[:, np.newaxis], 18, axis=1)
    return Truth(
        TIMES_S,
        joints_rad,
        np.ones(TIMES_S.size) if cos_tilt is None else cos_tilt,
        TIMES_S,
        joints_rad,
        np.zeros(0),
    )


def test_a_joint_rests_once_it_stays_where_it_is() -> None:
    moves = 2 * np.where(TIMES_S < 0.7, TIMES_S, 0.7)
    assert rest_after_s(truth_of(moves), 0.5) == pytest.approx(0.2)
    assert told_after_s(truth_of(moves), 0.5) == pytest.approx(0.2)


def test_a_foot_that_creeps_under_load_is_at_rest_however_long_it_is_watched() -> None:
    moves = np.minimum(TIMES_S, 0.6) + 0.06 * np.maximum(TIMES_S - 0.6, 0.0)
    assert rest_after_s(truth_of(moves), 0.5) == pytest.approx(0.1)
    assert rest_after_s(truth_of(2 * moves), 0.5) is None


def test_one_that_moves_to_the_end_does_not_rest() -> None:
    truth = truth_of(np.sin(6 * TIMES_S))
    assert rest_after_s(truth, 0.5) is None
    assert goes_on(truth)
    assert not goes_on(truth_of(np.where(TIMES_S < 0.7, TIMES_S, 0.7)))


def test_steps_count_across_the_fault_in_limits_of_a_control_period() -> None:
    angle_rad = np.where(TIMES_S < 0.99, 0.0, 0.1)
    step, pace = largest_steps(truth_of(angle_rad), 1.0, np.full(18, 2.0))
    assert step == pytest.approx(2.5)
    assert pace == pytest.approx(2.0)
    assert largest_steps(truth_of(angle_rad), 1.5, np.full(18, 2.0)) == (0.0, 0.0)
    assert largest_steps(truth_of(angle_rad), 1.0, np.full(18, 2.0), continuous=True) == pytest.approx(
        (step, step / 1.025)
    )


def test_a_servo_that_gets_its_torque_is_told_a_step_from_where_its_joint_is() -> None:
    truth = truth_of(0 * TIMES_S)
    told_rad = np.where(TIMES_S[:, np.newaxis] < 1.0, np.nan, np.full((1, 18), 0.1))
    limp = replace(truth, told_rad=told_rad)
    assert largest_steps(limp, 0.5, np.full(18, 2.0)) == pytest.approx((2.5, 2.0))
    here = replace(limp, joints_rad=truth.joints_rad + 0.1)
    assert largest_steps(here, 0.5, np.full(18, 2.0)) == pytest.approx((0.0, 0.0))


def test_a_truth_that_is_full_is_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("faults.programs.truth.CAPACITY", 2)
    monkeypatch.setattr("faults.programs.truth._SIZE", 8 + 2 * 21 * 8)
    writer = TruthWriter(tmp_path / "truth")
    writer.add(STATE)
    assert Truth.read(tmp_path / "truth").at_s.size == 1
    writer.add(STATE)
    with pytest.raises(ValueError, match="is full"):
        Truth.read(tmp_path / "truth")


def test_a_body_that_leans_for_as_long_as_a_fall_takes_has_fallen() -> None:
    for ticks, fallen in ((5, False), (20, True)):
        cos_tilt = np.ones(TIMES_S.size)
        cos_tilt[60 : 60 + ticks] = 0.3
        assert fell_after(truth_of(0 * TIMES_S, cos_tilt=cos_tilt), 0.5) is fallen


def test_a_twin_that_is_kept_waiting_is_noticed() -> None:
    truth = truth_of(0 * TIMES_S)
    assert late_s(truth, 0.0) == pytest.approx(0.0, abs=1e-9)
    held = replace(truth, at_s=np.where(TIMES_S < 1, TIMES_S, TIMES_S + 0.05))
    assert late_s(held, 0.0) == pytest.approx(0.05)


def test_how_long_threads_are_kept_waiting_is_noted() -> None:
    """By a thread that keeps the interpreter's lock."""
    before_s = sys.getswitchinterval()
    with LongestWait() as wait:
        time.sleep(0.02)
        sys.setswitchinterval(10)
        try:
            until_s = time.monotonic() + 0.1
            while time.monotonic() < until_s:
                pass
        finally:
            sys.setswitchinterval(before_s)
    assert wait.longest_s > 0.05
    assert not outcome(waited_s=wait.longest_s + MOST_WAIT_S).punctual
    assert outcome(waited_s=MOST_WAIT_S).punctual


def test_what_a_twin_writes_is_read(tmp_path: Path) -> None:
    path = tmp_path / "truth"
    writer = TruthWriter(path)
    writer.add(STATE, np.arange(18.0), 0.5)
    writer.add(TOLD, np.ones(18))
    writer.add(FAULT)
    truth = Truth.read(path)
    assert truth.joints_rad.tolist() == [list(range(18))]
    assert truth.cos_tilt.tolist() == [0.5]
    assert truth.told_rad.tolist() == [[1.0] * 18]
    assert truth.fault_at_s.size == 1


def test_a_stop_is_unneeded_only_where_it_is_safe_to_go_on() -> None:
    assert outcome(fault="wild-reading", stops=("state",)).unneeded
    assert outcome(fault="wild-reading", goes_on=False).unneeded
    assert not outcome(fault="wild-reading").unneeded
    assert not outcome(fault="controller-killed", stops=("expired",)).unneeded
    assert not outcome(fault="wild-reading", phase="standing", goes_on=False).unneeded


def test_every_combination_is_run_or_has_a_reason() -> None:
    run = set(cells())
    for fault in FAULTS.values():
        for backend in BACKENDS.values():
            for phase in PHASES:
                named = why_not(fault, backend, phase)
                assert ((fault.name, backend.name, phase) in run) == (named is None)
    assert len(run) > 500
    assert all(what and reason for reason, what in left_out().items())


def test_a_run_goes_on_where_it_was(tmp_path: Path) -> None:
    only = ["none/zenoh/walking"]
    assert [job.wanted for job in jobs(only, 2, [])] == [(("walking", 0), ("walking", 1))]
    results = Results(tmp_path / "results.jsonl")
    results.add(outcome())
    with (tmp_path / "results.jsonl").open("a") as file:
        file.write('{"fault": "none", "backe')  # a run that was killed
    assert [job.wanted for job in jobs(only, 2, results.read())] == [(("walking", 1),)]


def test_an_error_of_one_injection_ends_no_other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object, **__: object) -> None:
        raise OSError("no space")

    monkeypatch.setattr("faults.matrix.Rig", fails)
    said: list[Outcome | str] = []
    work = jobs(["none/zenoh/walking", "none/mavlink/walking"], 2, [])
    matrix = Matrix(Results(tmp_path / "results.jsonl"), said.append)
    matrix.run(work, rigs=1)
    assert matrix.broken == 4
    names = [
        f"none/{backend}/walking {number}: Traceback" for backend in ("zenoh", "mavlink") for number in (0, 1)
    ]
    assert [str(each)[: len(name)] for each, name in zip(said, names, strict=True)] == names
    assert all("OSError: no space" in str(each) for each in said)


def test_a_share_holds_only_with_as_many_injections_as_show_it() -> None:
    good = outcome(fault="controller-killed", rest_s=0.04, stops=("expired",), goes_on=False)
    name = "at rest within 0.25 s in 99.9 % of the injections"
    assert bars([])[name] == UNMEASURED
    assert bars([good] * 100)[name] == "not shown yet (100 of 100; more than 97.05 % with 95 % confidence)"
    assert bars([good] * 2994)[name].startswith("not shown yet (2994 of 2994")
    assert bars([good] * 2996)[name].startswith(f"{HOLDS} (2996 of 2996")


def test_lines_behind_one_that_was_cut_off_are_kept_and_one_of_another_version_is_named(
    tmp_path: Path,
) -> None:
    path = tmp_path / "results.jsonl"
    path.write_text('{"fault": "none", "backe', encoding="utf-8")
    results = Results(path)
    added = [
        outcome(),
        outcome(rest_s=0.1, fell=True, stops=("fell",), ended="EStopError", trials=2, lost=0, late_s=0.1),
        outcome(commit="0123abcd"),
    ]
    for one in added:
        results.add(one)
    assert results.read() == added
    with path.open("a") as file:
        file.write('{"flavour": 1}\n')
    with pytest.raises(ValueError, match=r"results.jsonl, line 5: .*flavour"):
        results.read()


def frame(text: str) -> bytes:
    return len(text).to_bytes(2, "little") + text.encode()


@pytest.mark.realtime
def test_frames_are_whole_however_they_come() -> None:
    stream = b"".join(map(frame, ("one", "", "three")))
    for size in range(1, len(stream) + 1):
        frames = Frames()
        pieces = [stream[start : start + size] for start in range(0, len(stream), size)]
        assert [each for piece in pieces for each in frames.take(piece)] == list(
            map(frame, ("one", "", "three"))
        )


def tell(relay: subprocess.Popen[str], line: str) -> None:
    """Tell a relay something once it has passed on what was sent before."""
    assert relay.stdin is not None
    time.sleep(0.3)
    print(line, file=relay.stdin, flush=True)
    time.sleep(0.3)


@pytest.mark.realtime
def test_about_as_many_datagrams_are_lost_as_told_and_all_while_the_relay_is_cut() -> None:
    with socket.socket(type=socket.SOCK_DGRAM) as before, socket.socket(type=socket.SOCK_DGRAM) as behind:
        behind.bind(("127.0.0.1", 0))
        behind.settimeout(10)
        with relayed(f"udp/127.0.0.1:{behind.getsockname()[1]}") as (endpoint, relay):
            before.connect(("127.0.0.1", int(endpoint.rpartition(":")[2])))
            tell(relay, "loss 0.3")
            for number in range(300):
                before.send(number.to_bytes(2, "little"))
                time.sleep(0.001)
            tell(relay, "cut")
            before.send(b"cut")
            tell(relay, "clear")
            before.send(b"end")
            came = list(iter(lambda: behind.recv(100), b"end"))
    assert 150 < len(came) < 270
    assert b"cut" not in came


@pytest.mark.realtime
def test_frames_of_a_connection_are_lost_while_the_relay_is_cut() -> None:
    with (
        socket.create_server(("127.0.0.1", 0)) as server,
        relayed(f"tcp/127.0.0.1:{server.getsockname()[1]}") as (endpoint, relay),
        socket.create_connection(("127.0.0.1", int(endpoint.rpartition(":")[2]))) as before,
        server.accept()[0] as behind,
    ):
        behind.settimeout(10)
        for line, text in (("clear", "first"), ("cut", "lost"), ("clear", "later")):
            tell(relay, line)
            before.sendall(frame(text))
        expected = frame("first") + frame("later")
        assert behind.makefile("rb").read(len(expected)) == expected


def test_what_is_cut_off_is_lost_and_what_comes_later_passes() -> None:
    sent: list[bytes] = []
    condition = Condition()
    queue = Queue(condition, random.Random(0))
    queue.put(b"first", sent.append)
    condition.change("cut")
    queue.put(b"lost", sent.append)
    condition.change("clear")
    queue.put(b"later", sent.append)
    assert sent == [b"first", b"later"]
