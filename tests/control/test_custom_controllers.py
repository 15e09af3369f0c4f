"""Custom controllers: given to a trial, alone and in a batch, with the state at every step."""

import math
from typing import Any

import numpy as np
import pytest

from hexctl import (
    Controller,
    Failure,
    Guard,
    InputError,
    LegServos,
    RobotState,
    SimServos,
    SimTrial,
    TrialPlan,
    TrialResult,
    World,
    make_gait,
    run_sim_trials,
    run_trial,
)
from hexctl.backends.mock import MockServos
from hexctl.control.batch import run_sim_trial
from hexctl.control.controllers import Walk, soft_stop_steps
from hexctl.control.log import TickLog
from hexctl.control.preparation import WalkStart
from hexctl.control.trial import planned_walk
from hexctl.errors import WrongTypeError
from hexctl.robot.rotations import yaw_rad
from hexctl.types import BoolArray, FloatArray
from tests.control.posed import PosedMock
from tests.robots import shipped
from tests.trials import Calling, sim_trial

ANT = shipped()


class YawHold(Controller):
    """Turns the coxae of a planned walk against the body's yaw at every step."""

    def __init__(self, start: WalkStart) -> None:
        assert start.frame is not None
        self._walk, self._yaw_rad = planned_walk(start), start.frame.yaw_rad
        self.shapes: set[tuple[int, ...]] = set()

    def targets_rad(self, step: int, state: RobotState) -> FloatArray:
        assert state.base_quaternion_world is not None
        self.shapes.add(np.shape(state.joint_positions_rad))
        targets = self._walk.targets_rad(step, state).copy()
        off_rad = yaw_rad(state.base_quaternion_world) - self._yaw_rad
        targets[..., ::3] -= 0.3 * np.asarray(off_rad)[..., np.newaxis]
        return targets


class UntilAhead(YawHold):
    """Ends a walk 0.1 m from its start."""

    def __init__(self, start: WalkStart) -> None:
        super().__init__(start)
        assert start.frame is not None
        self._origin = start.frame.origin_world

    def done(self, step: int, state: RobotState) -> bool | BoolArray:
        assert state.base_position_world is not None
        return np.asarray(np.linalg.norm((state.base_position_world - self._origin)[..., :2], axis=-1) > 0.1)


def _trials(world: World, duration_s: float = 3.0) -> list[SimTrial]:
    given: dict[str, Any] = {"failure": Failure(leg=3), "world": world, "seed": 4, "self_rotation": "none"}
    return [sim_trial(code, duration_s=duration_s, **given) for code in ("1", "57", "120")]


def _walked(
    controller: Any = None, *, servos: LegServos | None = None, duration_s: float = 1.0
) -> tuple[TrialResult, TickLog]:
    """A trial of the tripod, by default in the simulation."""
    log, plan = TickLog(), TrialPlan(gait=make_gait(ANT, "tripod"), duration_s=duration_s)
    with servos or SimServos(ANT) as connected:
        return run_trial(Guard(connected), plan, controller, recorders=(log,)), log


NOISY = World.model_validate({"sensor_noise": {"joint_deg": 0.5, "position_m": 0.002, "yaw_deg": 0.5}})


@pytest.mark.slow
@pytest.mark.parametrize(
    ("controller", "world", "duration_s"),
    [
        (YawHold, World(), 1.5),
        (YawHold, NOISY, 1.5),
        (UntilAhead, World(), 3.0),
    ],
    ids=["flat", "noisy", "until ahead"],
)
def test_a_controller_that_looks_at_the_state_walks_the_same_alone_and_in_a_batch(
    controller: type[YawHold], world: World, duration_s: float
) -> None:
    trials = _trials(world, duration_s)
    made: list[YawHold] = []

    def make(start: WalkStart) -> Controller:
        made.append(controller(start))
        return made[-1]

    together = run_sim_trials(trials, make_controller=make)
    assert all((result.duration_s < duration_s) == (controller is UntilAhead) for result in together)
    assert [walk.shapes for walk in made] == [{(3, 18)}]
    alone = [run_sim_trial(trial, make) for trial in trials]
    assert [walk.shapes for walk in made[1:]] == [{(18,)}] * 3
    for one, other in zip(together, alone, strict=True):
        assert one.to_dict() == other.to_dict()
        assert np.array_equal(one.path_m, other.path_m)
    open_loop = run_sim_trials(trials)
    assert all(
        not np.array_equal(one.path_m, other.path_m) for one, other in zip(together, open_loop, strict=True)
    )


def test_a_controller_that_is_done_ends_the_walk_as_ok() -> None:
    result = run_sim_trial(_trials(World(), duration_s=30.0)[0], UntilAhead)
    assert result.status == "ok"
    assert result.duration_s < 10
    assert result.distance_m == pytest.approx(0.1, abs=0.02)


def test_a_controller_made_beforehand_walks_and_stops_softly_also_if_it_ends_the_walk(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    planned, whole = _walked(servos=PosedMock())
    assert (planned.status, whole.walked_ticks) == ("ok", 50)
    monkeypatch.setattr(Walk, "done", lambda _walk, step, _state: step >= 25)  # at half of the full stride
    plan = TrialPlan(gait=make_gait(ANT, "tripod"))
    given, log = _walked(Walk(ANT, plan.gait, plan.motion(0.0), period_s=0.02), servos=PosedMock())
    assert (given.status, log.walked_ticks) == ("ok", 26)
    np.testing.assert_array_equal(
        log["requested_rad"][log.rows_of("walk")], whole["requested_rad"][whole.rows_of("walk")][:26]
    )
    stop = log.rows_of("stop")
    assert stop.stop - stop.start == soft_stop_steps(0.02)
    np.testing.assert_allclose(log["commanded_rad"][-1], ANT.stance_angles_rad, atol=1e-9)


def test_a_controller_without_a_stop_is_followed_by_the_stance() -> None:
    _, log = _walked(YawHold, duration_s=1.5)
    stop = log.rows_of("stop")
    assert stop.stop - stop.start == soft_stop_steps(0.02)
    np.testing.assert_allclose(log["commanded_rad"][-1], ANT.stance_angles_rad, atol=0.02)
    steps_rad = np.abs(np.diff(log["commanded_rad"][stop.start - 1 : stop.stop], axis=0))
    assert steps_rad.max() < 0.02, "evenly, not in a jump"


class Stumbling(YawHold):
    """Gives one robot targets that are not finite after a second."""

    def __init__(self, start: WalkStart) -> None:
        super().__init__(start)
        codes = [plan.gait.code((3,)) for plan in start.plans]
        self._wrong = np.array(codes) == 57 if start.batch_shape else codes[0] == 57

    def targets_rad(self, step: int, state: RobotState) -> FloatArray:
        targets = super().targets_rad(step, state)
        if step >= 50:
            targets[self._wrong] = np.nan
        return targets


@pytest.mark.slow
def test_targets_that_are_not_finite_abort_a_walk_alone_and_in_a_batch() -> None:
    trials = _trials(World(), duration_s=2.0)
    together = run_sim_trials(trials, make_controller=Stumbling)
    assert [result.status for result in together] == ["ok", "aborted", "ok"]
    assert together == [run_sim_trial(trial, Stumbling) for trial in trials]


class Confused(YawHold):
    """Gives the targets of one robot to all."""

    def targets_rad(self, step: int, state: RobotState) -> FloatArray:
        return np.asarray(super().targets_rad(step, state)[0])


def test_a_batch_refuses_targets_of_another_shape() -> None:
    with pytest.raises(InputError, match="controller"):
        run_sim_trials(_trials(World()), make_controller=Confused)


def test_arguments_of_a_trial_are_refused_by_name_before_anything_moves() -> None:
    plan, log = TrialPlan(gait=make_gait(ANT, "tripod"), duration_s=0.1), TickLog()
    with MockServos(ANT) as servos:
        guard = Guard(servos)
        for arguments, named in (
            ((guard, plan, log), "controller"),
            ((guard, plan, lambda _step, _state, _gain: None), "controller"),
            ((guard, plan, None, (print,)), "recorders"),
        ):
            with pytest.raises(WrongTypeError, match=f"^{named}"):
                run_trial(*arguments)
        with pytest.raises(InputError, match="servos"):  # a guard of each trial's own would forget stops
            run_trial(servos, plan)
        assert not servos.sent
        with pytest.raises(WrongTypeError, match="controller"):
            run_trial(guard, plan, lambda _: None)  # type: ignore[arg-type]


def test_a_recorder_that_fails_is_a_warning_and_the_others_go_on() -> None:
    def fail(*_: object) -> None:
        raise OSError("no space left")

    log, plan = TickLog(), TrialPlan(gait=make_gait(ANT, "tripod"), duration_s=0.5)
    with Guard(PosedMock()) as guard, pytest.warns(UserWarning, match="Calling"):
        result = run_trial(guard, plan, recorders=(Calling(fail), log))
    assert result.status == "ok"
    assert log.walked_ticks == 25


def sway(step: int, _state: RobotState) -> list[float]:
    """Bends the knees and stretches them, twice a second, as a list."""
    angles_rad = ANT.stance_angles_rad.copy()
    angles_rad[2::3] += 0.05 * math.sin(math.tau * 2 * step * 0.02)
    return [float(angle) for angle in angles_rad]


def test_a_function_of_step_and_state_is_a_controller_and_a_maker_may_give_one() -> None:
    def swaying(start: WalkStart) -> Any:
        assert start.robot == ANT
        return lambda step, state: sway(step, state)

    state = RobotState(ANT.stance_angles_rad, 0.0, measured=True)
    for controller, name in ((sway, "sway"), (swaying, "swaying")):
        result, log = _walked(controller, servos=PosedMock(), duration_s=0.6)
        assert result.controller == name
        walk = log.rows_of("walk")
        wanted = [sway(step, state) for step in range(walk.stop - walk.start)]
        np.testing.assert_array_equal(log["requested_rad"][walk], wanted)


def test_a_function_walks_the_same_alone_and_in_a_batch() -> None:
    trials = _trials(World(), duration_s=0.5)
    together = run_sim_trials(trials, make_controller=sway)
    assert together == [run_sim_trial(trial, sway) for trial in trials]
    assert [result.controller for result in together] == ["sway"] * 3


@pytest.mark.parametrize(
    ("returned", "error"),
    [
        ([0.0] * 17, InputError),
        (np.zeros((2, 18)), InputError),
        (None, WrongTypeError),
        (["left"] * 18, WrongTypeError),
    ],
    ids=["17", "two robots", "none", "texts"],
)
def test_other_than_18_angles_are_refused(returned: Any, error: type[Exception]) -> None:
    class Wrong(Controller):
        def targets_rad(self, step: int, state: RobotState) -> Any:
            return returned

    for controller in (lambda _step, _state: returned, Wrong()):
        with pytest.raises(error, match=r"^controller"):
            _walked(controller, servos=PosedMock(), duration_s=0.2)
