"""Where a walk starts and which way it goes: in any heading, and with sensors that err."""

import math

import numpy as np
import pytest

from hexctl import Failure, Guard, SimServos, SimTrial, TrialPlan, World, make_gait, run_sim_trials, run_trial
from hexctl.backends.sim.flaws import SensorNoise
from hexctl.control.log import TickLog
from hexctl.control.trace import TrialFrame
from hexctl.robot.rotations import yaw_rad
from tests.robots import shipped
from tests.trials import gait_of

pytestmark = pytest.mark.slow


YAW_NOISE_DEG = 2.0


POSITION_NOISE_M = 0.01


NOISY = World(sensor_noise=SensorNoise(yaw_deg=YAW_NOISE_DEG, position_m=POSITION_NOISE_M))


def _start(seed: int, failure: Failure | None = None) -> tuple[TrialFrame, float]:
    """The frame of a trial among the noise, and the true yaw of the body as its walk begins."""
    plan = TrialPlan(gait=gait_of(shipped()), belief=failure, duration_s=0.02)
    with SimServos(shipped(), world=NOISY, failure=failure, seed=seed) as servos:
        log = TickLog()
        run_trial(Guard(servos), plan, recorders=(log,), soft_stop=False)
        true_yaw_rad = float(yaw_rad(servos.compiled.physics.data.qpos[3:7].copy()))
    assert log.frame is not None
    return log.frame, true_yaw_rad


def test_the_line_of_travel_errs_far_less_than_a_single_measurement() -> None:
    frames = [_start(seed)[0] for seed in range(14)]
    assert np.degrees([frame.heading_rad for frame in frames]).std() < 0.4 * YAW_NOISE_DEG
    assert np.degrees([frame.yaw_rad for frame in frames]).std() < 0.4 * YAW_NOISE_DEG
    origins = np.array([frame.origin_world for frame in frames])
    assert (origins.std(axis=0) < 0.4 * POSITION_NOISE_M).all()


@pytest.mark.parametrize("leg", [2, 3])
def test_after_a_self_rotation_the_start_errs_as_little(leg: int) -> None:
    starts = [_start(seed, Failure(leg=leg)) for seed in range(5)]
    errors_deg = [math.degrees(math.remainder(frame.yaw_rad - true, math.tau)) for frame, true in starts]
    assert np.std(errors_deg) < 0.4 * YAW_NOISE_DEG
    for _, true_yaw_rad in starts:
        leg_points_to = true_yaw_rad + float(shipped().leg_azimuths_rad[leg - 1])
        assert abs(math.degrees(math.remainder(leg_points_to - math.pi, math.tau))) < 12


def test_a_walk_put_down_in_six_headings_ends_within_a_centimetre_of_itself() -> None:
    """But for a floor with a grain, which a pyramidal friction cone has."""
    plan = TrialPlan(
        gait=make_gait(shipped(), "77", failed_legs=(5,)),
        belief=Failure(leg=5),
        self_rotation="none",
        duration_s=8.0,
    )
    for cone, evenly in (("elliptic", True), ("pyramidal", False)):
        trials = [
            SimTrial(
                robot=shipped(),
                plan=plan,
                failure=Failure(leg=5),
                world=World.model_validate({"friction_cone": cone}),
                facing_rad=math.radians(60 * k + 10),
            )
            for k in range(6)
        ]
        ends_m = [result.deviation.signed for result in run_sim_trials(trials) if result.deviation]
        assert len(ends_m) == 6
        assert (np.ptp(ends_m) < 0.01) == evenly
