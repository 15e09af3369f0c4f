"""A trial in a batch is the same trial alone, to the last bit."""

import pickle
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hexctl import (
    Failure,
    LimitError,
    ReachError,
    Robot,
    SimServos,
    SimTrial,
    TrialPlan,
    TrialResult,
    World,
    load_robot,
    make_gait,
    run_sim_trials,
)
from hexctl.backends.sim.flaws import SensorFaults
from hexctl.backends.sim.simulated_batch import SimBatch
from hexctl.control.batch import run_sim_trial
from hexctl.control.controllers import check_walk
from hexctl.robot.model import in_stance_of

FAULTY = SensorFaults(yaw_drift_deg_per_min=200.0, pose_frozen_s=((0.9, 1.5),), position_jump_s=((1.8, 2.1),))

#: Worlds that differ in all but the step of the physics and the age of states.
DIFFERENT = [
    World(state_latency_s=0.04),
    World(state_latency_s=0.04, slope_deg=2.0, joint_offset_deg=1.0, servo_strength=0.8),
    World.model_validate(
        {
            "state_latency_s": 0.04,
            "sensor_noise": {"joint_deg": 0.5, "position_m": 0.01, "yaw_deg": 0.5},
            "lost_poses": 0.3,
            "lost_commands": 0.1,
            "servo_backlash_deg": 0.5,
        }
    ),
    World(state_latency_s=0.04, roughness_m=0.004),
    World(state_latency_s=0.04, payload_kg=0.4, friction=0.6, sensor_faults=FAULTY),
]


@pytest.fixture(scope="module")
def ant() -> Robot:
    return load_robot("ant")


def trial(
    robot: Robot,
    gait: str,
    *,
    world: World | None = None,
    seed: int = 0,
    failure: Failure | None = None,
    **plan: Any,
) -> SimTrial:
    legs = (failure.leg,) if failure else ()
    told = {"belief": failure, "duration_s": 1.5, **plan}
    made = TrialPlan(gait=make_gait(robot, gait, failed_legs=legs), **told)
    return SimTrial(robot=robot, plan=made, failure=failure, world=world or World(), seed=seed)


def assert_as_alone(trials: list[SimTrial], results: list[TrialResult] | None = None) -> list[TrialResult]:
    together = run_sim_trials(trials) if results is None else results
    for one, alone in zip(together, map(run_sim_trial, trials), strict=True):
        assert one.to_dict() == alone.to_dict()
        assert np.array_equal(one.path_m, alone.path_m, equal_nan=True)
    return together


@pytest.mark.slow
def test_a_batch_on_any_number_of_threads_equals_its_single_trials(ant: Robot) -> None:
    trials = [trial(ant, code, seed=5, failure=Failure(leg=3)) for code in ("1", "120")]
    elsewhere = pickle.loads(pickle.dumps(trials))  # noqa: S301  trials travel between processes
    for threads in (1, 2):
        assert_as_alone(trials, run_sim_trials(elsewhere, threads=threads))


def test_a_batch_that_is_steered_by_faulty_sensors_equals_its_single_trials(ant: Robot) -> None:
    world = World(sensor_faults=FAULTY)
    trials = [trial(ant, code, world=world, hold="auto", duration_s=2.0) for code in ("1", "700")]
    assert [result.hold for result in assert_as_alone(trials)] == ["line", "line"]


@pytest.mark.slow
@pytest.mark.parametrize("hold", ["none", "line"])
def test_trials_of_many_worlds_and_failures_are_stepped_together_and_each_is_as_alone(
    hold: str, ant: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    together: list[int] = []

    class Counted(SimBatch):
        def __init__(self, servos: Any, n: Any, threads: int = 0) -> None:
            together.append(len(servos))
            super().__init__(servos, n, threads)

    monkeypatch.setattr("hexctl.control.batch.SimBatch", Counted)
    kinds = ("locked", "limp", "missing", "weak", "stuck")
    trials = [
        trial(ant, code, world=world, seed=7, failure=Failure(leg=leg, kind=kind), hold=hold, **start)
        for (world, kind), leg in zip(zip(DIFFERENT, kinds, strict=True), (1, 3, 4, 2, 6), strict=True)
        for code, start in (("1", {"self_rotation": "none"}), ("40", {"heading_rad": 0.3, "duration_s": 2.2}))
    ]
    made = run_sim_trials(trials)
    assert sorted(together) == [2, 2, 6], "bumps and a payload make models of other sizes"
    assert {one.hold for one in assert_as_alone(trials, made)} == {hold}
    assert None not in (made[-1].energy_j, made[-1].tilt_deg, made[-1].steadiness)


@pytest.mark.slow
def test_different_lengths_motions_and_paces_in_one_batch_in_the_order_of_the_trials(ant: Robot) -> None:
    trials = [
        trial(ant, "demo", duration_s=1.0),
        trial(ant, "tripod", duration_s=1.7, heading_rad=2.0),
        trial(ant, "wave", duration_s=0.5, turn_rate_rad_s=0.1, travel=0.5),
        trial(ant, "demo", duration_s=1.2),
    ]
    assert_as_alone(trials)


def test_robots_that_are_equal_share_one_start_whichever_object_holds_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    trials = [trial(load_robot("ant"), code, failure=Failure(leg=5), duration_s=0.5) for code in "123"]
    assert len({made.shared_start() for made in trials}) == 1
    assert len({made.shared_start() for made in pickle.loads(pickle.dumps(trials))}) == 1  # noqa: S301
    others = [trial(load_robot("pexod"), "1", failure=Failure(leg=5)), trial(load_robot("ant"), "1")]
    assert len({made.shared_start() for made in [*trials, *others]}) == 3
    connected: list[SimServos] = []
    connect = SimServos.connect

    def note(servos: SimServos) -> None:
        connected.append(servos)
        connect(servos)

    monkeypatch.setattr(SimServos, "connect", note)
    assert len(run_sim_trials(trials)) == 3
    assert len(connected) == 1


@pytest.mark.slow
def test_trials_that_turn_by_different_angles_do_not_share_a_start(ant: Robot) -> None:
    turned = assert_as_alone([trial(ant, "tripod", turn_rad=turn_rad) for turn_rad in (0.6, 0.0)])
    assert [result.turned_rad for result in turned] == pytest.approx([0.6, 0.0], abs=0.1)


@pytest.mark.parametrize("place", [0, 2])
def test_a_plan_that_the_legs_cannot_make_is_refused_before_any_robot_is_built(
    place: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Forward the gait is possible; sideways, where the self-rotation leads, it is not."""
    phantomx = in_stance_of(load_robot("phantomx"), 0.15)
    bad = trial(phantomx, "1", failure=Failure(leg=2))
    bad = replace(bad, plan=replace(bad.plan, gait=replace(bad.plan.gait, amplitude=0.13)))
    check_walk(phantomx, bad.plan.gait, bad.plan.motion(0.0))
    trials = [trial(phantomx, "1", failure=Failure(leg=leg)) for leg in (2, 3)]
    trials.insert(place, bad)
    monkeypatch.setattr(SimServos, "connect", lambda _: pytest.fail("a robot was built"))
    with pytest.raises((ReachError, LimitError)):
        run_sim_trials(trials)


@pytest.mark.slow
def test_a_fall_in_a_batch_ends_that_trial_as_it_does_alone(ant: Robot) -> None:
    """A top-heavy robot falls with one gait in its own time; with the others it walks on."""
    world = World(payload_kg=6.0, payload_position_m=(0.0, 0.0, 0.5))
    trials = [trial(ant, gait, world=world, duration_s=6.0) for gait in ("tripod", "wave", "demo")]
    results = assert_as_alone(trials)
    assert [result.status for result in results] == ["ok", "fell", "ok"]
    assert 0 < results[1].duration_s < 6


def test_a_robot_that_falls_before_its_walk(ant: Robot) -> None:
    world = World(payload_kg=6.0, payload_position_m=(0.5, 0.0, 0.3))
    (made,) = assert_as_alone([trial(ant, "demo", world=world)])
    assert (made.status, made.deviation) == ("fell", None)


def test_one_that_diverges_ends_alone(ant: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    trials = [trial(ant, code, duration_s=1.0) for code in ("1", "120")]
    alone, ticks, tick = run_sim_trial(trials[1]), 0, SimBatch.tick

    def blow_up(batch: SimBatch) -> None:
        nonlocal ticks
        ticks += 1
        if ticks == 30:
            batch._batch.bind("qvel")[0] = 1e12
        tick(batch)

    monkeypatch.setattr(SimBatch, "tick", blow_up)
    first, second = run_sim_trials(trials)
    assert first.status == "diverged"
    assert second == alone
