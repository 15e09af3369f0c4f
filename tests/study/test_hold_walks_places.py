"""Places of the compared walks."""

from dataclasses import replace

from hexctl.backends.sim.world import World, load_randomization
from hexctl.control.assessment.static_stability import STAND_UP, most_stable_slots
from hexctl.control.batch import run_sim_trial
from hexctl.robot.failure import Failure
from hexctl.study.held_out import with_sensors
from hexctl.study.hold_walks import HoldCase, HoldPlace
from tests.robots import shipped
from tests.study.made_up_holds import walk

PLACE = HoldPlace(
    robot=shipped(), family="transfer", number=211, kind="rough", world=World(roughness_m=0.003)
)


def test_a_walk_has_the_gait_that_stands_safest_and_the_seed_of_its_world() -> None:
    trial = PLACE.trial(HoldCase(leg=2, failure="limp", hold="line"))
    failure = Failure(leg=2, kind="limp")
    assert trial.plan.gait.slots == most_stable_slots(shipped(), heading_rad=0.0, failure=failure)
    assert (trial.failure, trial.plan.belief, trial.plan.hold, trial.seed) == (failure, failure, "line", 211)
    intact = PLACE.trial(HoldCase(leg=0, failure="intact", hold="none"))
    assert (intact.failure, intact.plan.belief, intact.plan.hold) == (None, None, "none")
    assert PLACE.columns()["rough"]
    locked = PLACE.trial(HoldCase(leg=2, failure="locked", hold="none"))
    assert (trial.plan.gait.posture.body_raise, locked.plan.gait.posture.body_raise) == (0.0, STAND_UP)


def test_a_turned_robot_walks_the_gait_for_its_new_direction() -> None:
    case = HoldCase(leg=2, failure="missing", hold="line")
    trial = replace(PLACE, self_rotation="rear").trial(case)
    assert trial.plan.self_rotation == "rear"
    assert trial.plan.gait.slots != PLACE.trial(case).plan.gait.slots


def test_whatever_decides_a_walk_is_in_the_fingerprint() -> None:
    changes = [
        {"robot": shipped("pexod")},
        {"number": 212},
        {"world": World()},
        {"self_rotation": "rear"},
        {"duration_s": 20.0},
    ]
    prints = {replace(PLACE, **change).fingerprint for change in changes}  # type: ignore[arg-type]
    assert len(prints | {PLACE.fingerprint}) == len(changes) + 1
    assert replace(PLACE, family="other", kind="plain").fingerprint == PLACE.fingerprint


def test_a_walk_is_the_trial_of_its_case() -> None:
    cases = [HoldCase(leg=2, failure="limp", hold="line"), HoldCase(leg=0, failure="intact", hold="line")]
    place = replace(PLACE, duration_s=1.0)
    for case, walked in zip(cases, place.walk(cases), strict=True):
        alone = run_sim_trial(place.trial(case))
        assert alone.true_deviation is not None
        assert walked.case == case
        assert (walked.held, walked.signed_m, walked.distance_m) == (
            "line", alone.true_deviation.signed, alone.distance_m)  # fmt: skip


def test_a_walk_that_ended_on_its_feet_has_an_end() -> None:
    fell = walk(HoldCase(leg=2, failure="limp", hold="line"), 0.1, status="fell")
    assert fell.possible
    assert not replace(fell, status="ok").possible


def test_sensors_are_late_noisy_and_lossy_and_the_rest_of_the_world_is_kept() -> None:
    for family in ("transfer", "real"):
        for world in load_randomization(family).members(210, 10):
            sensed = with_sensors(world)
            assert sensed.latency_steps * sensed.time_step_s == 0.04
            assert (sensed.sensor_noise.position_m, sensed.sensor_noise.yaw_deg) == (0.01, 0.5)
            assert sensed.lost_poses == 0.05
            left = {"state_latency_s", "sensor_noise", "lost_poses"}
            assert sensed.model_dump(exclude=left) == world.model_dump(exclude=left)
