"""The reset-free runner: trials inside the arena of one robot, worth the same as simulated ones."""

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexctl.adapt import runner as runner_module
from hexctl.adapt.arena import Arena
from hexctl.adapt.reset_free import ResetFreeRunner, await_ready, cool_down
from hexctl.adapt.runner import RobotStoppedError, TrialRunner
from hexctl.adapt.sessions.session_spec import SessionSpec
from hexctl.adapt.space import GaitSpace
from hexctl.backends.sim.servos import SimServos
from hexctl.control.controllers import sitting_angles_rad
from hexctl.control.guard import Guard
from hexctl.control.log import TickLog
from hexctl.control.trial import run_trial
from hexctl.control.trial_plan import TrialPlan
from hexctl.control.trial_result import TrialResult
from hexctl.errors import InputError, RobotFaultError
from hexctl.gait.encoding import Slots
from hexctl.gait.gait import make_gait
from hexctl.robot.failure import Failure
from hexctl.robot.rotations import wrapped_rad
from hexctl.types import FloatArray, JointTargets, RobotState, ServoReadings
from tests.adapt.staying import StayingSim
from tests.control.posed import FallsAfter, PosedMock
from tests.robots import shipped

pytestmark = pytest.mark.long

ROBOT = shipped()
SPACE = GaitSpace((5,))
PLAN = TrialPlan(gait=make_gait(ROBOT, "demo"), belief=Failure(leg=5), duration_s=12.0)

#: The 12 s walk goes up to 1.78 m: this arena is about as small as it may be.
ARENA = Arena(home_m=(0.0, 0.0), radius_m=1.0)

#: How far beyond the edge a robot that is told to stop may come.
MARGIN_M = 0.15


@pytest.fixture(autouse=True)
def _in_an_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(StayingSim, "farthest_m", 0.0)


def plan_for(slots: Slots) -> TrialPlan:
    return replace(PLAN, gait=replace(PLAN.gait, slots=slots))


def runner_of(servos: Guard, plan: TrialPlan = PLAN, **more: Any) -> ResetFreeRunner:
    spec = SessionSpec(failed_leg=5, backend="tests.adapt.staying:StayingSim", duration_s=plan.duration_s)
    runner = TrialRunner(
        spec=spec,
        robot=ROBOT,
        world=None,
        plan_for=lambda slots: replace(plan, gait=replace(plan.gait, slots=slots)),
        folder=None,
    )
    return ResetFreeRunner(runner=runner, servos=servos, **more)


@pytest.fixture
def robot() -> Iterator[Guard]:
    with Guard(StayingSim(ROBOT)) as servos:
        yield servos


def test_a_gait_is_worth_the_same_after_any_self_rotation() -> None:
    """A long turn and none: a few centimetres, which is what the turn misses its goal by."""
    ends = []
    for turn_deg in (0.0, 170.0):
        plan = replace(plan_for(SPACE.slots_of(17)), duration_s=30.0)
        # Seen from the body, the walk goes at 60 degrees: opposite to leg 5.
        plan = replace(plan, heading_rad=math.radians(60 + turn_deg), turn_rad=math.radians(turn_deg))
        servos = SimServos(ROBOT, failure=plan.belief)
        with Guard(servos) as guard:
            result = run_trial(guard, plan)
        assert math.degrees(result.turned_rad) == pytest.approx(turn_deg, abs=2.0)
        assert result.deviation is not None
        assert result.distance_m is not None
        ends.append((result.distance_m, result.deviation.signed))
    assert np.ptp(ends, axis=0) == pytest.approx([0.0, 0.0], abs=0.06)


def test_many_trials_of_good_and_bad_gaits_stay_in_the_arena(
    robot: Guard, monkeypatch: pytest.MonkeyPatch
) -> None:
    logs: list[TickLog] = []

    def watched(servos: Guard, plan: TrialPlan, *controller: Any, **more: Any) -> TrialResult:
        logs.append(TickLog())
        return run_trial(servos, plan, *controller, **more | {"recorders": (logs[-1],)})

    monkeypatch.setattr(runner_module, "run_trial", watched)
    runner, results = runner_of(robot, arena=ARENA), []
    for index in range(1, 7):
        code = 20 * index - 10
        result = runner.walk(index, code, SPACE.slots_of(code)).result
        results.append(result)
        self_check(logs[-1], result)
    assert StayingSim.farthest_m < ARENA.radius_m + MARGIN_M
    statuses = [result.status for result in results]
    assert statuses.count("ok") >= 3, "most walks fit"
    assert set(statuses) <= {"ok", "no_progress", "cut_short"}
    for result in results:
        assert result.stopped == ("arena" if result.status == "cut_short" else None)
        assert result.valid == (result.status == "ok")
        assert result.distance_m is not None


def place_of(robot: Guard) -> FloatArray:
    position = await_ready(robot).base_position_world
    assert position is not None
    return position


def self_check(log: TickLog, result: TrialResult) -> None:
    """Look at the robot's own positions: the line led through home, and the numbers are of that line."""
    assert log.frame is not None
    positions = log["base_position_world"][log.rows_of("walk")][:, :2]
    origin, heading_rad = log.frame.origin_world[:2], log.frame.heading_rad
    if np.hypot(*origin) > 0.3:
        assert abs(wrapped_rad(heading_rad - math.atan2(-origin[1], -origin[0]))) < math.radians(6)
    # The failed leg, at 240 degrees seen from the body, trails.
    trailing_rad = log.frame.yaw_rad + math.radians(240)
    assert abs(wrapped_rad(trailing_rad + math.pi - heading_rad)) < math.radians(4)
    along = np.array([math.cos(heading_rad), math.sin(heading_rad)])
    moved = positions[-1] - origin
    assert result.distance_m == pytest.approx(float(moved @ along))
    assert result.deviation is not None
    assert result.deviation.signed == pytest.approx(float(along[0] * moved[1] - along[1] * moved[0]))


def test_a_walk_that_leaves_is_cut_short_and_the_next_one_aims_back(robot: Guard) -> None:
    """The arena is much smaller than the walk."""
    arena = Arena(home_m=(0.0, 0.0), radius_m=0.6)
    runner = runner_of(robot, arena=arena)
    first = runner.walk(1, 17, SPACE.slots_of(17)).result
    assert (first.status, first.stopped, first.valid) == ("cut_short", "arena", False)
    assert 0 < first.duration_s < PLAN.duration_s
    edge_m = arena.distance_m(place_of(robot))
    assert 0.4 < edge_m < arena.radius_m + MARGIN_M
    second = runner.walk(2, 17, SPACE.slots_of(17)).result
    assert second.distance_m is not None
    assert second.distance_m > edge_m, "it came through the middle"
    assert StayingSim.farthest_m < arena.radius_m + MARGIN_M


@pytest.mark.parametrize("self_rotation", ["front", "none"])
def test_other_self_rotations_stay_in_it_too(self_rotation: str, robot: Guard) -> None:
    plan = replace(PLAN, self_rotation=self_rotation, heading_rad=math.radians(20))
    runner = runner_of(robot, plan, arena=ARENA)
    for index in (1, 2):
        result = runner.walk(index, 17, SPACE.slots_of(17)).result
        assert result.status != "fell"
    assert StayingSim.farthest_m < ARENA.radius_m + MARGIN_M


def test_without_an_arena_every_trial_begins_where_the_last_ended(robot: Guard) -> None:
    runner = runner_of(robot, replace(PLAN, duration_s=3.0))
    places = []
    for index in (1, 2):
        runner.walk(index, 17, SPACE.slots_of(17))
        places.append(place_of(robot))
    assert np.hypot(*(places[1] - places[0])[:2]) > 0.1
    assert runner.servos.stopped is None


def test_a_robot_left_behind_is_found_where_it_was(robot: Guard) -> None:
    runner_of(robot, replace(PLAN, duration_s=3.0)).walk(1, 17, SPACE.slots_of(17))
    before = place_of(robot)
    robot.close()
    with Guard(StayingSim(ROBOT)) as again:
        assert np.allclose(before, place_of(again), atol=0.01)


def test_a_robot_without_a_position_is_refused_unless_an_operator_measures() -> None:
    servos = PosedMock(ROBOT)
    servos.position_world = servos.quaternion_world = None
    with Guard(servos) as guard:
        with pytest.raises(RobotFaultError, match=r"knows no position.*with ask$"):
            await_ready(guard)
        assert await_ready(guard, needs_pose=False).base_position_world is None
    assert not servos.sent, "nothing moved"


def test_a_pose_may_be_a_moment_late() -> None:
    servos = PosedMock(ROBOT)
    known, servos.position_world = servos.position_world, None
    began_s = servos.time.now_s

    class Late(Guard):
        def read(self) -> Any:
            if servos.time.now_s > began_s + 0.5:
                servos.position_world = known
            return super().read()

    with Late(servos) as guard:
        assert await_ready(guard).base_position_world is not None


def test_a_robot_that_lies_on_its_side_is_not_walked_and_not_scored() -> None:
    servos = PosedMock(ROBOT)
    servos.lean(85.0)
    with Guard(servos) as guard, pytest.raises(RobotStoppedError, match="stopped: fell") as raised:
        runner_of(guard, arena=ARENA).walk(1, 17, SPACE.slots_of(17))
    assert raised.value.reason == "fell"
    assert not servos.sent


def test_a_fall_on_the_way_to_the_start_is_not_the_gaits_fault() -> None:
    servos = PosedMock(ROBOT)
    with FallsAfter(servos, 3.0) as guard:
        walked = runner_of(guard, arena=ARENA).walk(1, 17, SPACE.slots_of(17))
    assert (walked.result.status, walked.result.stopped, walked.recording) == ("aborted", "fell", None)


def test_a_robot_that_sat_down_between_trials_is_stood_up_from_there() -> None:
    servos = PosedMock(ROBOT)
    with Guard(servos) as guard:
        runner = runner_of(guard, replace(PLAN, duration_s=0.5, self_rotation="none"))
        runner.walk(1, 17, SPACE.slots_of(17))
        sat_rad = ROBOT.stance_angles_rad + 0.4
        servos.joints_rad = sat_rad
        servos.sent.clear()
        runner.walk(2, 17, SPACE.slots_of(17))
    steps = np.abs(servos.sent[0].joint_positions_rad - sat_rad)
    assert steps.max() < 0.1, "the first command is near where the joints are"


def test_after_a_trial_silence_is_no_failure() -> None:
    """A person who measures takes longer than the guard's patience."""
    servos = PosedMock(ROBOT)
    with Guard(servos) as guard:
        runner_of(guard, replace(PLAN, duration_s=0.5, self_rotation="none")).walk(1, 17, SPACE.slots_of(17))
        assert not guard.expects_commands
        servos.time.sleep(60.0)
        guard.read()
        assert guard.stopped is None


class HeatedMock(PosedMock):
    """A robot whose hottest servo cools down by a degree in ten seconds, once it sits without torque."""

    def __init__(self) -> None:
        super().__init__()
        self.hottest_c: float | None = 58.0
        self.limp = False

    def read(self) -> RobotState:
        """The state, with the temperatures of the servos."""
        state = super().read()
        if self.limp and self.hottest_c is not None:
            self.hottest_c -= 0.1 * self.clock.period_s
        temperatures_c = np.full(18, 35.0 if self.hottest_c is not None else np.nan)
        temperatures_c[13] = math.nan if self.hottest_c is None else self.hottest_c
        unknown = np.full(18, np.nan)
        return replace(
            state,
            servos=ServoReadings(
                ages_s=np.zeros(18),
                efforts=unknown,
                currents_a=unknown,
                voltages_v=unknown,
                temperatures_c=temperatures_c,
            ),
        )

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
        assert servos.hottest_c == pytest.approx(50.0, abs=0.1)
        np.testing.assert_allclose(servos.read().joint_positions_rad, sitting_angles_rad(ROBOT), atol=1e-9)
        assert guard.clock.now_s == pytest.approx(82.0, abs=2.0)
        assert notes[0] == "cooling down below 50 C: leg5_femur 58 C"
        assert notes[1:] == ["still cooling down: leg5_femur 52 C"]
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
        with pytest.raises(RobotFaultError, match=r"not below 30 C after 1 min: leg5_femur 52 C"):
            cool_down(guard, 30.0, lambda: False, notes.append)


def test_cooling_down_ends_with_a_requested_stop_and_needs_temperatures() -> None:
    servos = HeatedMock()
    with Guard(servos, expiry_s=1.0) as guard:
        cool_down(guard, 30.0, lambda: guard.clock.now_s > 5.0, lambda _text: None)
        assert guard.clock.now_s < 6.0
        servos.hottest_c = None
        with pytest.raises(InputError, match="tells no temperatures"):
            cool_down(guard, 30.0, lambda: False, lambda _text: None)


def test_every_trial_waits_until_the_servos_are_cool() -> None:
    servos = HeatedMock()
    plan = replace(PLAN, duration_s=2.0)
    with Guard(servos, expiry_s=1.0) as guard:
        runner = runner_of(guard, plan)
        spec = replace(runner.runner.spec, cool_down_c=50.0)
        cooled = replace(runner, runner=replace(runner.runner, spec=spec))
        cooled.walk(1, 17, SPACE.slots_of(17))
        assert servos.hottest_c is not None
        assert servos.hottest_c < 50.1
        assert guard.clock.now_s > 80.0
