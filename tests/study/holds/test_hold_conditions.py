"""Conditions of the compared walks."""

from dataclasses import replace

from hexctl.backends.sim.world import World, load_randomization
from hexctl.control.assessment.static_stability import STAND_UP, most_stable_slots
from hexctl.robot.failure import Failure
from hexctl.study.holds.hold_conditions import HoldCase, HoldConditions, with_sensors
from tests.robots import shipped

CONDITIONS = HoldConditions(
    robot=shipped(), family="transfer", number=211, kind="rough", world=World(roughness_m=0.003)
)


def test_a_walk_has_the_gait_that_stands_safest_and_the_seed_of_its_world() -> None:
    trial = CONDITIONS.trial(HoldCase(leg=2, failure="limp", hold="line"))
    failure = Failure(leg=2, kind="limp")
    assert trial.plan.gait.slots == most_stable_slots(shipped(), heading_rad=0.0, failure=failure)
    assert (trial.failure, trial.plan.belief, trial.plan.hold, trial.seed) == (failure, failure, "line", 211)
    intact = CONDITIONS.trial(HoldCase(leg=0, failure="intact", hold="none"))
    assert (intact.failure, intact.plan.belief, intact.plan.hold) == (None, None, "none")
    assert CONDITIONS.rough
    locked = CONDITIONS.trial(HoldCase(leg=2, failure="locked", hold="none"))
    assert (trial.plan.gait.posture.body_raise, locked.plan.gait.posture.body_raise) == (0.0, STAND_UP)


def test_a_turned_robot_walks_the_gait_for_its_new_direction() -> None:
    case = HoldCase(leg=2, failure="missing", hold="line")
    trial = replace(CONDITIONS, self_rotation="rear").trial(case)
    assert trial.plan.self_rotation == "rear"
    assert trial.plan.gait.slots != CONDITIONS.trial(case).plan.gait.slots


def test_whatever_decides_a_walk_is_in_the_fingerprint() -> None:
    changes = [
        {"robot": shipped("pexod")},
        {"number": 212},
        {"world": World()},
        {"self_rotation": "rear"},
        {"duration_s": 20.0},
    ]
    prints = {replace(CONDITIONS, **change).fingerprint for change in changes}  # type: ignore[arg-type]
    assert len(prints | {CONDITIONS.fingerprint}) == len(changes) + 1
    assert replace(CONDITIONS, family="other", kind="plain").fingerprint == CONDITIONS.fingerprint


def test_sensors_are_late_noisy_and_lossy_and_the_rest_of_the_world_is_kept() -> None:
    for family in ("transfer", "real"):
        for world in load_randomization(family).members(210, 10):
            sensed = with_sensors(world)
            assert sensed.latency_steps * sensed.time_step_s == 0.04
            assert (sensed.sensor_noise.position_m, sensed.sensor_noise.yaw_deg) == (0.01, 0.5)
            assert sensed.lost_poses == 0.05
            left = {"state_latency_s", "sensor_noise", "lost_poses"}
            assert sensed.model_dump(exclude=left) == world.model_dump(exclude=left)
