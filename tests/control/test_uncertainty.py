"""The simulation's own uncertainty: what it is made of, and that it sees what it should."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexctl.backends.sim.world import World
from hexctl.control.batch import SimTrial, run_sim_trial
from hexctl.control.plan import TrialPlan
from hexctl.control.uncertainty import (
    UNCERTAINTIES,
    SimulationUncertainty,
    keep_uncertainty,
    known_uncertainty,
    simulation_uncertainty,
    uncertainty_of_walks,
)
from hexctl.errors import InputError
from hexctl.gait.gait import make_gait
from hexctl.robot.configs import config_names
from hexctl.robot.failure import Failure
from tests.robots import shipped


def walk(**world: float) -> SimTrial:
    plan = TrialPlan(
        gait=make_gait(shipped(), "17", failed_legs=(5,)),
        belief=Failure(leg=5),
        self_rotation="none",
        duration_s=4.0,
    )
    return SimTrial(robot=shipped(), plan=plan, failure=Failure(leg=5), world=World.model_validate(world))


def end_m(trial: SimTrial) -> float:
    deviation = run_sim_trial(trial).deviation
    assert deviation is not None
    return deviation.signed


def test_it_is_how_far_each_walk_ends_elsewhere() -> None:
    found = uncertainty_of_walks([walk(), replace(walk(), facing_rad=0.5)])
    finer_m = end_m(walk(time_step_s=0.001)) - end_m(walk())
    assert found.step_m == pytest.approx(abs(finer_m), rel=0.05)
    softer_m, harder_m = (end_m(walk(contact_time_s=0.02 * k)) - end_m(walk()) for k in (4 / 3, 3 / 4))
    assert found.contact_m == pytest.approx(math.sqrt((softer_m**2 + harder_m**2) / 2), rel=0.05)
    assert found.numerical_m == pytest.approx(np.hypot(found.step_m, found.solver_m))
    assert 0 < found.solver_m < found.contact_m
    assert (found.walks, found.duration_s) == (2, 4.0)


def test_a_coarse_step_is_more_uncertain_than_a_fine_one() -> None:
    coarse, fine = (uncertainty_of_walks([walk(time_step_s=step_s)]) for step_s in (0.005, 0.001))
    assert coarse.step_m > fine.step_m


def test_walks_without_an_end_are_left_out() -> None:
    fallen = replace(walk(), world=World(payload_kg=6.0, payload_position_m=(0.5, 0.0, 0.3)))
    assert uncertainty_of_walks([walk(), fallen]).walks == 1
    with pytest.raises(InputError, match="walks: got none"):
        uncertainty_of_walks([fallen])


def test_a_step_that_cannot_be_halved_is_refused() -> None:
    with pytest.raises(InputError, match=r"time_step_s: got 0.0005; allowed: 0.001 or more"):
        uncertainty_of_walks([walk(time_step_s=0.0005)])


def test_a_robot_is_measured_over_gaits_and_legs() -> None:
    found = simulation_uncertainty("ant", duration_s=1.0)
    assert isinstance(found, SimulationUncertainty)
    assert found.walks == 20
    assert found.to_dict()["numerical_m"] == round(found.numerical_m, 4)


def test_walks_of_several_durations_are_refused() -> None:
    longer = replace(walk(), plan=replace(walk().plan, duration_s=5.0))
    with pytest.raises(
        InputError, match="duration_s of the walks: got 4, 5 s; allowed: walks of one duration"
    ):
        uncertainty_of_walks([walk(), longer])
    with pytest.raises(InputError, match="got none"):
        uncertainty_of_walks([])


def test_each_walk_is_compared_with_a_finer_one_in_its_own_world() -> None:
    alone = [uncertainty_of_walks([walk(time_step_s=step_s)]).step_m for step_s in (0.004, 0.002)]
    together = uncertainty_of_walks([walk(time_step_s=step_s) for step_s in (0.004, 0.002)])
    assert together.step_m == pytest.approx(math.hypot(*alone) / math.sqrt(2))


FOUND = SimulationUncertainty(step_m=0.03, solver_m=0.04, contact_m=0.1, walks=7, duration_s=12.0)


def test_a_kept_measurement_is_found_for_the_same_robot_step_cone_and_duration(tmp_path: Path) -> None:
    path = keep_uncertainty(shipped(), World(), FOUND, folder=tmp_path / "runs", how="by a test")
    assert path == tmp_path / "runs" / UNCERTAINTIES

    def known(robot: str = "ant", duration_s: float = 12.0, **world: Any) -> SimulationUncertainty | None:
        place = World.model_validate(world)
        return known_uncertainty(robot, place, duration_s=duration_s, folder=tmp_path / "runs")

    assert known() == known(friction=0.4) == FOUND
    assert known().numerical_m == pytest.approx(0.05)  # type: ignore[union-attr]
    others = (
        known("pexod"),
        known(duration_s=13.0),
        known(time_step_s=0.004),
        known(friction_cone="pyramidal"),
    )
    assert others == (None,) * 4
    assert known_uncertainty("ant", duration_s=12.0, folder=tmp_path) is None


def test_a_measurement_takes_the_place_of_an_earlier_one_and_of_the_shipped_one(tmp_path: Path) -> None:
    shipped_one = known_uncertainty("ant", folder=tmp_path)
    for walks, duration_s in ((7, 30.0), (8, 12.0), (9, 30.0)):
        keep_uncertainty(
            shipped(), World(), replace(FOUND, walks=walks, duration_s=duration_s), folder=tmp_path
        )
    found = [known_uncertainty("ant", duration_s=duration_s, folder=tmp_path) for duration_s in (30.0, 12.0)]
    assert [one.walks for one in found if one is not None] == [9, 8]
    assert shipped_one is not None
    assert shipped_one.walks not in (7, 9)


@pytest.mark.parametrize("name", config_names("robots"))
def test_the_shipped_robots_have_one(name: str, tmp_path: Path) -> None:
    """Of each robot file as it is now: another description of the robot needs another measurement."""
    found = known_uncertainty(name, folder=tmp_path)
    assert found is not None
    assert found.walks >= 80
    assert 0 < found.numerical_m < 0.05


@pytest.mark.parametrize("text", ["measured: 3", "measured: [{robot: ant}]", "measured: [", "other: 1"])
def test_a_damaged_file_is_named(text: str, tmp_path: Path) -> None:
    (tmp_path / UNCERTAINTIES).write_text(text)
    with pytest.raises(InputError, match=UNCERTAINTIES):
        known_uncertainty("ant", folder=tmp_path)


def test_a_folder_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(
        InputError, match=r"uncertainty.yaml: cannot be written .*; allowed: a writable folder"
    ):
        keep_uncertainty(shipped(), World(), FOUND, folder=tmp_path / "file")
