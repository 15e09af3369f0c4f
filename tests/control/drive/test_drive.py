"""`hexctl.Drive` in simulation, on simulated time; and whose command it follows."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexctl import Drive, EStopError, Failure, Guard, InputError, Recorders, RobotState, SimServos, Velocity
from hexctl.backends.base import simulation_of
from hexctl.backends.mock import MockServos
from hexctl.control.drive.arbiter import SOURCES, ZERO, Arbiter, Decision
from hexctl.control.monitor.recovery import StopWalking
from hexctl.errors import WrongTypeError
from hexctl.gait.body_pose import BodyPose
from hexctl.gait.posture import STANCE
from hexctl.robot.failure_grammar import parse_failure_event, parse_healing
from hexctl.robot.rotations import yaw_rad
from hexctl.types import FloatArray
from tests.backends.fake_time import FakeTime
from tests.control.posed import Faulty
from tests.robots import shipped


def walked(drive: Drive, seconds: float) -> FloatArray:
    """How far it gets in a time: forward and left in the frame of the body at the start in m, turn in rad."""
    before = simulation_of(drive.guard).true_pose
    assert before is not None
    for _ in range(round(seconds / 0.02)):
        drive.step()
    after = simulation_of(drive.guard).true_pose
    assert after is not None
    yaw = float(yaw_rad(before[1]))
    moved = ((after[0] - before[0])[:2] @ np.array([1, 1j])) * np.exp(-1j * yaw)
    turned = (float(yaw_rad(after[1])) - yaw + np.pi) % (2 * np.pi) - np.pi
    return np.array([moved.real, moved.imag, turned])


def height_m(drive: Drive) -> float:
    """The height of the body as it is read in one more step."""
    position = drive.step().base_position_world
    assert position is not None
    return float(position[2])


@pytest.mark.slow
def test_it_walks_where_it_is_told_and_stands_when_it_is_not() -> None:
    with Drive("ant") as drive:
        drive.reset()
        drive.command(forward_m_s=0.1)
        forward = walked(drive, 5.0)
        assert forward[0] > 0.4
        drive.command(left_m_s=0.1)
        assert walked(drive, 5.0)[1] > 0.4
        drive.command(turn_rad_s=0.4)
        assert walked(drive, 4.0)[2] > 1.2
        drive.command()
        walked(drive, 0.3)
        assert drive.at_rest
        assert np.abs(walked(drive, 2.0)).max() < 0.005


def test_reset_brings_a_simulation_back_to_where_it_was_put_down() -> None:
    with Drive("ant") as drive:
        first = drive.reset()
        drive.command(forward_m_s=0.1)
        walked(drive, 2.0)
        again = drive.reset()
        assert drive.mode == "driving"
        np.testing.assert_array_equal(first.joint_positions_rad, again.joint_positions_rad)
        np.testing.assert_array_equal(first.base_position_world, again.base_position_world)
        assert np.abs(walked(drive, 1.0)).max() < 0.005


@pytest.mark.slow
def test_a_leg_dies_and_the_command_still_means_forward() -> None:
    with Drive("ant") as drive:
        drive.reset()
        drive.command(forward_m_s=0.1)
        walked(drive, 4.0)
        assert not drive.noticed
        simulation_of(drive.guard).change_leg(3, Failure(leg=3, kind="limp"))
        walked(drive, 4.0)
        assert [one.failure.leg for one in drive.noticed] == [3]
        assert 3 in drive.gait_now.posture.tucked_legs
        forward, left, _ = walked(drive, 5.0)
        assert forward > 0.35
        assert abs(left) < 0.15


def test_events_of_a_simulation_count_from_when_the_robot_first_stands() -> None:
    events = (parse_failure_event("3:limp@0.5"), parse_healing("3@1"))
    with Drive("ant", events=events, recovery="walk-on") as drive:
        for _ in range(2):  # and again after a reset
            drive.reset()
            broken = []
            for _ in range(75):
                drive.step()
                broken.append(bool(simulation_of(drive.guard).failures))
            changes = np.flatnonzero(np.diff(broken)).tolist()
            assert changes[1] - changes[0] == 25
            assert changes[0] == pytest.approx(25, abs=2)
            drive.sit()
            while drive.mode != "sitting":
                drive.step()
            drive.stand()
            while drive.mode != "driving":
                drive.step()
            drive.step()
            assert not simulation_of(drive.guard).failures


@pytest.mark.slow
def test_where_the_recovery_stops_the_robot_it_stands_until_told_to_stand() -> None:
    with Drive("ant", recovery="stop") as drive:
        drive.reset()
        drive.command(forward_m_s=0.1)
        walked(drive, 4.0)
        simulation_of(drive.guard).change_leg(3, Failure(leg=3, kind="limp"))
        walked(drive, 4.0)
        assert drive.stopped == "leg 3 limp"
        assert drive.at_rest
        drive.stand()
        assert drive.stopped is None
        walked(drive, 3.0)
        drive.command(forward_m_s=0.1)
        walked(drive, 3.0)
        assert drive.velocity.forward_m_s > 0.05


@pytest.mark.slow
def test_it_sits_down_and_stands_up_again() -> None:
    with Drive("ant") as drive:
        drive.reset()
        drive.command(forward_m_s=0.1)
        walked(drive, 1.5)
        standing_m = height_m(drive)
        drive.sit()
        walked(drive, 5.0)
        assert drive.mode == "sitting"
        assert height_m(drive) < 0.75 * standing_m
        drive.command(forward_m_s=0.1)
        assert np.abs(walked(drive, 2.0)).max() < 0.01
        drive.stand()
        drive.command(forward_m_s=0.1)
        walked(drive, 2.1)
        assert drive.mode == "driving"
        assert walked(drive, 3.0)[0] > 0.2


@pytest.mark.slow
def test_gait_and_height_change_in_stride() -> None:
    with Drive("ant", body_raise=0.05) as drive:
        drive.reset()
        walked(drive, 2.5)
        raised_m = height_m(drive)
        drive.gait = replace(drive.gait, posture=STANCE)
        walked(drive, 2.5)
        assert raised_m - height_m(drive) > 0.03
        drive.command(forward_m_s=0.08)
        drive.gait = "wave"
        walked(drive, 4.0)
        assert drive.gait.slots == (4, 5, 6, 3, 2, 1)
        assert walked(drive, 3.0)[0] > 0.15
        with pytest.raises(InputError, match="gait"):
            drive.gait = "trot"


def test_the_body_moves_over_its_feet_a_stop_stops_it_and_a_clear_moves_nothing() -> None:
    with Drive("ant") as drive:
        drive.reset()
        drive.pose_body(BodyPose(roll_rad=0.1, up_m=0.02))
        walked(drive, 1.0)
        body = drive.step().base_quaternion_world
        assert body is not None
        assert 2 * body[1] == pytest.approx(0.1, abs=0.005)
        drive.command(forward_m_s=0.08)
        assert walked(drive, 3.0)[0] > 0.15
        drive.arbiter.source("gamepad").command(Velocity())
        drive.arbiter.pose(BodyPose(roll_rad=0.2), "keyboard")  # which is not followed
        drive.step()
        assert drive.body_goal == BodyPose(roll_rad=0.1, up_m=0.02)
        drive.pose_body(BodyPose(pitch_rad=1.0))
        for _ in range(5):
            drive.step()
        assert 0 < drive.pose_share < 1
        drive.stop()
        drive.step()
        there = drive.body_pose
        drive.pose_body()
        walked(drive, 1.0)
        drive.arbiter.clear()
        walked(drive, 0.5)
        assert drive.body_pose == there
        assert there.pitch_rad > 0.01
        drive.stand()
        walked(drive, 1.0)
        assert drive.body_pose == BodyPose()
        with pytest.raises(InputError, match="body pose: got "):
            drive.pose_body(0.1)  # type: ignore[arg-type]


@pytest.mark.parametrize("moment", [0, 40, 131, 178, 209, 262, 340, 420])
def test_a_stop_freezes_every_joint_at_any_moment_and_a_stand_brings_all_feet_home(moment: int) -> None:
    with Drive(servos=MockServos("ant", clock=FakeTime().clock())) as drive:
        for tick in range(moment):
            if tick % 110 == 0:
                drive.stand()  # also in mid-stride: the next command outweighs it
            drive.command(forward_m_s=0.08, turn_rad_s=0.1)
            if tick == 200:
                drive.pose_body(BodyPose(roll_rad=0.2, up_m=0.02))
            if tick == 250:
                drive.gait = replace(drive.gait, posture=replace(STANCE, body_raise=0.03))
            if tick == 331:
                drive.sit()
            drive.step()
        drive.stop("button")
        frozen_rad = drive.guard.accepted_rad().copy()
        for _ in range(60):
            drive.command(forward_m_s=0.1)
            drive.pose_body(BodyPose(roll_rad=0.1))
            drive.step()
            np.testing.assert_array_equal(drive.guard.accepted_rad(), frozen_rad)
        assert drive.at_rest
        assert drive.velocity == Velocity()
        drive.stand()
        drive.gait = replace(drive.gait, posture=STANCE)
        for _ in range(350):
            before_rad = drive.guard.accepted_rad().copy()
            drive.step()
            assert np.abs(drive.guard.accepted_rad() - before_rad).max() < 0.15
        assert drive.guard.counters.clipped == 0
        np.testing.assert_allclose(drive.guard.accepted_rad(), drive.robot.stance_angles_rad, atol=0.03)


def test_a_stop_for_a_stand_puts_all_feet_down_unless_another_freezes_them() -> None:
    for freezes in (False, True):
        with Drive(servos=MockServos("ant", clock=FakeTime().clock())) as drive:
            drive.command(forward_m_s=0.1)
            for _ in range(150):
                drive.step()
            in_stride_rad = drive.guard.accepted_rad().copy()
            drive.arbiter.stop("leg 3 limp", stands=True)
            if freezes:
                drive.stop("button")
            drive.arbiter.stop("end", stands=True)
            for _ in range(10):
                drive.step()
            assert drive.at_rest
            assert drive.stopped == "leg 3 limp"
            moved_rad = np.abs(drive.guard.accepted_rad() - in_stride_rad).max()
            assert (moved_rad == 0) == freezes


def test_sources_outweigh_the_program_a_stop_outweighs_them_and_ticks_are_recorded() -> None:
    recorders = Recorders()
    with Drive("ant", recorders=recorders) as drive:
        drive.reset()
        drive.command(forward_m_s=0.1)
        walked(drive, 1.5)
        assert recorders.log["velocity_body"][-1].tolist() == pytest.approx([0.1, 0, 0], abs=0.005)
        drive.arbiter.source("page").command(Velocity(left_m_s=0.1))
        walked(drive, 0.1)
        assert drive.decision.source == "page"
        drive.stop("button")
        walked(drive, 0.5)
        assert drive.at_rest
        assert drive.stopped == "button"
        drive.guard.stop("pulled")
        with pytest.raises(EStopError):
            drive.step()
        assert drive.stopped == "pulled"
        drive.reset()
        drive.step()


def test_a_real_robot_stops_when_a_leg_fails_unless_told_otherwise() -> None:
    drive = Drive(servos=MockServos(shipped()))
    assert isinstance(drive._recovery, StopWalking)


def test_what_is_not_allowed_is_refused_before_anything_is_opened() -> None:
    for options, named in (
        ({"backend": "mock", "world": "rough"}, "world"),
        ({"recovery": "pray"}, "recovery"),
        ({"hold": "line"}, "hold"),
    ):
        with pytest.raises(InputError, match=named):
            Drive("ant", **options)  # type: ignore[arg-type]
    with pytest.raises(InputError):
        Drive("ant", servos=Guard(SimServos("ant")))
    with pytest.raises(InputError):
        Drive("ant").step()


def test_a_leg_that_is_known_to_have_failed_is_not_walked_on() -> None:
    with Drive("ant", failure=Failure(leg=1)) as drive:
        drive.reset()
        assert 1 in drive.gait_now.posture.tucked_legs
        drive.command(forward_m_s=0.08)
        walked(drive, 3.0)
        assert walked(drive, 3.0)[0] == pytest.approx(0.24, rel=0.15)
        drive.gait = "wave"
        assert 1 in drive.gait_now.posture.tucked_legs
        assert not drive.noticed


def test_one_wild_reading_of_a_joint_neither_stops_a_walk_nor_accuses_a_leg() -> None:
    reads = iter(range(1000))

    def wild_once(state: RobotState, _time_s: float) -> RobotState:
        state.joint_positions_rad[4] += 1.5 * (next(reads) == 217)
        return state

    with Drive(servos=Faulty(SimServos("ant"), wild_once), recovery="stop") as drive:
        drive.command(forward_m_s=drive.share(forward=0.8).forward_m_s)
        for _ in range(280):
            drive.step()
        assert not drive.noticed
        assert drive.stopped is None
        assert drive.velocity.forward_m_s > 0


# Whose command the robot follows


class Time:
    """A clock that the test sets, in whole milliseconds so that sums are exact."""

    ms = 0

    def __call__(self) -> float:
        return self.ms / 1000


FORWARD = Velocity(forward_m_s=0.1)


#: What happens: a source commands or lets go, or time passes, or the stop is pressed or cleared.
EVENTS = st.lists(
    st.one_of(
        st.tuples(st.just("command"), st.sampled_from(SOURCES), st.integers(1, 9)),
        st.tuples(st.just("release"), st.sampled_from(SOURCES), st.just(0)),
        st.tuples(st.just("wait"), st.just(""), st.integers(1, 700)),
        st.tuples(st.sampled_from(["stop", "clear"]), st.just(""), st.just(0)),
    ),
    max_size=30,
)


@given(EVENTS)
def test_the_highest_source_that_spoke_lately_is_followed_and_a_stop_outweighs_all(
    events: list[tuple[str, str, int]],
) -> None:
    time = Time()
    arbiter = Arbiter(time)
    said: dict[str, tuple[int, Velocity]] = {}
    stopped = False
    for kind, name, value in events:
        if kind == "command":
            said[name] = time.ms, Velocity(forward_m_s=float(value))
            arbiter.source(name).command(said[name][1])
        elif kind == "release":
            if name in said:
                said[name] = time.ms, ZERO
            arbiter.source(name).release()
        elif kind == "wait":
            time.ms += value
        elif kind == "stop":
            arbiter.stop()
            stopped = True
        else:
            arbiter.clear()
            said, stopped = {}, False
        fresh = [one for one in SOURCES if one in said and (one == "motion" or time.ms - said[one][0] <= 500)]
        decision = arbiter.decide()
        if stopped:
            assert decision == Decision(stopped="stop", freezes=True)
        elif fresh:
            assert decision == Decision(said[fresh[-1]][1], fresh[-1])
        else:
            assert decision == Decision()


def test_silence_ends_a_command_also_when_the_clock_goes_back_and_the_motion_of_a_program_stays() -> None:
    time = Time()
    time.ms = 1000
    arbiter = Arbiter(time)
    arbiter.source("page").command(FORWARD)
    for ms, decision in ((900, Decision()), (1500, Decision(FORWARD, "page")), (1501, Decision())):
        time.ms = ms
        assert arbiter.decide() == decision
    arbiter.source("motion").command(FORWARD)
    time.ms = 10_000_000
    assert arbiter.decide() == Decision(FORWARD, "motion")


def test_what_was_asked_for_before_a_stop_is_cleared_does_not_move_the_robot() -> None:
    arbiter = Arbiter(Time())
    arbiter.source("motion").command(FORWARD)
    arbiter.stop("leg 3 limp")
    arbiter.stop("later")
    assert arbiter.stopped == "leg 3 limp"
    arbiter.clear()
    assert arbiter.decide() == Decision()


def test_what_is_not_allowed_is_named() -> None:
    for value in (math.nan, math.inf, -math.inf):
        with pytest.raises(InputError, match="turn_rad_s"):
            Velocity(turn_rad_s=value)
    with pytest.raises(InputError, match="source"):
        Arbiter().source("mouse")
    with pytest.raises(InputError, match="expiry_s"):
        Arbiter(expiry_s=0.6)
    with pytest.raises(WrongTypeError, match="velocity"):
        Arbiter().source("page").command(1)  # type: ignore[arg-type]
