"""Trials from their plan to their result; single and batched trials are bit-equal."""

import json
import math
import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexctl import (
    Failure,
    Guard,
    InputError,
    JointTargets,
    LimitError,
    ReachError,
    SimServos,
    SimTrial,
    TrialPlan,
    TrialResult,
    World,
    load_robot,
    make_gait,
    run_sim_trials,
    run_trial,
)
from hexctl.backends.sim.flaws import SensorFaults, SensorNoise
from hexctl.backends.sim.simulated_batch import SimBatch
from hexctl.control.batch import run_sim_trial
from hexctl.control.controllers import check_walk
from hexctl.control.log import TickLog
from hexctl.control.trial_result import Deviation
from hexctl.robot.model import in_stance_of
from tests.control.checks.loads import along, scored
from tests.control.posed import PosedMock
from tests.robots import edited_file, put, shipped
from tests.trials import gait_of, sim_trial, walk


def _plan(**changes: Any) -> TrialPlan:
    return TrialPlan(gait=gait_of(shipped()), **{"duration_s": 1.0, **changes})


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"duration_s": 0}, "duration"),
        ({"duration_s": 86401.0}, "duration"),
        ({"settle_s": 0}, "settle_s"),
        ({"self_rotation": "left"}, "self_rotation"),
        ({"heading_rad": math.nan}, "heading"),
        ({"travel": 2.0}, "travel"),
        ({"failures": (Failure(leg=2), Failure(leg=2))}, "plan.failures"),
    ],
)
def test_a_plan_refuses_what_cannot_be_done(change: dict[str, Any], named: str) -> None:
    with pytest.raises(InputError, match=named):
        _plan(**change)


def test_a_plan_may_be_told_of_several_failed_legs_and_of_a_body_that_has_turned() -> None:
    limp, locked = Failure(leg=6, kind="limp"), Failure(leg=2)
    plan = _plan(failures=(limp, locked), heading_rad=0.5, turn_rate_rad_s=0.1)
    assert plan.failures == (locked, limp)
    assert (plan.failed_legs, plan.held_legs) == ((2, 6), (2,)), "the limp one is not"
    assert pickle.loads(pickle.dumps(plan)) == plan  # noqa: S301  our own bytes
    unknown = replace(plan, failures=(locked, Failure(leg=6, kind="unknown")))
    assert unknown.held_legs == (2, 6)
    motion = plan.motion(yaw_rad=1.2)
    assert motion.heading_rad == pytest.approx(0.5 - 1.2)
    assert (motion.travel, motion.turn_rate_rad_s) == (1.0, 0.1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("robot", "gait", "least_share", "most_off_m"),
    [("ant", "demo", 0.75, 0.15), ("phantomx", "tripod", 0.6, 0.1)],
)
def test_robots_walk_straight_at_their_own_pace(
    robot: str, gait: str, least_share: float, most_off_m: float
) -> None:
    result = walk(gait, robot=shipped(robot), duration_s=8).result
    assert result.status == "ok"
    assert result.distance_m is not None
    assert result.deviation is not None
    assert least_share <= result.distance_m / result.ideal_distance_m <= 1
    assert result.deviation.final <= most_off_m
    assert result.duration_s == pytest.approx(8)


@pytest.mark.slow
@pytest.mark.parametrize(("leg", "heading_deg"), [(4, 60), (5, 100)])
def test_after_the_self_rotation_it_walks_along_the_heading_that_it_was_given(
    leg: int, heading_deg: float
) -> None:
    outcome = walk(failure=Failure(leg=leg), heading_rad=math.radians(heading_deg), duration_s=4)
    frame, result = outcome.log.frame, outcome.result
    assert frame is not None
    assert math.degrees(frame.heading_rad) == pytest.approx(heading_deg, abs=1), "as it stood at first"
    assert result.status == "ok"
    assert result.deviation is not None
    assert result.deviation.final < 0.15
    walked = outcome.log["base_position_world"][outcome.log.rows_of("walk")]
    way = walked[-1] - walked[0]
    assert math.degrees(math.atan2(way[1], way[0])) == pytest.approx(heading_deg, abs=15)


@pytest.mark.parametrize("heading_deg", [60, 137, 270])
def test_it_walks_along_the_heading_that_it_is_given(heading_deg: float) -> None:
    outcome = walk("tripod", heading_rad=math.radians(heading_deg), duration_s=6)
    walked = outcome.log["base_position_world"][outcome.log.rows_of("walk")]
    way = walked[-1] - walked[0]
    off = math.degrees(math.atan2(way[1], way[0])) - heading_deg
    assert math.remainder(off, 360) == pytest.approx(0, abs=5)
    result = outcome.result
    assert result.status == "ok"
    assert result.deviation is not None
    assert result.distance_m == pytest.approx(math.hypot(way[0], way[1]), rel=0.01), "the frame lies along it"
    assert abs(result.deviation.signed) < math.tan(math.radians(5)) * float(result.distance_m or 0)


def test_a_robot_whose_mounts_differ_in_height_stands_level_and_walks(tmp_path: Path) -> None:
    raised = []
    for number, z in enumerate((0.0, 0.015, -0.01, 0.02, 0.0, -0.015)):
        yaw = math.radians(60 * number)
        position_m = [0.08 * math.cos(yaw), 0.08 * math.sin(yaw), z]
        raised.append({"position_m": position_m, "yaw_deg": 60 * number})
    robot = load_robot(edited_file(tmp_path, put("mounts", raised), put("name", "uneven")))
    outcome = walk("tripod", robot=robot, duration_s=5)
    stood = outcome.log.rows_of("walk").start - 1
    _, x, y, _ = outcome.log["base_quaternion_world"][stood]
    assert math.degrees(2 * math.hypot(x, y)) < 1
    assert outcome.log["foot_contacts"][stood].all()
    assert outcome.result.status == "ok"
    assert outcome.result.distance_m is not None
    assert outcome.result.deviation is not None
    assert outcome.result.distance_m > 0.65 * outcome.result.ideal_distance_m
    assert outcome.result.deviation.final < 0.1


def test_what_recorders_take_after_the_last_command_is_no_silence() -> None:
    expected: list[bool] = []

    class SlowDisk:
        block_ticks = 1_000_000

        def write_block(self, log: TickLog, start: int, stop: int) -> None:
            expected.append(guard.expects_commands)

    with Guard(PosedMock()) as guard:
        run_trial(guard, _plan(duration_s=0.1), recorders=[SlowDisk()])
    assert expected == [False]


# What the result counts and says


class _Rounding(PosedMock):
    """Servos that take whole hundredths of a radian."""

    def write(self, targets: JointTargets) -> JointTargets:
        return super().write(JointTargets(np.round(targets.joint_positions_rad, 2), targets.stamp_s))


def test_what_the_servos_round_is_recorded_and_is_no_clipping() -> None:
    servos, log = _Rounding(), TickLog()
    slow = replace(gait_of(shipped()), pace_hz=0.2, amplitude=0.05)
    with Guard(servos) as guard:
        result = run_trial(guard, TrialPlan(gait=slow, duration_s=2), recorders=(log,))
    assert result.clipped_ticks == guard.counters.clipped == 0
    assert (log["commanded_rad"] != log["requested_rad"]).any()
    np.testing.assert_array_equal(log["commanded_rad"], np.round(log["requested_rad"], 2))


def test_ticks_are_counted_as_clipped_in_the_walk_only() -> None:
    servos, log = PosedMock(), TickLog()
    servos.connect()
    servos.write(JointTargets(shipped().stance_angles_rad - 0.8, 0.0))
    guard = Guard(servos)
    result = run_trial(guard, _plan(settle_s=0.2), recorders=(log,))
    changed = (log["commanded_rad"] != log["requested_rad"]).any(axis=-1)
    assert changed[log.rows_of("settle")].any()
    assert guard.counters.clipped == changed.sum()
    assert result.clipped_ticks == changed[log.rows_of("walk")].sum()


def test_three_trials_in_a_row_on_one_guard_are_each_their_own() -> None:
    servos = PosedMock()
    with Guard(servos) as guard:
        for _ in range(3):
            log = TickLog()
            result = run_trial(guard, _plan(), recorders=(log,))
            assert (result.status, result.stopped) == ("ok", None)
            assert result.duration_s == pytest.approx(1)
            assert log.walked_ticks == 50
            servos.time.work(3600.0)
    assert guard.clock.overruns == 0


def test_results_compare_by_value_and_travel_as_json() -> None:
    one = scored(along(1.2, np.array([0.0, 0.1])))
    assert one == scored(along(1.2, np.array([0.0, 0.1])))
    assert one != replace(one, path_m=one.path_m + 1e-12)
    assert one != replace(one, status="fell")
    partly = replace(one, deviation=Deviation(0.1, float("nan"), float("nan"), 0.1), yaw_change_rad=None)
    unknown = replace(one, deviation=None, distance_m=None, path_m=np.zeros((0, 2)))
    for result in (one, partly, unknown):
        data = json.loads(json.dumps(result.to_dict(path=True), allow_nan=False))
        assert TrialResult.from_dict(data).deviation == result.deviation
        assert TrialResult.from_dict(data).to_dict(path=True) == data
    assert set(one.to_dict()["deviation_m"]) == {"final", "mean", "max", "signed"}
    assert TrialResult.from_dict(one.to_dict()).path_m.shape == (0, 2)
    paths = [
        {**one.to_dict(), "path_m": rows} for rows in ([[1, 2, 3, 4]], [1, 2], [[[1, 2]]], [[1, 2], [3]])
    ]
    for data in ({}, {"status": "ok"}, 3, None, *paths):
        with pytest.raises(InputError, match="trial result"):
            TrialResult.from_dict(data)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("yaw_deg", "least_s", "most_s"), [(0.0, 0.0, 0.0), (0.15, 0.0, 0.0), (0.5, 0.8, 1.5), (5.0, 1.5, 1.5)]
)
def test_a_noisy_yaw_is_measured_for_longer_at_rest(yaw_deg: float, least_s: float, most_s: float) -> None:
    """25 samples of 0.25 degrees have a mean within 0.05 degrees; the rest ends after 2 s at the latest."""
    plan, log = _plan(duration_s=0.02, hold="line"), TickLog()
    world = World(sensor_noise=SensorNoise(yaw_deg=yaw_deg))
    with SimServos(shipped(), world=world, facing_rad=1.0) as servos:
        result = run_trial(Guard(servos), plan, recorders=(log,), soft_stop=False)
    settled = log.rows_of("settle")
    assert least_s - 0.01 < 0.02 * (settled.stop - settled.start) - 1.0 < most_s + 0.01
    assert log.frame is not None
    assert math.degrees(log.frame.heading_rad) == pytest.approx(math.degrees(1.0), abs=0.04 + 0.3 * yaw_deg)
    assert result.true_deviation is not None
    assert result.true_deviation.max < 1e-3


# A trial in a batch is the same trial alone, to the last bit


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


def trial(gait: str, *, duration_s: float = 1.5, **given: Any) -> SimTrial:
    return sim_trial(gait, duration_s=duration_s, **given)


def assert_as_alone(trials: list[SimTrial], results: list[TrialResult] | None = None) -> list[TrialResult]:
    together = run_sim_trials(trials) if results is None else results
    for one, alone in zip(together, map(run_sim_trial, trials), strict=True):
        assert one.to_dict() == alone.to_dict()
        assert np.array_equal(one.path_m, alone.path_m, equal_nan=True)
    return together


@pytest.mark.slow
def test_a_batch_on_any_number_of_threads_equals_its_single_trials() -> None:
    trials = [trial(code, seed=5, failure=Failure(leg=3)) for code in ("1", "120")]
    elsewhere = pickle.loads(pickle.dumps(trials))  # noqa: S301  trials travel between processes
    for threads in (1, 2):
        assert_as_alone(trials, run_sim_trials(elsewhere, threads=threads))


def test_a_batch_that_is_steered_by_faulty_sensors_equals_its_single_trials() -> None:
    world = World(sensor_faults=FAULTY)
    trials = [trial(code, world=world, hold="auto", duration_s=2.0) for code in ("1", "700")]
    assert [result.hold for result in assert_as_alone(trials)] == ["line", "line"]


@pytest.mark.slow
@pytest.mark.parametrize("hold", ["none", "line"])
def test_trials_of_many_worlds_and_failures_are_stepped_together_and_each_is_as_alone(
    hold: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    together: list[int] = []

    class Counted(SimBatch):
        def __init__(self, servos: Any, n: Any, threads: int = 0) -> None:
            together.append(len(servos))
            super().__init__(servos, n, threads)

    monkeypatch.setattr("hexctl.control.batch.SimBatch", Counted)
    kinds = ("locked", "limp", "missing", "weak", "stuck")
    trials = [
        trial(code, world=world, seed=7, failure=Failure(leg=leg, kind=kind), hold=hold, **start)
        for (world, kind), leg in zip(zip(DIFFERENT, kinds, strict=True), (1, 3, 4, 2, 6), strict=True)
        for code, start in (("1", {"self_rotation": "none"}), ("40", {"heading_rad": 0.3, "duration_s": 2.2}))
    ]
    made = run_sim_trials(trials)
    assert sorted(together) == [2, 2, 6], "bumps and a payload make models of other sizes"
    assert {one.hold for one in assert_as_alone(trials, made)} == {hold}
    assert None not in (made[-1].energy_j, made[-1].tilt_deg, made[-1].steadiness)


@pytest.mark.slow
def test_different_lengths_motions_and_paces_in_one_batch_in_the_order_of_the_trials() -> None:
    trials = [
        trial("demo", duration_s=1.0),
        trial("tripod", duration_s=1.7, heading_rad=2.0),
        trial("wave", duration_s=0.5, turn_rate_rad_s=0.1, travel=0.5),
        trial("demo", duration_s=1.2),
    ]
    assert_as_alone(trials)


def test_robots_that_are_equal_share_one_start_whichever_object_holds_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    trials = [trial(code, robot=load_robot("ant"), failure=Failure(leg=5), duration_s=0.5) for code in "123"]
    assert len({made.shared_start() for made in trials}) == 1
    assert len({made.shared_start() for made in pickle.loads(pickle.dumps(trials))}) == 1  # noqa: S301
    others = [trial("1", robot=shipped("pexod"), failure=Failure(leg=5)), trial("1")]
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
def test_trials_that_turn_by_different_angles_do_not_share_a_start() -> None:
    turned = assert_as_alone([trial("tripod", turn_rad=turn_rad) for turn_rad in (0.6, 0.0)])
    assert [result.turned_rad for result in turned] == pytest.approx([0.6, 0.0], abs=0.1)


@pytest.mark.parametrize("place", [0, 2])
def test_a_plan_that_the_legs_cannot_make_is_refused_before_any_robot_is_built(
    place: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Forward the gait is possible; sideways, where the self-rotation leads, it is not."""
    phantomx = in_stance_of(load_robot("phantomx"), 0.15)
    bad = trial("1", robot=phantomx, failure=Failure(leg=2))
    bad = replace(bad, plan=replace(bad.plan, gait=replace(bad.plan.gait, amplitude=0.13)))
    check_walk(phantomx, bad.plan.gait, bad.plan.motion(0.0))
    trials = [trial("1", robot=phantomx, failure=Failure(leg=leg)) for leg in (2, 3)]
    trials.insert(place, bad)
    monkeypatch.setattr(SimServos, "connect", lambda _: pytest.fail("a robot was built"))
    with pytest.raises((ReachError, LimitError)):
        run_sim_trials(trials)


@pytest.mark.slow
def test_a_fall_in_a_batch_ends_that_trial_as_it_does_alone() -> None:
    """A top-heavy robot falls with one gait in its own time; with the others it walks on."""
    world = World(payload_kg=6.0, payload_position_m=(0.0, 0.0, 0.5))
    trials = [trial(gait, world=world, duration_s=6.0) for gait in ("tripod", "wave", "demo")]
    results = assert_as_alone(trials)
    assert [result.status for result in results] == ["ok", "fell", "ok"]
    assert 0 < results[1].duration_s < 6


def test_a_robot_that_falls_before_its_walk() -> None:
    world = World(payload_kg=6.0, payload_position_m=(0.5, 0.0, 0.3))
    (made,) = assert_as_alone([trial("demo", world=world)])
    assert (made.status, made.deviation) == ("fell", None)


def test_one_that_diverges_ends_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    trials = [trial(code, duration_s=1.0) for code in ("1", "120")]
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


@pytest.mark.slow
def test_a_walk_put_down_in_six_headings_ends_within_a_centimetre_of_itself() -> None:
    """But for a floor with a grain, which a pyramidal friction cone has."""
    plan = TrialPlan(
        gait=make_gait(shipped(), "77", failed_legs=(5,)),
        failures=(Failure(leg=5),),
        self_rotation="none",
        duration_s=8.0,
    )
    for cone, evenly in (("elliptic", True), ("pyramidal", False)):
        trials = [
            SimTrial(
                robot=shipped(),
                plan=plan,
                failures=Failure(leg=5),
                world=World.model_validate({"friction_cone": cone}),
                facing_rad=math.radians(60 * k + 10),
            )
            for k in range(6)
        ]
        ends_m = [result.deviation.signed for result in run_sim_trials(trials) if result.deviation]
        assert len(ends_m) == 6
        assert (np.ptp(ends_m) < 0.01) == evenly
