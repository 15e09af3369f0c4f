"""Kept measurements of the simulation's own uncertainty: their form, and for which walks they are found."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml

from hexctl.backends.sim.world import World, load_world
from hexctl.control.assessment.uncertainty_store import (
    UNCERTAINTIES,
    SimulationUncertainty,
    keep_uncertainty,
    known_uncertainty,
)
from hexctl.errors import InputError
from tests.robots import ROBOT_NAMES, VENDORS_ROBOTS, shipped

FOUND = SimulationUncertainty(step_m=0.03, solver_m=0.04, contact_m=0.1, walks=7, duration_s=12.0)


def keep(folder: Path, *, place: World | None = None, **changes: Any) -> Path:
    return keep_uncertainty(shipped(), place or World(), replace(FOUND, **changes), folder=folder)


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
    others: tuple[dict[str, Any], ...] = ({"friction": 0.4}, {"slope_deg": 5.0}, {"contact_time_s": 0.01})
    for world in others:
        assert known(tmp_path, **world) == replace(FOUND, borrowed=True)
    otherwise: tuple[dict[str, Any], ...] = (
        {"time_step_s": 0.004},
        {"friction_cone": "pyramidal"},
        {"solver_tolerance": 1e-8},
    )
    for computed in otherwise:
        assert known(tmp_path, **computed) is None


def test_a_measurement_on_a_slope_is_not_one_of_the_flat_world(tmp_path: Path) -> None:
    """What was kept of another world was the value of every world."""
    keep(tmp_path, step_m=0.5, place=load_world("slope"))
    assert known(tmp_path) is None
    keep(tmp_path)
    assert known(tmp_path) == FOUND
    on_slope = known_uncertainty("ant", "slope", duration_s=12.0, folder=tmp_path)
    assert on_slope == replace(FOUND, step_m=0.5)


def test_a_caveat_says_which_walks_were_measured() -> None:
    borrowed = replace(FOUND, borrowed=True)
    assert FOUND.caveat("locked") == ""
    assert FOUND.caveat("limp") == "measured with locked legs"
    assert borrowed.caveat("locked") == "measured on the flat world"
    assert borrowed.caveat("limp") == "measured with locked legs on the flat world"


def test_the_measurement_of_the_most_walks_counts(tmp_path: Path) -> None:
    """20 walks of a user took the place of the 100 that are shipped."""
    shipped_one = known_uncertainty("ant", folder=tmp_path)
    assert shipped_one is not None
    keep(tmp_path, duration_s=30.0, walks=20)
    assert known(tmp_path, duration_s=30.0) == shipped_one
    for walks, counted in ((7, 7), (9, 9), (8, 9)):
        keep(tmp_path, walks=walks)
        assert known(tmp_path).walks == counted
    keep(tmp_path, duration_s=30.0, walks=400)
    assert known(tmp_path, duration_s=30.0).walks == 400


def test_the_interval_is_kept_too(tmp_path: Path) -> None:
    path = keep(tmp_path, low_m=0.04, high_m=0.06, confirmed_m=0.01)
    assert known(tmp_path).confirmed_m == 0.01
    assert (known(tmp_path).low_m, known(tmp_path).high_m) == (0.04, 0.06)
    (entry,) = yaml.safe_load(path.read_text())["measured"]
    assert "numerical_m" not in entry
    assert entry["world"]["friction"] == 0.8


def test_looking_up_loads_no_simulation() -> None:
    code = "import sys, hexctl.control.assessment.uncertainty_store; print('mujoco' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, check=True)
    assert done.stdout == "False\n"


@pytest.mark.parametrize("name", VENDORS_ROBOTS)
def test_robots_of_vendors_have_none_yet(name: str, tmp_path: Path) -> None:
    assert known_uncertainty(name, folder=tmp_path) is None


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_the_shipped_robots_have_one(name: str, tmp_path: Path) -> None:
    """Of each robot file as it is now: another description of the robot needs another measurement."""
    found = known_uncertainty(name, folder=tmp_path)
    assert found is not None
    assert found.walks >= 80
    assert found.confirmed_m is not None
    assert 0 < found.confirmed_m < found.numerical_m
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
