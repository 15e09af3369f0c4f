"""The simulation's own uncertainty: what it is made of, and that it sees what it should."""

import math
from dataclasses import replace

import pytest

from hexctl.backends.sim.world import World
from hexctl.control.assessment.uncertainty import simulation_uncertainty, uncertainty_of_walks
from hexctl.control.assessment.uncertainty_store import SimulationUncertainty
from hexctl.control.batch import SimTrial, run_sim_trial
from hexctl.control.trial_plan import TrialPlan
from hexctl.errors import InputError
from hexctl.gait.gait import make_gait
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


@pytest.mark.slow
def test_it_is_how_far_each_walk_ends_elsewhere() -> None:
    found = uncertainty_of_walks([walk(), replace(walk(), facing_rad=0.5)])
    finer_m = end_m(walk(time_step_s=0.001)) - end_m(walk())
    assert found.step_m == pytest.approx(abs(finer_m), rel=0.05)
    softer_m, harder_m = (end_m(walk(contact_time_s=0.02 * k)) - end_m(walk()) for k in (4 / 3, 3 / 4))
    assert found.contact_m == pytest.approx(math.sqrt((softer_m**2 + harder_m**2) / 2), rel=0.05)
    assert found.numerical_m == found.step_m, "the default solver tolerance is not used"
    assert 0 < found.solver_m < found.contact_m
    assert (found.walks, found.duration_s) == (2, 4.0)
    assert (found.low_m, found.high_m) == (None, None)  # of two walks


def test_a_confirmation_is_as_uncertain_as_half_its_step_changes() -> None:
    finest = replace(walk(), world=World().model_copy(update={"time_step_s": 0.00025}))
    moved_m = end_m(walk(time_step_s=0.0005)) - end_m(finest)
    assert uncertainty_of_walks([walk()]).confirmed_m == pytest.approx(abs(moved_m))


@pytest.mark.slow
def test_a_coarse_step_is_more_uncertain_than_a_fine_one() -> None:
    coarse, fine = (uncertainty_of_walks([walk(time_step_s=step_s)]) for step_s in (0.005, 0.001))
    assert coarse.step_m > fine.step_m


@pytest.mark.slow
def test_walks_without_an_end_are_left_out() -> None:
    fallen = replace(walk(), world=World(payload_kg=6.0, payload_position_m=(0.5, 0.0, 0.3)))
    assert uncertainty_of_walks([walk(), fallen]).walks == 1
    with pytest.raises(InputError, match="walks: got none"):
        uncertainty_of_walks([fallen])


def test_a_step_that_cannot_be_halved_is_refused() -> None:
    with pytest.raises(InputError, match=r"time_step_s: got 0.0005; allowed: 0.001 or more"):
        uncertainty_of_walks([walk(time_step_s=0.0005)])


@pytest.mark.slow
def test_a_robot_is_measured_over_gaits_and_legs() -> None:
    found = simulation_uncertainty("ant", duration_s=1.0)
    assert isinstance(found, SimulationUncertainty)
    assert found.walks == 20
    assert found.to_dict()["numerical_m"] == round(found.numerical_m, 4)
    assert found.low_m is not None
    assert found.high_m is not None
    assert 0 < found.low_m < found.numerical_m < found.high_m < 2 * found.numerical_m


def test_walks_of_several_durations_are_refused() -> None:
    longer = replace(walk(), plan=replace(walk().plan, duration_s=5.0))
    with pytest.raises(
        InputError, match="duration_s of the walks: got 4, 5 s; allowed: walks of one duration"
    ):
        uncertainty_of_walks([walk(), longer])
    with pytest.raises(InputError, match="got none"):
        uncertainty_of_walks([])


@pytest.mark.slow
def test_each_walk_is_compared_with_a_finer_one_in_its_own_world() -> None:
    alone = [uncertainty_of_walks([walk(time_step_s=step_s)]).step_m for step_s in (0.004, 0.002)]
    together = uncertainty_of_walks([walk(time_step_s=step_s) for step_s in (0.004, 0.002)])
    assert together.step_m == pytest.approx(math.hypot(*alone) / math.sqrt(2))
