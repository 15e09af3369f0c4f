"""Trials on a connected robot: its stance, its arena without resets, and measurements of an operator."""

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hexctl.adapt import runner as runner_module
from hexctl.adapt.arena import Arena
from hexctl.adapt.measurement import Answer, measured
from hexctl.adapt.objectives import INVALID_SCORE, OBJECTIVES
from hexctl.adapt.optimizer import Observation
from hexctl.adapt.prior.samples import DISTANCE, FINAL, features_of
from hexctl.adapt.reset_free import ResetFreeRunner, await_ready, cool_down
from hexctl.adapt.runner import RobotStoppedError, TrialRequest, TrialRunner
from hexctl.adapt.sessions.session_spec import SessionSpec
from hexctl.adapt.setting import Setting
from hexctl.adapt.space import GaitSpace
from hexctl.adapt.stance import simulated_deflection_rad, stance_deflection_rad
from hexctl.backends.clock import PERIOD_S
from hexctl.backends.mock import MockServos
from hexctl.backends.sim.world import World
from hexctl.control.controllers import sitting_angles_rad
from hexctl.control.guard import Guard
from hexctl.control.log import TickLog
from hexctl.control.trial import run_trial
from hexctl.control.trial_plan import TrialPlan
from hexctl.control.trial_result import TrialResult
from hexctl.errors import CommandRefusedError, RobotFaultError
from hexctl.robot.loader import load_robot_file
from hexctl.robot.rotations import wrapped_rad
from hexctl.types import FloatArray, JointTargets, RobotState
from tests.adapt.priors import plan_of
from tests.adapt.staying import StayingSim
from tests.adapt.walking import UNSEEN
from tests.backends.fake_time import FakeTime
from tests.control.posed import FallsAfter, PosedMock
from tests.robots import shipped

ROBOT = shipped()

STANCE_PLAN = plan_of(ROBOT)

SAG_RAD = float(np.radians(1.0))


def sag(world: World, seed: int = 0) -> FloatArray:
    found = simulated_deflection_rad(ROBOT, world, STANCE_PLAN, seed)
    assert found is not None
    return found


def test_a_heavier_robot_and_softer_servos_stay_farther_behind() -> None:
    plain = np.abs(sag(World())).sum()
    assert np.abs(sag(World(added_mass_share=0.3))).sum() > 1.1 * plain
    assert np.abs(sag(World(servo_stiffness=0.6))).sum() > 1.1 * plain


def test_a_robot_that_falls_says_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hexctl.control.guard.FALL_COS_TILT", 2.0)
    assert simulated_deflection_rad(ROBOT, World(), STANCE_PLAN, 0) is None


def test_a_robot_that_stays_says_what_a_simulation_says() -> None:
    with Guard(StayingSim(ROBOT)) as servos:
        here = stance_deflection_rad(servos, STANCE_PLAN)
    assert here is not None
    np.testing.assert_allclose(here, sag(StayingSim.world), atol=1e-4)


def test_a_robot_that_only_echoes_says_nothing_and_does_not_move() -> None:
    servos = MockServos(ROBOT, clock=FakeTime().clock())
    with Guard(servos) as guard:
        assert stance_deflection_rad(guard, STANCE_PLAN) is None
    assert not servos.sent


def test_a_robot_that_is_stopped_meanwhile_waits_for_a_person() -> None:
    with FallsAfter(PosedMock(ROBOT), 0.5) as guard, pytest.raises(RobotStoppedError, match="stopped: fell"):
        stance_deflection_rad(guard, STANCE_PLAN)


class Slow(PosedMock):
    """Follows at a speed of its own, and stays a degree behind at the end."""

    def __init__(self, speed_rad_s: float) -> None:
        super().__init__(ROBOT)
        self._step_rad = speed_rad_s * PERIOD_S
        self._at_rad = ROBOT.stance_angles_rad + 1.0

    def read(self) -> RobotState:
        goal = self.sent[-1].joint_positions_rad - SAG_RAD if self.sent else self._at_rad
        self._at_rad = self._at_rad + np.clip(goal - self._at_rad, -self._step_rad, self._step_rad)
        self.joints_rad = self._at_rad
        return super().read()


@pytest.mark.parametrize(
    ("speed_rad_s", "stands"), [(20.0, 1), (1.1, 2), (0.2, None)], ids=["fast", "slow", "hardly moving"]
)
def test_a_robot_that_moves_still_is_asked_again(speed_rad_s: float, stands: int | None) -> None:
    servos = Slow(speed_rad_s)
    with Guard(servos) as guard:
        began_s = servos.time.now_s
        sag_rad = stance_deflection_rad(guard, STANCE_PLAN)
        took = (servos.time.now_s - began_s) / STANCE_PLAN.settle_s
    if stands is None:
        assert sag_rad is None
    else:
        assert took == pytest.approx(stands, abs=0.2)
        assert sag_rad is not None
        np.testing.assert_allclose(sag_rad, SAG_RAD, atol=1e-3)


def test_neither_a_command_that_is_refused_once_nor_silence_afterwards_is_a_failure() -> None:
    servos = PosedMock(ROBOT)
    servos.joints_rad = ROBOT.stance_angles_rad - SAG_RAD

    class Refusing(Guard):
        refused = False

        def write(self, targets: JointTargets) -> JointTargets:
            if not self.refused and len(servos.sent) == 5:
                self.refused = True
                raise CommandRefusedError("not now")
            return super().write(targets)

    with Refusing(servos) as guard:
        sag_rad = stance_deflection_rad(guard, STANCE_PLAN)
        assert guard.refused
        servos.time.sleep(60.0)
        guard.read()
        assert guard.stopped is None
    assert sag_rad is not None
    np.testing.assert_allclose(sag_rad, SAG_RAD)


def test_joints_that_say_what_they_are_told_are_not_measured() -> None:
    servos = PosedMock(ROBOT)
    with Guard(servos) as guard:
        assert stance_deflection_rad(guard, STANCE_PLAN) is None
    assert servos.sent


PLAN = replace(STANCE_PLAN, duration_s=12.0)

SHORT_PLAN = replace(PLAN, duration_s=0.5, self_rotation="none")

#: The 12 s walk goes up to 1.78 m: this arena is about as small as it may be.
ARENA = Arena(home_m=(0.0, 0.0), radius_m=1.0)


pytestmark = pytest.mark.usefixtures("in_an_empty_folder")


@pytest.fixture(autouse=True)
def _no_distance_yet(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(StayingSim, "farthest_m", 0.0)


def request_of(index: int, code: int) -> TrialRequest:
    return TrialRequest(index=index, code=code, slots=GaitSpace((5,)).slots_of(code))


def runner_of(servos: Guard, plan: TrialPlan = PLAN, **more: Any) -> ResetFreeRunner:
    spec = SessionSpec(failed_leg=5, backend="tests.adapt.staying:StayingSim", duration_s=plan.duration_s)
    runner = TrialRunner(spec=spec, setting=Setting(load_robot_file("ant"), None, plan), folder=None)
    return ResetFreeRunner(runner=runner, servos=servos, **more)


def check_walk(log: TickLog, result: TrialResult) -> None:
    """Compare a result with the robot's positions; a line from far off leads through home."""
    assert log.frame is not None
    positions = log["base_position_world"][log.rows_of("walk")][:, :2]
    origin, heading_rad = log.frame.origin_world[:2], log.frame.heading_rad
    if np.hypot(*origin) > 0.3:
        assert abs(wrapped_rad(heading_rad - math.atan2(-origin[1], -origin[0]))) < math.radians(6)
    # The failed leg, at 240 degrees in the body's frame, trails.
    trailing_rad = log.frame.yaw_rad + math.radians(240)
    assert abs(wrapped_rad(trailing_rad + math.pi - heading_rad)) < math.radians(4)
    along = np.array([math.cos(heading_rad), math.sin(heading_rad)])
    moved = positions[-1] - origin
    assert result.distance_m == pytest.approx(float(moved @ along))
    assert result.deviation is not None
    assert result.deviation.signed == pytest.approx(float(along[0] * moved[1] - along[1] * moved[0]))


@pytest.mark.slow
def test_a_walk_that_leaves_is_cut_short_and_the_next_one_aims_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """The arena is much smaller than the walk."""
    logs: list[TickLog] = []

    def logged(servos: Guard, plan: TrialPlan, *controller: Any, **more: Any) -> TrialResult:
        logs.append(TickLog())
        return run_trial(servos, plan, *controller, **more | {"recorders": (logs[-1],)})

    monkeypatch.setattr(runner_module, "run_trial", logged)
    arena = Arena(home_m=(0.0, 0.0), radius_m=0.6)
    with Guard(StayingSim(ROBOT)) as robot:
        runner = runner_of(robot, arena=arena)
        first = runner.walk(request_of(1, 17)).result
        assert (first.status, first.stopped, first.valid) == ("cut_short", "arena", False)
        assert 0 < first.duration_s < PLAN.duration_s
        position = await_ready(robot).base_position_world
        assert position is not None
        edge_m = arena.distance_m(position)
        assert edge_m > 0.4
        second = runner.walk(request_of(2, 17)).result
        check_walk(logs[0], first)
        check_walk(logs[1], second)
        assert second.distance_m is not None
        assert second.distance_m > edge_m, "it came through the middle"
    assert StayingSim.farthest_m < arena.radius_m + 0.15, "it needs some way to stop"


def test_a_robot_without_a_position_is_refused_unless_an_operator_measures() -> None:
    servos = PosedMock(ROBOT)
    servos.position_world = servos.quaternion_world = None
    with Guard(servos) as guard:
        with pytest.raises(RobotFaultError, match=r"knows no position.*with ask$"):
            await_ready(guard)
        assert await_ready(guard, needs_pose=False).base_position_world is None
    assert not servos.sent, "nothing moved"


def test_a_robot_that_lies_on_its_side_is_not_walked_and_not_scored() -> None:
    servos = PosedMock(ROBOT)
    servos.lean(85.0)
    with Guard(servos) as guard, pytest.raises(RobotStoppedError, match="stopped: fell") as raised:
        runner_of(guard, arena=ARENA).walk(request_of(1, 17))
    assert raised.value.reason == "fell"
    assert not servos.sent


def test_a_fall_on_the_way_to_the_start_is_not_the_gaits_fault() -> None:
    servos = PosedMock(ROBOT)
    with FallsAfter(servos, 3.0) as guard, pytest.raises(RobotStoppedError, match="stopped: fell"):
        runner_of(guard, arena=ARENA).walk(request_of(1, 17))


def test_between_trials_silence_is_no_failure_and_a_robot_that_sits_stands_up_from_there() -> None:
    """A person who measures takes longer than the guard's patience."""
    servos = PosedMock(ROBOT)
    with Guard(servos) as guard:
        runner = runner_of(guard, SHORT_PLAN)
        runner.walk(request_of(1, 17))
        assert not guard.expects_commands
        servos.time.sleep(60.0)
        guard.read()
        assert guard.stopped is None
        sat_rad = ROBOT.stance_angles_rad + 0.4
        servos.joints_rad = sat_rad
        servos.sent.clear()
        runner.walk(request_of(2, 17))
    steps = np.abs(servos.sent[0].joint_positions_rad - sat_rad)
    assert steps.max() < 0.1, "the first command is near where the joints are"


class HeatedMock(PosedMock):
    """A robot whose hottest servo cools down by a degree in ten seconds, once it sits without torque."""

    def __init__(self) -> None:
        super().__init__()
        self.temperatures_c = np.full(18, 35.0)
        self.temperatures_c[13] = 58.0
        self.limp = False

    def read(self) -> RobotState:
        """The state, with the temperatures of the servos."""
        if self.limp and self.temperatures_c is not None:
            self.temperatures_c[13] -= 0.1 * self.clock.period_s
        return super().read()

    def disable_torque(self) -> bool:
        """Go limp."""
        self.limp = True
        return True

    def write(self, targets: JointTargets) -> JointTargets:
        """Take the targets over."""
        self.limp = False
        return super().write(targets)


def test_a_hot_robot_sits_limp_until_it_has_cooled_down() -> None:
    notes: list[str] = []
    servos = HeatedMock()
    with Guard(servos, expiry_s=1.0) as guard:
        cool_down(guard, 50.0, lambda: False, notes.append)
        assert servos.limp
        assert servos.temperatures_c is not None
        assert servos.temperatures_c[13] == pytest.approx(50.0, abs=0.1)
        np.testing.assert_allclose(servos.read().joint_positions_rad, sitting_angles_rad(ROBOT), atol=1e-9)
        assert guard.clock.now_s == pytest.approx(82.0, abs=2.0)
        assert notes[0] == "cooling down below 50 C: leg 5 femur 58 C"
        assert notes[1:] == ["still cooling down: leg 5 femur 52 C"]
        assert guard.stopped is None


def test_a_stop_while_a_hot_robot_sits_down_does_not_drop_it() -> None:
    servos, ticks = HeatedMock(), iter(range(100))
    with Guard(servos, expiry_s=1.0) as guard:
        cool_down(guard, 50.0, lambda: next(ticks) >= 20, lambda _: None)
        assert not servos.limp
        reached = servos.read().joint_positions_rad
        assert np.abs(reached - sitting_angles_rad(ROBOT)).max() > 0.1, "it was still up"


def test_a_cool_robot_does_not_sit_and_one_that_stays_hot_is_reported(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    servos = HeatedMock()
    notes: list[str] = []
    with Guard(servos, expiry_s=1.0) as guard:
        cool_down(guard, 60.0, lambda: False, notes.append)
        assert (servos.limp, notes) == (False, [])
        monkeypatch.setattr("hexctl.adapt.reset_free.COOLING_TIMEOUT_S", 60.0)
        with pytest.raises(RobotFaultError, match=r"not below 30 C after 1 min: leg 5 femur 52 C"):
            cool_down(guard, 30.0, lambda: False, notes.append)


def told(word: str, distance_m: float = math.nan, signed_m: float = math.nan) -> TrialResult:
    answer = Answer(word=word, distance_m=distance_m, signed_m=signed_m)  # type: ignore[arg-type]
    return measured(UNSEEN, answer, ROBOT, STANCE_PLAN)


def test_two_numbers_make_a_trial() -> None:
    result = told("measured", 4.0, -0.12)
    assert (result.status, result.valid, result.distance_m) == ("ok", True, 4.0)
    assert result.deviation is not None
    assert (result.deviation.final, result.deviation.signed) == (0.12, -0.12)
    assert OBJECTIVES["final"](result) == 0.12
    assert OBJECTIVES["progress"](result) == pytest.approx(0.12 * result.ideal_distance_m / 4.0)
    assert result.to_dict()["deviation_m"] == {"final": 0.12, "signed": -0.12, "mean": None, "max": None}
    json.dumps(result.to_dict(), allow_nan=False)


def test_only_the_end_is_learned_from() -> None:
    features = features_of(Observation.of(told("measured", 4.0, -0.12)), 30.0)
    assert (features[FINAL], features[DISTANCE]) == (-0.12, 4.0)
    assert np.isfinite(features).sum() == 2


@pytest.mark.parametrize(
    ("result", "status", "stopped"),
    [
        (told("measured", 1.0, 0.0), "no_progress", None),
        (told("fell"), "fell", None),
        (told("skip"), "cut_short", "skipped"),
        (told("quit"), "aborted", "requested"),
    ],
)
def test_what_counts_for_nothing(result: TrialResult, status: str, stopped: str | None) -> None:
    assert (result.status, result.stopped, result.valid) == (status, stopped, False)
    assert OBJECTIVES["final"](result) == INVALID_SCORE
    features_of(Observation.of(result), 30.0)
