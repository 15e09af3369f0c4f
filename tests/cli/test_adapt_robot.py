"""`hexctl adapt` on real robots, without resets: refusals, stops, prompts, and resuming after each."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexctl.adapt.prior.prior import Prior, save_prior
from hexctl.adapt.sessions.store import load_session, stored_names
from hexctl.vision.detection.camera import Camera
from hexctl.vision.place import CameraPose
from tests.adapt.priors import MadeUpModel, key_of, made_up_prior
from tests.adapt.staying import PLACE
from tests.cli.conftest import Call, Output
from tests.cli.kits import Kit
from tests.cli.terminals import type_in
from tests.server.processes import ROOT
from tests.vision.scenes import WEBCAM
from tests.vision.test_place import PLACE as SEEN
from tests.vision.test_place import saved

pytestmark = pytest.mark.slow

KITS = "tests.cli.adaptkits"
PATIENCE_S = 90.0

#: Trials whose times are known: no self-rotation, one second of walk.
USUAL = {"--self-rotation": "none", "--duration": "1", "--budget": "3", "--trim": "off"}
UNRECORDED = "adapt --failed-leg 5 --no-record --no-baseline --backend"


@pytest.fixture
def adapt(call: Call) -> Call:
    """Search with a kit, with options that differ from the usual ones."""

    def adapted(kit: str, *more: str, code: int = 0) -> Output:
        usual = [word for pair in USUAL.items() if pair[0] not in more for word in pair]
        return call(UNRECORDED, kit if ":" in kit else f"{KITS}:{kit}", *usual, *more, code=code)

    return adapted


def trials_of(name: str) -> list[tuple[int, str]]:
    return [(trial.index, trial.outcome["status"]) for trial in load_session(name).trials]


def test_a_closed_stdin_is_refused(adapt: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    with Path(os.devnull).open() as closed:
        monkeypatch.setattr(sys, "stdin", closed)
        assert "--ask" in adapt("Blind", "--ask", code=2).err


@pytest.mark.parametrize(
    ("kit", "words"), [("Blind", "knows no position"), ("tests.cli.kits:NoPort", "/dev/ttyUSB7")]
)
def test_a_robot_that_cannot_be_used_leaves_no_session(kit: str, words: str, adapt: Call) -> None:
    printed = adapt(kit, code=3)
    assert words in printed.err.splitlines()[-1]
    assert printed.out == ""
    assert stored_names(Path("runs")) == []
    assert [made.closed for made in Kit.made] == [1]


@pytest.mark.parametrize(
    ("kit", "code", "reason", "kept"),
    [
        ("FallsOnce", 4, "stopped: fell", [(1, "ok"), (2, "fell")]),
        ("EStopped", 4, "stopped: estop", [(1, "ok")]),
        ("Faulty", 3, "stopped: fault", [(1, "ok")]),
        ("Unplugged", 3, "link", [(1, "ok")]),
    ],
)
def test_a_robot_that_stops_ends_the_session_and_it_goes_on_later(
    kit: str, code: int, reason: str, kept: list[tuple[int, str]], adapt: Call, call: Call
) -> None:
    printed = adapt(kit, "--json", code=code)
    (name,) = stored_names(Path("runs"))
    line = printed.err.splitlines()[-1]
    assert reason in line
    assert f"hexctl adapt --resume {name}" in line
    assert trials_of(name) == kept
    assert (printed.json["ended"], len(printed.json["trials"])) == ("stopped", len(kept))
    assert [made.closed for made in Kit.made] == [1], "one connection for all trials"
    call("adapt --trust --no-record --resume", name)
    assert trials_of(name) == [*kept, *((index, "ok") for index in range(len(kept) + 1, 4))]


MEASURED = "\n0.14 -0.02\n\nabout a metre\n20 0\n0.13,0.01\n\nagain\n\nfell\n"


def test_an_operator_measures(adapt: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    type_in(monkeypatch, MEASURED)
    printed = adapt("Blind", "--ask", "--json")
    outcome = printed.json
    ends = [(trial["distance_m"], trial["deviation_m"]["signed"]) for trial in outcome["trials"]]
    assert ends == [(0.14, -0.02), (0.13, 0.01), (None, None)]
    assert [trial["status"] for trial in outcome["trials"]] == ["ok", "ok", "fell"]
    assert outcome["best"]["index"] == 2
    assert outcome["best"]["deviation_m"]["mean"] is None
    assert "'about a metre'" in printed.err
    assert "'20 0'" in printed.err
    assert printed.err.count("trial 3, gait") == 2, "again"


@pytest.mark.parametrize("last", ["quit\n", "\nquit\n", ""])
def test_who_quits_can_go_on(last: str, adapt: Call, call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    type_in(monkeypatch, "\n0.14 0.1\n\nskip\n" + last)
    out = adapt("Blind", "--ask", code=130).out
    (name,) = stored_names(Path("runs"))
    assert trials_of(name) == [(1, "ok"), (2, "cut_short")]
    assert f"--resume {name}" in out
    type_in(monkeypatch, "\n0.13 0.0\n")
    call("adapt --trust --no-record --resume", name)
    assert trials_of(name)[2] == (3, "ok")


@pytest.mark.parametrize(
    ("kit", "hold", "rotation", "pointing", "blind"),
    [
        ("Blind", "heading", "rear", "leg 5 pointing back", True),
        ("Blind", "none", "front", "leg 5 pointing ahead", False),
        ("Straight", "heading", "rear", "", False),
    ],
)
def test_who_puts_it_down_is_told_how_and_whether_its_yaw_is_known(
    kit: str, hold: str, rotation: str, pointing: str, blind: bool, adapt: Call, monkeypatch: Any
) -> None:
    monkeypatch.setattr("hexctl.adapt.reset_free.YAW_COMES_S", 0.0)
    type_in(monkeypatch, "quit\n")
    options = ("--trim", "auto", "--hold", hold, "--self-rotation", rotation)
    told = adapt(kit, "--ask", *options, code=130).err
    assert pointing in told
    assert ("--hold none" in told) is blind


def test_ctrl_c_ends_a_question() -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "hexctl", *UNRECORDED.split(), f"{KITS}:Blind", "--trim", "off", "--ask"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    try:
        assert process.stderr is not None
        seen = b""
        while b"Enter walks" not in seen:
            seen += process.stderr.read(1)
        process.send_signal(signal.SIGINT)
        printed, _ = process.communicate(timeout=PATIENCE_S)
    finally:
        process.kill()
        process.wait()
    assert process.returncode == 130
    assert b"hexctl adapt --resume" in printed


TWIN = [*UNRECORDED.split(), "tests.adapt.staying:StayingSim"]
SMALL = ["--duration", "6", "--arena", "0.6", "--budget", "5", "--trim", "off"]


@pytest.mark.long
def test_a_twin_is_led_to_the_circle_that_a_camera_sees(call: Call) -> None:
    """It begins outside, and ends within."""
    middle = np.array([1.0, 0.8])
    camera = Camera.looking(WEBCAM, np.array([-0.2, 0.8, 1.3]), np.array([*middle, 0.0]))
    place = saved(Path.cwd(), replace(SEEN, camera=CameraPose.of(camera)))
    printed = call(*TWIN, *SMALL[:2], *SMALL[-4:], "--arena", str(place), "--json")
    outcome = printed.json
    home, radius_m = np.array(outcome["home_m"]), outcome["arena_m"]
    assert f"{radius_m:g} m" in printed.err
    assert 0.4 < radius_m < np.hypot(*home), "it began outside"
    assert len(outcome["trials"]) == 5
    assert np.hypot(*(np.load(PLACE)["qpos"][:2] - home)) < radius_m + 0.15


@pytest.mark.parametrize(
    ("kit", "code", "reason"),
    [
        ("EStopStanding", 4, "stopped: estop"),
        ("FaultStanding", 3, "stopped: fault"),
        ("FallsStanding", 4, "stopped: fell"),
        ("InterruptedConnecting", 130, "nothing was recorded"),
    ],
)
def test_a_robot_that_does_not_come_to_stand_begins_no_session(
    kit: str, code: int, reason: str, adapt: Call
) -> None:
    save_prior(standing_prior(), Path("x.npz"))
    assert reason in adapt(kit, *STANDING, code=code).err
    assert stored_names(Path("runs")) == []
    if code == 130:
        assert not Kit.made[0].sent, "it stood up after the interrupt"


def test_a_robot_that_a_person_puts_down_does_not_stand_up_before_it_was_asked_for(
    adapt: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    save_prior(standing_prior(), Path("x.npz"))
    type_in(monkeypatch, "quit\n")
    adapt("Straight", "--ask", *STANDING, code=130)
    assert not Kit.made[0].sent


#: Trials for which the prior knows how robots stand.
STANDING = ("--prior", "x.npz", "--self-rotation", "rear", "--duration", "6")


def standing_prior() -> Prior:
    """A made-up prior for trials of 6 s that knows how robots stand."""
    model = MadeUpModel()
    prior = made_up_prior(key_of(duration_s=6.0), worlds=6, model=model)
    return replace(prior, sag_rad=model.sags(6, 5)[np.newaxis])


def test_the_arena_stays_where_it_was_after_a_kill(call: Call) -> None:
    command = [sys.executable, "-m", "hexctl", *TWIN, *SMALL]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    process = subprocess.Popen(command, stdout=subprocess.PIPE, env=environment, text=True)
    try:
        assert process.stdout is not None
        deadline_s = time.monotonic() + PATIENCE_S
        while not process.stdout.readline().startswith("   2 "):
            assert time.monotonic() < deadline_s
    finally:
        process.kill()
        process.wait()
    away_m = float(np.hypot(*np.load(PLACE)["qpos"][:2]))
    (name,) = stored_names(Path("runs"))
    resumed = call("adapt --trust --no-record --json --resume", name).json
    assert len(resumed["trials"]) == 5
    assert resumed["arena_m"] == 0.6
    assert np.hypot(*resumed["home_m"]) < 0.05 < away_m, "home is where it began, not where it was found"
    assert float(np.hypot(*np.load(PLACE)["qpos"][:2])) < 0.75


def test_the_baseline_is_announced_and_walked_on_a_robot_and_asked_for_by_name(
    call: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = ["--backend", f"{KITS}:Blind", "--self-rotation", "none", "--duration", "1", "--budget", "1"]
    type_in(monkeypatch, "\n0.14 -0.02\n\n0.13 0.01\n\n0.12 0.03\n\n0.12 0.04\n")
    said = call("adapt --failed-leg 5 --ask --no-record --json", *words)
    assert "baseline" in said.err
    session = said.json
    assert [(walk["gait"], walk["score"]) for walk in session["baseline"]] == [
        ("auto", 0.02),
        ("demo", 0.01),
        ("tripod", 0.03),
    ]
    assert [(trial["index"], trial["score"]) for trial in session["trials"]] == [(1, 0.04)]
