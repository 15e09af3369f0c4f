"""A walk that keeps its line over the link while sensors fail: in real time, on a served simulation.

The sensors are whole again at the end, and exact: what is measured then is where the robot truly is.
"""

from pathlib import Path

import pytest

from hexctl.control.trial_result import TrialResult
from hexctl.robot.failure import Failure
from hexctl.runs.run import RunResult, run
from hexctl.runs.run_spec import RunSpec
from tests.server.processes import served

pytestmark = [pytest.mark.long, pytest.mark.realtime]

#: In times of the simulation: of a position that is a metre off and comes back, and of a pose that freezes.
FAULTS = "yaw_drift_deg_per_min: 3, position_jump_s: [[4, 7]], pose_frozen_s: [[8, 10]]"

WALK_S = 12.0

#: The latest that a walk may begin, by the robot's ticks: its line must be laid before the faults.
LATEST_START = 75

#: How often a machine may be too busy for a walk in real time; the robot then stops for the silence, or one
#: of both skips ticks.
ATTEMPTS = 4

#: Ticks that controller and robot together may skip: 0.06 s of the walk's 12.
MOST_SKIPPED = 3

#: Where the walk may end. It ends 0.9 cm off, 0.8 cm without faults: the integral has not taken up all of the
#: pull by then. In open loop it ends 66 cm off.
NEAR_M = 0.03


def walked(world: Path, backend: str, connect: str | None = None) -> RunResult:
    """The walk, in this process or over the link."""
    spec = RunSpec(
        backend=backend,
        connect=connect,
        world=world if backend == "sim" else None,
        gait="62",
        failure=Failure(leg=3),
        self_rotation="none",
        duration_s=WALK_S,
    )
    return run(spec)


def walked_over_the_link(folder: Path, world: Path) -> TrialResult:
    """The walk of a served robot; once more where the machine was too busy for it."""
    for attempt in range(ATTEMPTS):
        (place := folder / str(attempt)).mkdir()
        with served(place, "--world", str(world), "--failed-leg", "3", backend="sim") as robot:
            if robot.status()["ticks"] > LATEST_START:
                continue
            result = walked(world, "zenoh", robot.endpoint)
            skipped = result.outcome["overruns"] + robot.status()["overruns"]
        if result.trial.stopped not in ("expired", "state") and skipped <= MOST_SKIPPED:
            return result.trial
    pytest.fail("this machine is too busy for a walk in real time")


def test_a_walk_over_the_link_keeps_its_line_as_one_in_this_process_does(tmp_path: Path) -> None:
    world = tmp_path / "world.yaml"
    world.write_text(f"sensor_faults: {{{FAULTS}}}\n", encoding="utf-8")
    alone, linked = walked(world, "sim").trial, walked_over_the_link(tmp_path, world)
    for result in (alone, linked):
        assert (result.status, result.hold, result.hold_caveat) == ("ok", "line", None)
        assert result.deviation is not None
        assert result.deviation.final < NEAR_M
    assert alone.deviation is not None
    assert alone.true_deviation is not None
    assert linked.deviation is not None
    assert alone.deviation.signed == pytest.approx(alone.true_deviation.signed, abs=1e-9)
    assert linked.deviation.signed == pytest.approx(alone.deviation.signed, abs=0.01)
    # The walk over the link begins later in the robot's time, and meets the faults at other places.
    assert linked.distance_m == pytest.approx(alone.distance_m, rel=0.07)
