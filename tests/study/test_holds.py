"""The comparison of holds on made-up walks: open loop ends far off, the yaw nearer, the pose near."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexctl.backends.sim.world import World, load_randomization
from hexctl.control.batch import run_sim_trial
from hexctl.control.planning.static_stability import STAND_UP, most_stable_slots
from hexctl.errors import InputError
from hexctl.robot.failure import Failure
from hexctl.study.held_out import INTACT, with_sensors
from hexctl.study.held_out_experiment import frame_of
from hexctl.study.hold_plan import FIRST_WORLD, HoldPlan, statistics
from hexctl.study.hold_walks import HoldCase, HoldPlace, HoldWalk
from hexctl.study.paper.evidence import clustered_error
from tests.robots import shipped

IDEAL_M = 4.0

SCALES_M = {"none": 0.5, "heading": 0.04, "line": 0.003}


def plan(**options: Any) -> HoldPlan:
    given: dict[str, Any] = {
        "robots": (shipped(),),
        "families": {"transfer": load_randomization("transfer"), "real": load_randomization("real")},
        "worlds": 3,
        "legs": (2, 5),
        "failures": ("locked", "limp"),
    }
    return HoldPlan(**given | options)


def walk(case: HoldCase, final_m: float) -> HoldWalk:
    return HoldWalk(
        case=case,
        held=case.hold,
        status="ok",
        why=None,
        duration_s=30.0,
        signed_m=final_m,
        max_m=2 * abs(final_m),
        distance_m=(0.8 if case.hold == "none" else 0.9) * IDEAL_M,
        ideal_distance_m=IDEAL_M,
    )


def made_up_walks(made: HoldPlan) -> list[list[HoldWalk]]:
    """Walks that end at random, and farther in some worlds than in others."""
    random = np.random.default_rng(0)
    walks = []
    for _, cases in made.walked():
        farther = random.uniform(0.5, 1.5)
        walks.append([walk(case, SCALES_M[case.hold] * farther * random.uniform(-1, 1)) for case in cases])
    return walks


@cache
def rows() -> Any:
    """Rows of the made-up walks of the plan, as it compares them."""
    made = plan()
    return made.columns(frame_of(made.walked(), made_up_walks(made)))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"robots": (shipped(), shipped())}, "robot"),
        ({"families": {}}, "world"),
        ({"legs": (7,)}, "legs"),
        ({"failures": ("tired",)}, "failure"),
    ],
)
def test_what_cannot_be_is_refused_before_anything_runs(options: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        plan(**options).check()


def test_statistics_are_those_of_the_walks() -> None:
    made = rows()
    found = statistics(made[(made["hold"] == "line") & (made["failure"] != INTACT)])
    walks = [
        (f"{place.family}{place.number}", one)
        for (place, _), some in zip(plan().walked(), made_up_walks(plan()), strict=True)
        for one in some
        if one.case.hold == "line" and one.case.leg
    ]
    worlds, final_m = np.array([world for world, _ in walks]), np.abs([one.signed_m for _, one in walks])
    assert (found["walks"], found["worlds"]) == (6 * 2 * 2, 6)
    assert found["mean_m"] == pytest.approx(final_m.mean())
    assert found["mean_error_m"] == pytest.approx(float(clustered_error(final_m, worlds)))
    assert found["p90_m"] == pytest.approx(np.percentile(final_m, 90))
    assert found["max_m"] == final_m.max()
    assert found["way_p90_m"] == pytest.approx(2 * found["p90_m"])
    assert (found["no_progress"], found["fell"], found["others"]) == (0, 0, 0)
    assert found["over_ideal"] == pytest.approx(0.9)


@pytest.mark.slow
def test_the_report_is_one_page_with_all_walks_beside_it(tmp_path: Path) -> None:
    import pyarrow.parquet as pq

    made = rows()
    assert plan().write(made, tmp_path) == tmp_path / "holds.html"
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {"holds.html", "holds.parquet"}
    text = (tmp_path / "holds.html").read_text(encoding="utf-8")
    for words in ("worlds 250 to 252 of transfer and real", "open loop", "yaw alone", "1 cm and 0.5 degrees",
                  "By kind of world", "24 in 6 worlds"):  # fmt: skip
        assert words in text, words
    table = pq.read_table(tmp_path / "holds.parquet")
    assert table.num_rows == len(made)
    row, last = table.to_pylist()[-1], made.iloc[-1]
    assert (row["robot"], row["family"], row["world"], row["kind"]) == (
        "ant", "real", 252, last["kind_of_world"])  # fmt: skip
    assert (row["leg"], row["failure"], row["hold"]) == (5, "limp", "line")
    assert (row["final_m"], row["status"]) == (last["final_m"], "ok")


PLACE = HoldPlace(
    robot=shipped(), family="transfer", number=211, kind="rough", world=World(roughness_m=0.003)
)


def test_a_walk_has_the_gait_that_stands_safest_and_the_seed_of_its_world() -> None:
    trial = PLACE.trial(HoldCase(leg=2, failure="limp", hold="line"))
    failure = Failure(leg=2, kind="limp")
    assert trial.plan.gait.slots == most_stable_slots(shipped(), heading_rad=0.0, failure=failure)
    assert (trial.failures, trial.plan.failures) == ((failure,), (failure,))
    assert (trial.plan.hold, trial.seed) == ("line", 211)
    intact = PLACE.trial(HoldCase(leg=0, failure="intact", hold="none"))
    assert (intact.failures, intact.plan.failures, intact.plan.hold) == ((), (), "none")
    assert PLACE.columns()["rough"]
    locked = PLACE.trial(HoldCase(leg=2, failure="locked", hold="none"))
    assert (trial.plan.gait.posture.body_raise, locked.plan.gait.posture.body_raise) == (0.0, STAND_UP)


@pytest.mark.slow
def test_a_walk_is_the_trial_of_its_case() -> None:
    cases = [HoldCase(leg=2, failure="limp", hold="line"), HoldCase(leg=0, failure="intact", hold="line")]
    place = replace(PLACE, duration_s=1.0)
    for case, walked in zip(cases, place.walk(cases), strict=True):
        alone = run_sim_trial(place.trial(case))
        assert alone.true_deviation is not None
        assert walked.case == case
        assert (walked.held, walked.signed_m, walked.distance_m) == (
            "line", alone.true_deviation.signed, alone.distance_m)  # fmt: skip


def test_sensors_are_late_noisy_and_lossy_and_the_rest_of_the_world_is_kept() -> None:
    for family in ("transfer", "real"):
        for world in load_randomization(family).members(210, 10):
            sensed = with_sensors(world)
            assert sensed.latency_steps * sensed.time_step_s == 0.04
            assert (sensed.sensor_noise.position_m, sensed.sensor_noise.yaw_deg) == (0.01, 0.5)
            assert sensed.lost_poses == 0.05
            left = {"state_latency_s", "sensor_noise", "lost_poses"}
            assert sensed.model_dump(exclude=left) == world.model_dump(exclude=left)


@pytest.mark.slow
def test_every_robot_walks_every_case_in_every_world() -> None:
    made = plan(robots=(shipped(), shipped("pexod")), worlds=2)
    places = [place for place, _ in made.walked()]
    assert [(one.robot.name, one.family, one.number) for one in places] == [
        (robot, family, number)
        for robot in ("ant", "pexod")
        for family in ("transfer", "real")
        for number in (FIRST_WORLD, FIRST_WORLD + 1)
    ]
    cases = made.cases()
    assert [case.hold for case in cases[:3]] == ["none", "heading", "line"]
    assert (len(cases), len(set(cases))) == (3 * (1 + 2 * 2), 3 * (1 + 2 * 2))
    assert {case.failure for case in cases if case.leg == 0} == {"intact"}
    made.check()
