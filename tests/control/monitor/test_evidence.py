"""What a monitor is made of: joints that follow or weaken, legs that carry, kinds of failures and trials."""

from collections.abc import Callable

import numpy as np
import pytest

from hexctl.control.monitor.dead_legs import DeadLegs
from hexctl.control.monitor.joint_following import JointFollowing
from hexctl.control.monitor.joint_stiffness import BLOCK_TICKS, JointStiffness
from hexctl.control.monitor.leg_probe import FIRST_CYCLES, LATER, LegProbe
from hexctl.control.monitor.leg_support import LegSupport
from hexctl.control.monitor.phase_habit import cycle_parts
from hexctl.control.monitor.recent_motion import STILL_CYCLES, LegMotion, RecentMotion, failure_shown
from hexctl.types import BoolArray, FloatArray, RobotState

TICKS_PER_CYCLE = 50


def _rho(off_rad: FloatArray, torques_nm: FloatArray, *, from_tick: int = 300) -> FloatArray:
    """Greatest rho of each joint from a tick on, (18,), of joints that are off by angles, (T, 18)."""
    following = JointFollowing((), 0.02, np.array(1 / TICKS_PER_CYCLE), np.full(18, 2.0))
    greatest = np.zeros(18)
    for tick in range(len(off_rad)):
        phases = (tick / TICKS_PER_CYCLE + np.arange(6) / 6) % 1
        targets = 0.25 * min(1.0, tick / 100) * np.repeat(np.sin(2 * np.pi * phases), 3)
        state = RobotState(targets + off_rad[tick], 0.0, True, joint_torques_nm=torques_nm[tick])
        following.update(state, cycle_parts(phases), np.abs(torques_nm[tick]))
        following.sent(targets, 0.0)
        if tick >= from_tick:
            greatest = np.maximum(greatest, following.rho)
    return greatest


def _legs_standing(ticks: int) -> FloatArray:
    phases = (np.arange(ticks)[:, np.newaxis] / TICKS_PER_CYCLE + np.arange(6) / 6) % 1
    return np.repeat((phases < 1 / 3) | (phases >= 2 / 3), 3, axis=1)


def test_a_load_that_all_servos_give_in_to_is_no_failure() -> None:
    """The legs stand with all the torque they have; then one of them gives in."""
    ticks = 600
    standing = _legs_standing(ticks)
    torques = np.where(standing, 1.0, 0.2)
    off = np.zeros((ticks, 18))
    off[300:, 4] = np.where(standing[300:, 4], -0.3, 0.0)
    assert _rho(off, torques).max() < 0.15
    spared = np.where(standing, 0.4, 0.2)
    spared[:50] = 1.0
    assert _rho(off, spared)[4] > 0.3, "with torque to spare the same is one"


def test_a_jam_takes_more_than_other_servos_ever_gave() -> None:
    ticks = 600
    torques, off = np.where(_legs_standing(ticks), 1.0, 0.2), np.zeros((ticks, 18))
    off[300:, 4], torques[300:, 4] = -0.3, 1.6
    assert _rho(off, torques)[4] > 0.8


def test_a_joint_that_always_needs_all_its_servo_to_swing_may_get_caught_for_a_cycle() -> None:
    """Friction and a servo with a fifth of its torque: a foot that catches stays where it is for a while."""
    ticks = 1000
    standing = _legs_standing(ticks)
    torques, off = np.where(standing, 1.0, 0.2), np.zeros((ticks, 18))
    caught = slice(800, 800 + TICKS_PER_CYCLE)
    off[caught, 4], torques[caught, 4] = np.where(standing[caught, 4], 0.0, -0.3), 1.0
    assert _rho(off, torques)[4] > 0.5, "one that swung with ease before is jammed"
    torques[:, 4] = 1.0
    assert _rho(off, torques)[4] < 0.1


def test_a_joint_that_is_late_as_usual_is_not_off_its_target() -> None:
    """A servo with damping or dead time gives no torque while it moves as fast as its target."""
    late_ticks, fails, limp = 5, 400, 4
    following = JointFollowing((), 0.02, np.array(1 / TICKS_PER_CYCLE), np.full(18, 2.0))
    sent = [np.zeros(18)] * late_ticks
    off_rad: list[FloatArray] = []
    for tick in range(600):
        phases = (tick / TICKS_PER_CYCLE + np.arange(6) / 6) % 1
        measured = sent[-late_ticks].copy()
        measured[limp] *= tick < fails
        following.update(RobotState(measured, 0.0, True), cycle_parts(phases))
        off_rad.append(following.off_rad(measured))
        sent.append(0.25 * min(1.0, tick / 100) * np.repeat(np.sin(2 * np.pi * phases), 3))
        following.sent(sent[-1], 0.0)
    off_deg = np.degrees(off_rad[fails:])
    assert np.delete(off_deg, limp, axis=1).max() < 2
    assert np.mean(off_deg[:, limp] > 2) > 0.8


def _missing(
    change: Callable[[int, BoolArray, FloatArray], FloatArray | None],
    *,
    ticks: int,
    from_tick: int,
    support: LegSupport | None = None,
) -> FloatArray:
    """Most that each leg misses of its load from a tick on, (6,).

    `change` changes contacts and torques of a tick and returns the torques that are told.
    """
    support = support or LegSupport((), np.array(1 / TICKS_PER_CYCLE))
    most = np.zeros(6)
    for tick in range(ticks):
        phases = (tick / TICKS_PER_CYCLE + np.arange(6) / 6) % 1
        contacts = (phases < 1 / 3) | (phases >= 2 / 3)
        torques = change(tick, contacts, np.repeat(np.where(contacts, 0.5, 0.0), 3))
        state = RobotState(np.zeros(18), 0.0, True, None, None, contacts, joint_torques_nm=torques)
        size = None if torques is None else np.abs(torques)
        support.update(state, cycle_parts(phases), size_nm=size)
        most = np.maximum(most, support.missing) if tick > from_tick else most
    return most


def test_a_foot_on_the_floor_is_there_whatever_the_torques_say() -> None:
    """Torques that vanish while the foot touches as always: another part of the body carries for a while."""

    def change(tick: int, contacts: BoolArray, torques: FloatArray) -> FloatArray:
        if tick >= 600:
            torques[:6], contacts[0] = 0.0, False
        return torques

    most = _missing(change, ticks=700, from_tick=600)
    assert most[0] > 0.95  # neither load nor contact
    assert 0.3 < most[1] < 0.6


def test_a_tick_without_torques_is_no_tick_without_load() -> None:
    """Contacts are no torques: where these are missing for a while, what was learned of them is kept."""
    support = LegSupport((), np.float64(1 / TICKS_PER_CYCLE))  # type: ignore[arg-type]

    def change(tick: int, _contacts: BoolArray, torques: FloatArray) -> FloatArray | None:
        assert support.known == (tick > 0 and not 300 < tick <= 350)  # of the tick before
        return None if 300 <= tick < 350 else 10 * torques

    assert _missing(change, ticks=400, from_tick=250, support=support).max() < 0.5
    support = LegSupport((), np.array(0.02))
    support.update(RobotState(np.zeros(18), 0.0, True), cycle_parts(np.zeros(6)))
    assert not support.known, "neither contacts nor torques"
    assert (support.missing == 0).all()


def test_a_normalised_time_that_rounds_to_one_is_in_the_last_part() -> None:
    assert cycle_parts(np.array([0.0, 0.0833, 0.0834, 0.51, 0.999, 1.0])).tolist() == [0, 0, 1, 6, 11, 11]


NONE_NM = np.full(3, 0.005)


def _motion(gains: tuple[float, float, float], torques_nm: tuple[float, float, float] | None) -> LegMotion:
    """Leg 3 of a robot whose targets go over half a sine, which its joints follow with gains."""
    recent = RecentMotion((), np.asarray(1 / TICKS_PER_CYCLE))
    targets = np.zeros(18)
    torques = None if torques_nm is None else np.tile(torques_nm, 6)
    for tick in range(3 * TICKS_PER_CYCLE):
        recent.measured(np.tile(gains, 6) * targets, torques)
        targets = np.full(18, np.radians(20) * np.sin(2 * np.pi * (tick + 13) / TICKS_PER_CYCLE))
        recent.sent(targets)
    recent.measured(np.tile(gains, 6) * targets, torques)
    return recent.of_leg(3)


@pytest.mark.parametrize(
    ("gains", "torques_nm", "follows", "kind", "joint"),
    [
        ((1, 1, 1), (0.0, 0.0, 0.0), True, "missing", None),
        ((1, 1, 1), None, True, "missing", None),
        ((0, 0, 0), (0.5, 0.5, 0.5), False, "locked", None),
        ((0, 0, 0), None, False, "locked", None),
        ((-0.5, -0.5, -0.5), (0.0, 0.0, 0.0), False, "limp", None),
        ((1, 0, 1), (0.5, 0.5, 0.5), False, "stuck", "femur"),
        ((1, 0, 1), None, False, "stuck", "femur"),
        ((1, 1, -0.5), (0.5, 0.5, 0.0), False, "limp", "tibia"),
        ((-0.5, 1, 1), None, False, "limp", "coxa"),
    ],
)
def test_the_kind_of_a_failure(
    gains: tuple[float, float, float],
    torques_nm: tuple[float, float, float] | None,
    follows: bool,
    kind: str,
    joint: str | None,
) -> None:
    rho = 1 - np.array(gains)
    found = failure_shown(3, _motion(gains, torques_nm), rho, follows=follows, none_nm=NONE_NM)
    assert (found.leg, found.kind, found.joint) == (3, kind, joint)


def test_a_leg_that_has_power_is_not_limp() -> None:
    """Later on a leg in the air needs no torque, which then says nothing."""
    motion, rho = _motion((0, 0, 0), (0.0, 0.0, 0.0)), np.ones(3)
    found = failure_shown(3, motion, rho, follows=False, none_nm=NONE_NM, powered=True)
    assert found.kind == "locked"
    motion = _motion((1, 1, 1), None)
    assert motion.measured_rad.shape == (round(STILL_CYCLES * TICKS_PER_CYCLE), 3)
    assert motion.measured_rad == pytest.approx(motion.targets_rad), "targets from before the measurement"


CYCLE = 50.0


def _tries(gains: tuple[float, float, float], *, moves: bool = True, steps: int = 1200) -> list[int]:
    """Steps at which a leg counts as whole whose joints make a part of what they are asked for."""
    probe, whole, lagged = LegProbe(100, CYCLE, moves=moves), [], np.zeros(3)
    for step in range(100, 100 + steps):
        targets = probe.offset_m(step, 1.0) * np.array([5.0, 5.0, 8.0])
        lagged += 0.5 * (targets - lagged)
        if probe.whole(step, targets, np.array(gains) * lagged + 0.002):
            whole.append(step)
    return whole


def test_a_tucked_leg_is_whole_once_all_its_joints_follow_a_try() -> None:
    assert _tries((0.95, 1.0, 0.9))[0] == pytest.approx(100 + (FIRST_CYCLES + 1) * CYCLE, abs=2)
    for gains in ((0.0, 0.0, 0.0), (1.0, 1.0, 0.0), (1.0, 0.3, 1.0), (-1.0, 1.0, 1.0)):
        assert _tries(gains) == []


def test_a_leg_whose_joints_cannot_tell_is_put_down_when_it_is_time() -> None:
    first, second = _tries((1.0, 1.0, 1.0), moves=False, steps=900)[:2]
    assert first == 100 + FIRST_CYCLES * CYCLE
    assert second == pytest.approx(first + LATER * FIRST_CYCLES * CYCLE, abs=2)


# Springs between targets and angles: a servo with part of its torque is a softer spring


STRIDE_TICKS, WEAKENS, WALKED = 55, 8 * 55, 10 * 55
HURRIES = 3 * STRIDE_TICKS
LIMITS_NM, STIFFNESS = np.full(18, 2.0), 20.0


def _walk(
    joint: int,
    share: float,
    weakens: int = WEAKENS,
    limit_nm: float = 2.0,
    shape: tuple[int, ...] = (),
    turns: int = WALKED,
    haste: float = 1.0,
) -> list[tuple[int, int, float]]:
    """Joints found weak: tick, joint and share of the first robot; others of a batch stay intact.

    Joints move backwards from the tick `turns` on, and at a multiple of their pace from `HURRIES` on.
    """
    random, joints = np.random.default_rng(2), (*shape, 18)
    motion = RecentMotion(shape, np.full(shape, 1 / STRIDE_TICKS))
    stiffness = JointStiffness(shape, LIMITS_NM)
    phases, sent, found = random.uniform(0, 6, 18), np.zeros((4, 18)), []
    for tick in range(WALKED):
        ticks = turns - abs(tick - turns) + (haste - 1) * max(0, tick - HURRIES)
        cycle = 2 * np.pi * ticks / STRIDE_TICKS + phases
        if tick == HURRIES:
            motion.cycles = motion.cycles * haste
        load_nm = 0.5 * (np.sin(cycle + 1) + 0.5 * np.sin(3 * cycle)) ** 3
        shares: FloatArray = np.ones(joints)
        shares[(*[0] * len(shape), joint)] = share if tick >= weakens else 1.0
        off_rad = load_nm / (STIFFNESS * shares) + random.normal(scale=np.radians(0.05), size=18)
        torques_nm = np.clip(load_nm, -limit_nm, limit_nm)
        motion.measured(sent[-2] - off_rad, np.broadcast_to(torques_nm, joints))
        if (tick + 1) % BLOCK_TICKS == 0:
            stiffness.update(motion, 0, np.ones((*shape, 6), dtype=bool))
            places = map(tuple, np.argwhere(stiffness.new))
            found += [(tick, int(place[-1]), float(stiffness.share[place])) for place in places]
        sent = np.concatenate([sent[1:], 0.25 * np.sin(cycle)[np.newaxis]])
        motion.sent(np.broadcast_to(sent[-1], joints))
    return found


@pytest.mark.parametrize(("joint", "share"), [(3, 0.5), (10, 0.3), (17, 0.6)])
def test_a_joint_that_weakens_is_named_with_its_share_within_two_cycles(joint: int, share: float) -> None:
    [(tick, found, measured)] = _walk(joint, share)
    assert found == joint
    assert 0 < tick - WEAKENS <= 2 * STRIDE_TICKS
    assert measured == pytest.approx(share, abs=0.1)


@pytest.mark.parametrize("haste", [1.1, 1.25, 1.5])
def test_a_joint_that_weakens_is_named_at_a_higher_pace(haste: float) -> None:
    [(_, found, measured)] = _walk(10, 0.5, haste=haste)
    assert found == 10
    assert measured == pytest.approx(0.5, abs=0.1)
    assert not _walk(10, 1.0, haste=haste)


def test_a_joint_weak_from_the_first_step_is_compared_with_other_legs() -> None:
    [(_, found, measured)] = _walk(4, 0.3, weakens=0)
    assert found == 4
    assert measured == pytest.approx(0.3, abs=0.1)


def test_joints_that_differ_by_less_than_servos_do_are_left_alone() -> None:
    assert not _walk(4, 0.9) + _walk(4, 0.7, weakens=0)


def test_servos_at_their_limits_are_not_weak() -> None:
    """Overloaded, the distance from the target grows with no torque to show for it."""
    assert not _walk(4, 1.0, limit_nm=0.2)


def test_another_motion_is_learned_before_it_is_judged() -> None:
    assert not _walk(3, 0.5, turns=WEAKENS)


def test_a_robot_of_a_batch_is_judged_as_alone() -> None:
    assert _walk(10, 0.5, shape=(2,)) == _walk(10, 0.5)


def test_a_dead_leg_that_is_put_down_again_starts_anew() -> None:
    dead = DeadLegs((), 0.02, np.array(1 / TICKS_PER_CYCLE))
    state = RobotState(np.zeros(18), 0.0, True)
    for _ in range(100):
        dead.update(state, np.arange(18) < 3, None)
    assert dead.idle[0] > 1
    dead.forget(1)
    dead.update(state, np.zeros(18, dtype=bool), None)
    assert not dead.idle.any()
