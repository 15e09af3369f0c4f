"""The monitor on made-up robots whose joints and feet do exactly what a test says."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hexctl import Failure, RobotState
from hexctl.control.monitor.leg_monitor import LegMonitor, Suspicion
from hexctl.types import BoolArray, FloatArray, leg_slice
from tests.robots import shipped

PERIOD_S, PACE_HZ = 0.02, 0.9


#: Changes measured joints and torques, (18,) each, of a tick.
Breaks = Callable[[FloatArray, FloatArray], None]


def _tripod(cycles: float) -> tuple[FloatArray, BoolArray]:
    """Phases of the legs in a tripod, and which of them stand, (6,) each."""
    phases = (cycles + np.array([0, 0.5, 0, 0.5, 0, 0.5])) % 1
    return phases, (phases < 1 / 3) | (phases >= 2 / 3)


def _targets(cycles: float) -> tuple[FloatArray, FloatArray]:
    """Phases of the legs, (6,), and joint targets, (18,), of a tripod of sines."""
    phases, _ = _tripod(cycles)
    swing = np.radians(15.0) * np.sin(2 * np.pi * phases)[:, np.newaxis] * np.array([1.0, 0.8, 1.2])
    return phases, (shipped().stance_angles_rad.reshape(6, 3) + swing).ravel()


def _walk(
    breaks: Breaks | None,
    *,
    at_cycle: float = 6.0,
    cycles: float = 9.0,
    measured: bool = True,
    efforts: bool = True,
    noise_deg: float = 0.3,
    offset_deg: float = 0.0,
    until_cycle: float = 99.0,
    uneven: bool = False,
    silent: Callable[[float], Sequence[int]] = lambda _cycles: (),
) -> list[tuple[float, Suspicion]]:
    """What a monitor notices, and how many cycles after the failure; silent joints keep their values."""
    robot, rng = shipped(), np.random.default_rng(1)
    pace = np.float64(PACE_HZ)
    monitor = LegMonitor(robot, (), PERIOD_S, pace, uneven=uneven)  # type: ignore[arg-type]
    joints, noticed = robot.stance_angles_rad.copy(), []
    heard, heard_nm = joints.copy(), np.zeros(18)
    offsets = np.radians(offset_deg) * np.array([1, -1, 1] * 6)
    for tick in range(round(cycles / PACE_HZ / PERIOD_S)):
        now = tick * PERIOD_S * PACE_HZ
        _, targets = _targets(now)
        phases, standing = _tripod(now)
        torques = np.where(np.repeat(standing, 3), 0.5, 0.05) + 0.01 * rng.standard_normal(18)
        seen, contacts = joints.copy(), standing.copy()
        if breaks is not None and at_cycle <= now < until_cycle:
            breaks(seen, torques)
            contacts &= np.abs(torques.reshape(6, 3)).max(axis=-1) > 0
        seen += offsets + np.radians(noise_deg) * rng.standard_normal(18)
        stale = np.isin(np.arange(18), list(silent(now - at_cycle)))
        heard, heard_nm = np.where(stale, heard, seen), np.where(stale, heard_nm, torques)
        state = RobotState(
            heard,
            now,
            measured,
            foot_contacts=contacts,
            joint_torques_nm=heard_nm if efforts else None,
            stale_joints=stale if stale.any() else None,
        )
        monitor.update(state, phases)
        if monitor.new.any():
            noticed.append((now - at_cycle, monitor.suspicion(tick)))
        monitor.sent(targets)
        joints += (1 - np.exp(-PERIOD_S / 0.03)) * (targets - joints)
    return noticed


def _held(joints: tuple[int, ...], *, torque_nm: float) -> Breaks:
    """Joints that stay where they are when they break."""
    at: list[FloatArray] = []

    def breaks(seen: FloatArray, torques: FloatArray) -> None:
        at.append(seen[list(joints)].copy())
        seen[list(joints)], torques[list(joints)] = at[0], torque_nm

    return breaks


def _without_load(leg: int) -> Breaks:
    def breaks(_seen: FloatArray, torques: FloatArray) -> None:
        torques[leg_slice(leg)] = 0.0

    return breaks


def test_on_uneven_ground_a_leg_that_is_blocked_for_a_step_is_left_alone_and_a_locked_one_found() -> None:
    locked = _held((6, 7, 8), torque_nm=1.0)
    assert _walk(locked, until_cycle=6.6)[0][1].leg == 3
    assert _walk(locked, until_cycle=6.6, uneven=True) == []
    [(cycles, suspicion)] = _walk(locked, uneven=True)
    assert suspicion.leg == 3
    assert 1.0 < cycles < 2.0


@pytest.mark.parametrize(
    ("efforts", "sag_deg", "kind", "evidence"),
    [
        (True, 0.0, "missing", "support"),
        (False, 0.0, "missing", "support"),
        (True, 9.0, "missing", "effort"),
        (True, 12.0, "limp", "effort"),
    ],
)
def test_a_leg_without_load_is_missing_as_far_as_its_joints_follow(
    efforts: bool, sag_deg: float, kind: str, evidence: str
) -> None:
    def breaks(seen: FloatArray, torques: FloatArray) -> None:
        seen[leg_slice(1)] -= np.radians(sag_deg)
        torques[leg_slice(1)] = 0.0

    ((delay, suspicion),) = _walk(breaks, efforts=efforts)
    assert suspicion.failure == Failure(leg=1, kind=kind)
    assert 0 < delay < 1.5
    assert suspicion.evidence == evidence


@pytest.mark.parametrize("joint", [0, 2])
def test_a_joint_that_sags_without_torque_is_limp_before_it_is_far_off(joint: int) -> None:
    """Its targets it follows nearly as well as before, which alone is no alarm."""

    def sags(seen: FloatArray, torques: FloatArray, *, torque_nm: float = 0.0) -> None:
        seen[joint] -= np.radians(4.0)
        torques[joint] = torque_nm

    ((delay, suspicion),) = _walk(sags)
    assert suspicion.failure == Failure(leg=1, kind="limp", joint=("coxa", "femur", "tibia")[joint])
    assert suspicion.evidence == "effort"
    assert 0 < delay < 1
    assert _walk(lambda seen, torques: sags(seen, torques, torque_nm=0.3)) == []


@pytest.mark.parametrize(("noise_deg", "offset_deg"), [(0.0, 10.0), (1.0, 0.0)])
def test_a_whole_robot_is_left_alone(noise_deg: float, offset_deg: float) -> None:
    assert _walk(None, cycles=25.0, noise_deg=noise_deg, offset_deg=offset_deg) == []


def test_a_joint_at_its_target_needs_no_torque_and_echoed_targets_say_nothing() -> None:
    def rests(_seen: FloatArray, torques: FloatArray) -> None:
        torques[3] = 0.0

    assert _walk(rests, noise_deg=0.0) == []
    assert _walk(_held((0, 1, 2), torque_nm=0.3), measured=False) == []


@pytest.mark.parametrize(("always", "found_after"), [(True, (2.0, 2.5)), (False, None)])
def test_with_echoed_targets_a_leg_without_any_contact_is_missed(
    always: bool, found_after: tuple[float, float] | None
) -> None:
    ticks = iter(range(1000))

    def lifts(_seen: FloatArray, torques: FloatArray) -> None:
        if always or next(ticks) % 50 > 2:  # or it touches the floor once in a while
            torques[leg_slice(3)] = 0.0

    noticed = _walk(lifts, measured=False, efforts=False)
    assert [suspicion.leg for _, suspicion in noticed] == [3] * (found_after is not None)
    assert found_after is None or found_after[0] < noticed[0][0] < found_after[1]


def test_what_a_joint_does_while_the_robot_stands_is_no_jump_when_it_walks_again() -> None:
    """A leg that is put down from its highest place by a halt was accused of a stuck joint."""
    monitor, accused = LegMonitor(shipped(), (), PERIOD_S, np.float64(PACE_HZ)), False  # type: ignore[arg-type]
    stands_at = round(5.75 / PACE_HZ / PERIOD_S)
    for tick in range(stands_at + 60):
        phases, joints = _targets(tick * PERIOD_S * PACE_HZ)
        stands = stands_at <= tick < stands_at + 12
        if not stands:
            joints[11] -= (
                max(0.0, np.sin(2 * np.pi * phases[3])) ** 3
            )  # the tibia of leg 4 lifts its foot high
        state = RobotState(joints, tick * PERIOD_S, measured=True)
        if stands:
            monitor.rests(state)
        else:
            monitor.update(state, phases)
            accused |= bool(monitor.new.any())
        monitor.sent(joints)
    assert not accused


def test_where_many_legs_do_not_follow_or_are_silent_at_once_it_is_the_robot() -> None:
    """A load that is too much for the servos, or the bus."""
    for legs in ((1, 3, 5), (1, 2, 3, 4, 5, 6)):
        joints = tuple(joint for leg in legs for joint in range(3 * leg - 3, 3 * leg))
        assert _walk(_held(joints, torque_nm=0.3)) == []
    assert _walk(None, silent=lambda cycles: [1, 4, 7] if cycles >= 0 else []) == []


def test_a_servo_that_falls_silent_is_noticed_by_that_alone_unless_it_is_for_a_moment() -> None:
    """Whether it still moves its joint, or is limp or stuck, nobody knows."""
    ((delay, suspicion),) = _walk(None, silent=lambda cycles: [13] if cycles >= 0 else [])
    assert (suspicion.failure, suspicion.evidence) == (Failure(leg=5, kind="unknown"), "silence")
    assert 0.4 < delay < 0.6
    shortly = lambda cycles: [4] if cycles >= 0 and cycles % 1.3 < 0.4 else []  # noqa: E731
    assert _walk(None, silent=shortly, cycles=15.0) == []


def test_a_leg_that_fails_once_its_servo_is_heard_again_is_found() -> None:
    joints = (3, 4, 5)
    ((delay, suspicion),) = _walk(
        _held(joints, torque_nm=0.3), silent=lambda cycles: joints if -0.3 < cycles < 0.1 else ()
    )
    assert (suspicion.leg, suspicion.evidence) == (2, "following")
    assert 0 < delay < 1.3


@pytest.mark.parametrize("efforts", [True, False])
@pytest.mark.parametrize(("kind", "torque_nm"), [("locked", 0.3), ("limp", 0.0), ("missing", None)])
def test_a_leg_that_was_dead_before_the_first_step_is_found_within_three_seconds(
    kind: str, torque_nm: float | None, efforts: bool
) -> None:
    breaks = _without_load(5) if torque_nm is None else _held((12, 13, 14), torque_nm=torque_nm)
    ((_, suspicion),) = _walk(breaks, at_cycle=0.0, cycles=3.0 * PACE_HZ, efforts=efforts)
    kinds = {kind} if efforts or kind == "missing" else {"limp", "locked"}
    assert (suspicion.leg, suspicion.failure.kind in kinds) == (5, True)


def test_two_legs_that_are_lost_together_are_both_found() -> None:
    def breaks(_seen: FloatArray, torques: FloatArray) -> None:
        torques[leg_slice(2)] = torques[leg_slice(3)] = 0.0

    noticed = _walk(breaks, cycles=9.0)
    assert {suspicion.leg for _, suspicion in noticed} == {2, 3}
    assert noticed[1][0] < 2


def test_a_batch_sees_what_each_robot_sees_alone() -> None:
    robot, rng = shipped(), np.random.default_rng(2)
    paces = np.array([0.9, 0.7])
    together = LegMonitor(robot, (2,), PERIOD_S, paces)
    alone = [LegMonitor(robot, (), PERIOD_S, pace) for pace in paces]
    for tick in range(600):
        both = [_targets(tick * PERIOD_S * pace) for pace in paces]
        seen = np.stack([targets for _, targets in both]) + 0.02 * rng.standard_normal((2, 18))
        if tick > 300:
            seen[1, 3:6] = robot.stance_angles_rad[3:6]
        torques, contacts = np.abs(rng.standard_normal((2, 18))), rng.random((2, 6)) > 0.3
        together.update(
            RobotState(seen, 0.0, True, None, None, contacts, joint_torques_nm=torques),
            np.stack([phases for phases, _ in both]),
        )
        together.sent(np.stack([targets for _, targets in both]))
        for row, monitor in enumerate(alone):
            state = RobotState(seen[row], 0.0, True, None, None, contacts[row], joint_torques_nm=torques[row])
            monitor.update(state, both[row][0])
            monitor.sent(both[row][1])
            assert (together.ratio[row] == monitor.ratio).all()
            if monitor.new.any():
                assert together.suspicion(tick, (row,)) == monitor.suspicion(tick)
    assert alone[1].failed.tolist() == [False, True, False, False, False, False]


def _noticed_legs(
    monitor: LegMonitor, ticks: int, told: Callable[[int, FloatArray, BoolArray], RobotState]
) -> list[int]:
    """Legs that a monitor accuses on a robot in its stance, whose states a test tells."""
    noticed = []
    for tick in range(ticks):
        phases, standing = _tripod(tick * PERIOD_S * PACE_HZ)
        monitor.update(told(tick, phases, standing), phases)
        noticed += (np.flatnonzero(monitor.new) + 1).tolist()
        monitor.sent(shipped().stance_angles_rad)
    return noticed


def _loaded(standing: BoolArray, **more: Any) -> RobotState:
    torques = np.repeat(np.where(standing, 0.5, 0.05), 3)
    return RobotState(shipped().stance_angles_rad, 0.0, True, **{"joint_torques_nm": torques, **more})


@pytest.mark.parametrize("announced", [True, False])
def test_loads_that_change_with_the_gait_are_learned_anew(announced: bool) -> None:
    monitor = LegMonitor(shipped(), (), PERIOD_S, np.array(PACE_HZ))

    def told(tick: int, phases: FloatArray, standing: BoolArray) -> RobotState:
        if tick >= 400:
            standing[2] &= phases[2] < 0.15  # in this gait it carries in the end of its stance alone
        if tick == 400 and announced:
            monitor.gait_changes(np.array(True))
        return _loaded(standing, foot_contacts=standing)

    assert _noticed_legs(monitor, 700, told) == ([] if announced else [3])


def test_evidence_of_a_sensor_that_falls_silent_grows_old() -> None:
    """It is just short of an alarm when the torques end, and thresholds fall while the walk goes on."""
    monitor = LegMonitor(shipped(), (), PERIOD_S, np.array(PACE_HZ))

    def told(tick: int, _phases: FloatArray, standing: BoolArray) -> RobotState:
        state = _loaded(standing)
        assert state.joint_torques_nm is not None
        state.joint_torques_nm[6:9] *= tick < 150
        silent = monitor.ratio[2] > 0.8 or tick > 400
        return replace(state, joint_torques_nm=None) if silent else state

    assert _noticed_legs(monitor, 900, told) == []
