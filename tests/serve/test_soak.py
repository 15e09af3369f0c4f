"""What takes long: hostile input over a real link, and an adaptation over the link beside one in process."""

import json
import random
import time
from pathlib import Path

import pytest

from hexctl.backends.zenoh.client import ask
from hexctl.wire.links import KeyMap, Link, Role
from hexctl.wire.session import open_session
from tests.serve.processes import TIMEOUT_S, hexctl, served
from tests.serve.test_hostile_input import GOOD, spoiled
from tests.wire.test_messages import COMMAND_BYTES

TIMES = 100_000
KEYS = KeyMap.of("ant")


@pytest.mark.soak
@pytest.mark.parametrize("kind", ["command", "pose", "lease", "estop", "describe", "status"])
def test_a_hundred_thousand_spoiled_messages_over_the_link_move_nothing_and_delay_no_stop(
    tmp_path: Path, kind: str
) -> None:
    chance = random.Random(kind)
    good = GOOD.get(kind, b"{}")
    with (
        served(tmp_path) as robot,
        open_session(Link(endpoint=robot.endpoint), Role.CONTROLLER, KEYS) as session,
    ):
        key = getattr(KEYS, kind)
        for _ in range(TIMES):
            session.put(key, spoiled(good, chance), attachment=spoiled(COMMAND_BYTES, chance))
        assert robot.process.poll() is None
        began_s = time.monotonic()
        assert ask(session, KEYS.estop, {"op": "stop"}) == [{"stopped": "estop"}]
        assert time.monotonic() - began_s < TIMEOUT_S
        status = robot.status()
        assert status["stopped"] == "estop"
        assert robot.log().times_s.size == 0
        if kind == "command":
            counts = status["commands"]
            dropped = counts["malformed"] + counts["stale_owner"] + counts["overflowed"]
            assert dropped > TIMES / 100  # Zenoh drops what a robot cannot take; what came is counted


@pytest.mark.soak
def test_an_adaptation_over_the_link_finds_the_gait_that_one_in_process_finds(tmp_path: Path) -> None:
    """Gaits drawn at random, so that both walk the same five; the twin walks in real time and stays put."""
    options = ("--failed-leg", "5", "--budget", "5", "--optimizer", "random", "--no-record", "--json")
    with served(tmp_path, "--failed-leg", "5", backend="sim") as robot:
        link = ("--backend", "zenoh", "--connect", robot.endpoint, "--arena", "3")
        far = hexctl("adapt", *link, *options)
        assert far.returncode == 0, far.stderr
    near = hexctl("adapt", *options)
    there, here = json.loads(far.stdout), json.loads(near.stdout)
    assert [trial["code"] for trial in there["trials"]] == [trial["code"] for trial in here["trials"]]
    assert there["best"]["code"] == here["best"]["code"]
    for one, other in zip(there["trials"], here["trials"], strict=True):
        off_m = one["deviation_m"]["signed"] - other["deviation_m"]["signed"]
        assert abs(off_m) < 0.35, (one["code"], off_m)
