"""The simulation's own uncertainty: what it is made of, and for which walks what was kept is found."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from hexctl import Failure, InputError, SimTrial, World
from hexctl.control.batch import run_sim_trial
from hexctl.control.scoring.uncertainty import simulation_uncertainty, uncertainty_of_walks
from hexctl.control.scoring.uncertainty_store import (
    UNCERTAINTIES,
    SimulationUncertainty,
    keep_uncertainty,
    known_uncertainty,
)
from tests.robots import ROBOT_NAMES, shipped
from tests.trials import sim_trial


def walk(duration_s: float = 4.0, **world: float) -> SimTrial:
    place = World.model_validate(world)
    return sim_trial("17", failure=Failure(leg=5), world=place, duration_s=duration_s, self_rotation="none")


def end_m(trial: SimTrial) -> float:
    deviation = run_sim_trial(trial).deviation
    assert deviation is not None
    return deviation.signed


@pytest.mark.long
def test_it_is_how_far_each_walk_ends_elsewhere() -> None:
    fallen = replace(walk(), world=World(payload_kg=6.0, payload_position_m=(0.5, 0.0, 0.3)))
    with pytest.raises(InputError):
        uncertainty_of_walks([fallen])
    found = uncertainty_of_walks([walk(), replace(walk(), facing_rad=0.5), fallen])
    finer_m = end_m(walk(time_step_s=0.001)) - end_m(walk())
    assert found.step_m == pytest.approx(abs(finer_m), rel=0.05)
    softer_m, harder_m = (end_m(walk(contact_time_s=0.02 * k)) - end_m(walk()) for k in (4 / 3, 3 / 4))
    assert found.contact_m == pytest.approx(math.sqrt((softer_m**2 + harder_m**2) / 2), rel=0.05)
    assert found.numerical_m == found.step_m, "the default solver tolerance is not used"
    assert 0 < found.solver_m < found.contact_m
    assert (found.walks, found.duration_s) == (2, 4.0), "without the one that fell"


@pytest.mark.slow
def test_a_confirmation_is_as_uncertain_as_half_its_step_changes() -> None:
    short = walk(duration_s=0.5)
    finest = replace(short, world=World().model_copy(update={"time_step_s": 0.00025}))
    moved_m = end_m(walk(duration_s=0.5, time_step_s=0.0005)) - end_m(finest)
    assert uncertainty_of_walks([short]).confirmed_m == pytest.approx(abs(moved_m))


def test_walks_that_cannot_be_compared_are_refused() -> None:
    for walks, named in (
        ([walk(time_step_s=0.0005)], "time_step_s"),
        ([walk(), walk(duration_s=5.0)], "duration_s"),
        ([], "walks"),
    ):
        with pytest.raises(InputError, match=named):
            uncertainty_of_walks(walks)


@pytest.mark.long
def test_a_robot_is_measured_over_gaits_and_legs() -> None:
    found = simulation_uncertainty("ant", duration_s=1.0)
    assert isinstance(found, SimulationUncertainty)
    assert found.walks == 20
    assert found.to_dict()["numerical_m"] == round(found.numerical_m, 4)


FOUND = SimulationUncertainty(step_m=0.03, solver_m=0.04, contact_m=0.1, walks=7, duration_s=12.0)


def keep(folder: Path, *, place: World | None = None, **changes: Any) -> Path:
    return keep_uncertainty(shipped(), place or World(), FOUND.model_copy(update=changes), folder=folder)


def known(folder: Path, robot: str = "ant", duration_s: float = 12.0, **world: Any) -> Any:
    return known_uncertainty(robot, World.model_validate(world), duration_s=duration_s, folder=folder)


def test_a_kept_measurement_is_found_for_the_same_robot_world_and_duration(tmp_path: Path) -> None:
    assert keep(tmp_path / "runs") == tmp_path / "runs" / UNCERTAINTIES
    assert known(tmp_path / "runs") == FOUND
    assert FOUND.numerical_m == FOUND.step_m
    assert known(tmp_path / "runs", robot="pexod") is None
    assert known(tmp_path / "runs", duration_s=13.0) is None
    assert known(tmp_path) is None


def test_another_world_borrows_the_value_of_the_flat_one_and_says_so(tmp_path: Path) -> None:
    keep(tmp_path)
    borrowed = FOUND.model_copy(update={"borrowed": True})
    assert known(tmp_path, friction=0.4) == known(tmp_path, slope_deg=5.0) == borrowed
    assert known(tmp_path, time_step_s=0.004) is known(tmp_path, friction_cone="pyramidal") is None
    assert known(tmp_path, solver_tolerance=1e-8) is None


def test_the_measurement_of_the_most_walks_counts(tmp_path: Path) -> None:
    shipped_one = known_uncertainty("ant", folder=tmp_path)
    assert shipped_one is not None
    keep(tmp_path, duration_s=30.0, walks=20)
    assert known(tmp_path, duration_s=30.0) == shipped_one
    for walks, counted in ((7, 7), (9, 9), (8, 9)):
        keep(tmp_path, walks=walks)
        assert known(tmp_path).walks == counted
    keep(tmp_path, duration_s=30.0, walks=400)
    assert known(tmp_path, duration_s=30.0).walks == 400


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_the_shipped_robots_have_one(name: str, tmp_path: Path) -> None:
    found = known_uncertainty(name, folder=tmp_path)
    assert found is not None
    assert found.walks >= 80
    assert found.confirmed_m is not None
    assert 0 < found.confirmed_m < found.numerical_m
    assert 0 < found.numerical_m < 0.05


def test_a_damaged_file_is_named_and_a_folder_that_cannot_be_written(tmp_path: Path) -> None:
    for text in ("measured: 3", "measured: [{robot: ant}]", "measured: [", "other: 1"):
        (tmp_path / UNCERTAINTIES).write_text(text)
        with pytest.raises(InputError, match=UNCERTAINTIES):
            known_uncertainty("ant", folder=tmp_path)
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match=UNCERTAINTIES):
        keep_uncertainty(shipped(), World(), FOUND, folder=tmp_path / "file")
