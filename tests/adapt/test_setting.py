"""What a session spec names, and the simulation's own uncertainty of its walks."""

from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from hexctl.adapt.optimizers.bayes import REAL_NOISE_M, SIMULATED_NOISE_M
from hexctl.adapt.prior.prior_choice import noise_m
from hexctl.adapt.search import new_spec
from hexctl.adapt.sessions.session_spec import SessionSpec
from hexctl.backends.sim.world import World, load_world
from hexctl.control.assessment.uncertainty_store import SimulationUncertainty, keep_uncertainty
from hexctl.robot.configs import config_root
from tests.robots import shipped

FOUND = SimulationUncertainty(step_m=0.03, solver_m=0.04, contact_m=0.1, walks=7, duration_s=40.0)


def spec_of(folder: Path, notes: list[str], **options: object) -> SessionSpec:
    return new_spec(failed_leg=5, prior="none", folder=folder, note=notes.append, **options)  # type: ignore[arg-type]


def test_a_simulated_session_stores_the_uncertainty_that_was_measured(tmp_path: Path) -> None:
    notes: list[str] = []
    assert 0 < spec_of(tmp_path, notes).uncertainty_m < 0.05
    keep_uncertainty(shipped(), World(), FOUND, folder=tmp_path)
    assert spec_of(tmp_path, notes, duration_s=40.0).uncertainty_m == pytest.approx(0.03)
    assert spec_of(tmp_path, notes, duration_s=40.0, uncertainty_m=0).uncertainty_m == 0
    assert not notes


def test_a_session_stores_which_walks_were_measured(tmp_path: Path) -> None:
    """The value of the flat world was printed in every world as if it were its own."""
    notes: list[str] = []
    assert spec_of(tmp_path, notes).uncertainty_caveat == ""
    limp = spec_of(tmp_path, notes, world="slope", failure="5:limp")
    assert limp.uncertainty_caveat == "measured with locked legs on the flat world"
    assert limp.uncertainty_m == spec_of(tmp_path, notes).uncertainty_m
    keep_uncertainty(shipped(), load_world("slope"), replace(FOUND, duration_s=30.0), folder=tmp_path)
    assert spec_of(tmp_path, notes).uncertainty_m < 0.05
    assert spec_of(tmp_path, notes, world="slope").uncertainty_m == pytest.approx(0.03)
    assert spec_of(tmp_path, notes, world="slope").uncertainty_caveat == ""


def test_walks_are_confirmed_where_a_finer_step_says_more(tmp_path: Path) -> None:
    notes: list[str] = []
    assert 0 < spec_of(tmp_path, notes).confirmed_uncertainty_m < 0.015
    fine = tmp_path / "fine.yaml"
    fine.write_text("time_step_s: 0.0005", encoding="utf-8")
    keep_uncertainty(shipped(), load_world(fine), replace(FOUND, confirmed_m=0.01), folder=tmp_path)
    at_fine = spec_of(tmp_path, notes, world=str(fine), duration_s=40.0)
    assert (at_fine.uncertainty_m, at_fine.confirmed_uncertainty_m) == (FOUND.step_m, 0.0)
    assert spec_of(tmp_path, notes, optimizer="trim", hold="none").confirmed_uncertainty_m == 0.0
    assert spec_of(tmp_path, notes, objective="mean").confirmed_uncertainty_m == 0.0


def test_an_uncertainty_that_is_not_known_is_one_note_with_its_command(tmp_path: Path) -> None:
    world = tmp_path / "coarse.yaml"
    world.write_text("time_step_s: 0.004")
    robot = yaml.safe_load((config_root() / "robots" / "ant.yaml").read_text())
    robot["body"]["mass_kg"] *= 1.5
    own = tmp_path / "own robot.yaml"
    own.write_text(yaml.safe_dump(robot))
    commands = (
        ({"robot": str(own)}, f"hexctl check '{own}' --physics"),
        ({"duration_s": 45.0}, "hexctl check ant --physics --duration 45"),
        ({"world": str(world)}, f"hexctl check ant --physics --world {world}"),
    )
    for options, command in commands:
        notes: list[str] = []
        assert spec_of(tmp_path, notes, **options).uncertainty_m == 0
        assert notes == [f"the simulation's own uncertainty is not known here; {command} measures it"]


@pytest.mark.parametrize("options", [{"backend": "mock"}, {"objective": "mean"}, {"duration_s": 5.0}])
def test_there_is_none_on_a_robot_of_other_scores_and_of_short_walks(
    options: dict[str, object], tmp_path: Path
) -> None:
    notes: list[str] = []
    assert spec_of(tmp_path, notes, **options).uncertainty_m == 0
    assert not notes


def test_a_session_from_before_goes_on_without() -> None:
    assert SessionSpec(failed_leg=5).uncertainty_m == 0
    assert SessionSpec(failed_leg=5, target_m=0.025).greatest_chance is None


def test_what_noise_is_believed_is_stored() -> None:
    simulated, real = (new_spec(failed_leg=5, backend=backend) for backend in ("sim", "mock"))
    assert (simulated.noise_m, real.noise_m) == (SIMULATED_NOISE_M, REAL_NOISE_M)
    assert real.worth_m == pytest.approx(REAL_NOISE_M)
    assert [noise_m(spec) for spec in (simulated, real)] == [SIMULATED_NOISE_M, REAL_NOISE_M]


def test_the_greatest_chance_is_that_of_a_walk_which_ends_on_the_line() -> None:
    spec = SessionSpec(failed_leg=5, target_m=0.025, uncertainty_m=0.025)
    assert spec.greatest_chance == pytest.approx(0.6827, abs=1e-4)
    assert SessionSpec(failed_leg=5, uncertainty_m=0.025).greatest_chance is None
