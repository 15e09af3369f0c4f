"""The body's balance on made-up walks: the body leans to a failed leg, whose foot touches nothing."""

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hexctl import Failure, Guard, RobotState, TrialPlan, make_gait, run_sim_trials
from hexctl.backends.mock import MockServos
from hexctl.control.monitor import leg_monitor, monitored_walk
from hexctl.control.monitor.body_balance import BodyBalance
from hexctl.control.monitor.leg_monitor import LegMonitor
from hexctl.control.monitor.leg_signatures import (
    SENSORS,
    LegSignatures,
    leg_patterns,
    load_signatures,
    save_signatures,
    shipped_signatures,
)
from hexctl.control.monitor.monitored_walk import MonitoredWalk, watched_walk
from hexctl.control.monitor.recovery import WalkOn
from hexctl.control.preparation import prepare
from hexctl.control.trial import planned_walk
from hexctl.errors import InputError
from hexctl.robot.failure_grammar import parse_failure_event
from hexctl.robot.sensors import Sensor
from hexctl.types import BoolArray, FloatArray
from tests.backends.fake_time import FakeTime
from tests.robots import shipped
from tests.trials import sim_trial

PERIOD_S, PACE_HZ = 0.02, 0.9


PHASES = np.array([0, 0.5, 0, 0.5, 0, 0.5])


TRIPOD = make_gait(shipped(), "tripod")


STANDS_OF_TURN = np.array([1.0, 1, 1, 1, 0, 0, 0, 0, 1, 1, 1, 1])  # by parts of a leg's own cycle


def _made_up(seen: str) -> LegSignatures:
    """Signatures of one unit: the body leans to the leg while it should stand, and its foot is in the air."""
    channels = {"lean": 2, "contacts": 8}[seen]
    pattern = np.zeros((1, channels, 12))
    pattern[0, 0] = 0.25 * STANDS_OF_TURN
    pattern[0, 2:3] = -0.25 * STANDS_OF_TURN
    sizes = np.zeros((1, 3 if seen == "lean" else 5))
    return LegSignatures(patterns=pattern, sizes=sizes, biases=np.zeros(1), outputs=np.array([20.0, -12.0]))


def _patterns_of(leg: int, seen: str) -> FloatArray:
    return _made_up(seen).of_leg(shipped(), TRIPOD, leg)


def _balance(
    shape: tuple[int, ...] = (),
    pace_hz: FloatArray | float = PACE_HZ,
    signatures_of: Callable[[str], LegSignatures] = _made_up,
) -> BodyBalance:
    def patterns_of(leg: int, seen: str) -> FloatArray:
        patterns = signatures_of(seen).of_leg(shipped(), TRIPOD, leg)
        return np.broadcast_to(patterns, (*shape, *patterns.shape))

    return BodyBalance(shape, PERIOD_S, np.asarray(PERIOD_S * pace_hz), signatures_of, patterns_of)


def _change(leg: int) -> FloatArray:
    """Change of lean and contacts, (8, 12), if a leg of a tripod carries nothing while it should stand."""
    stands = np.roll(STANDS_OF_TURN, 6 if leg % 2 == 0 else 0)
    foot = shipped().stance_feet_body[leg - 1, :2]
    change = np.zeros((8, 12))
    change[:2] = np.radians(1.5) * (foot / np.linalg.norm(foot))[:, np.newaxis] * stands
    change[1 + leg] = -stands
    return change


def _state(lean: FloatArray, contacts: BoolArray, *, contacts_told: bool = True) -> RobotState:
    """State of a body that is lower ahead and on the left by small angles, (2,), whose joints are echoed."""
    quaternion = np.array([1.0, -lean[1] / 2, lean[0] / 2, 0.0])
    touching = contacts if contacts_told else None
    return RobotState(np.zeros(18), 0.0, False, None, quaternion, touching)


def _walk(
    change: FloatArray | None,
    *,
    at_cycle: float = 8.0,
    cycles: float = 12.0,
    contacts_told: bool = True,
    bump_rad: float = 0.0,
    signatures_of: Callable[[str], LegSignatures] = _made_up,
) -> list[tuple[float, int]]:
    """Cycles after the failure, and legs, of the alarms of a walk that a change (8, 12) comes upon."""
    balance = _balance(signatures_of=signatures_of)
    rng, alarms, bump = np.random.default_rng(3), [], np.zeros(2)
    for tick in range(round(cycles / PERIOD_S / PACE_HZ)):
        now = tick * PERIOD_S * PACE_HZ
        phases = (now + PHASES) % 1
        if tick % 20 == 0:
            bump = bump_rad * rng.standard_normal(2)
        seen = np.concatenate([bump, (phases < 1 / 3) | (phases >= 2 / 3)])
        if change is not None and now >= at_cycle:
            seen += change[:, int(12 * phases[0])]
        seen[:2] += np.radians(0.1) * rng.standard_normal(2)
        balance.update(_state(seen[:2], seen[2:] > 0.5, contacts_told=contacts_told), phases)
        alarms += [(now - at_cycle, leg + 1) for leg in np.flatnonzero(balance.ratio > 1).tolist()]
    return alarms


@pytest.mark.parametrize("seen", SENSORS)
def test_patterns_turn_with_the_leg(seen: str) -> None:
    one, other = (leg_patterns(shipped(), TRIPOD, leg, seen) for leg in (1, 4))
    angle_rad = shipped().mount_yaws_rad[3] - shipped().mount_yaws_rad[0]
    turn = np.array([[np.cos(angle_rad), -np.sin(angle_rad)], [np.sin(angle_rad), np.cos(angle_rad)]])
    lean, feet = np.einsum("ab,kbp->kap", turn, one[:, :2]), np.roll(one[:, 2:], 3, axis=1)
    turned = np.concatenate([lean, feet], axis=1)
    assert np.roll(turned, -6, axis=-1) == pytest.approx(other, abs=1e-3 * np.abs(one).max())


def test_signatures_are_saved_and_loaded(tmp_path: Path) -> None:
    some = shipped_signatures()
    save_signatures(tmp_path / "some.npz", some, {})
    assert (load_signatures(tmp_path / "some.npz")["lean"].patterns == some["lean"].patterns).all()


@pytest.mark.parametrize("reports_load", [True, False])
def test_a_damaged_file_of_signatures_is_refused_before_the_walk_of_servos_without_loads(
    monkeypatch: pytest.MonkeyPatch, reports_load: bool
) -> None:
    def damaged() -> None:
        raise InputError("signatures: damaged")

    plan = TrialPlan(gait=TRIPOD, duration_s=0.5)
    with Guard(MockServos(shipped(), clock=FakeTime().clock())) as guard:
        start = replace(prepare(guard, plan), reports_load=reports_load)
        monkeypatch.setattr(monitored_walk, "shipped_signatures", damaged)
        with nullcontext() if reports_load else pytest.raises(InputError):
            MonitoredWalk(start, planned_walk(start), WalkOn())


@pytest.mark.parametrize(("leg", "contacts_told"), [(1, True), (2, False), (3, True), (6, False)])
def test_a_leg_that_carries_nothing_is_found_within_two_cycles(leg: int, contacts_told: bool) -> None:
    alarms = _walk(_change(leg), contacts_told=contacts_told)
    assert {one for _, one in alarms} == {leg}
    assert 0 < alarms[0][0] < 2.0


def test_a_whole_robot_is_left_alone_on_any_floor() -> None:
    for bump_rad in (0.0, np.radians(1.0)):
        walked = _walk(None, cycles=25.0, bump_rad=bump_rad, signatures_of=shipped_signatures().__getitem__)
        assert walked == []


def test_a_sensor_that_tells_no_lean_accuses_no_leg() -> None:
    balance = _balance()
    for tick in range(800):
        phases = (tick * PERIOD_S * PACE_HZ + PHASES) % 1
        contacts = (phases < 1 / 3) | (phases >= 2 / 3)
        contacts[1] &= tick < 500
        balance.update(RobotState(np.zeros(18), 0.0, False, None, None, contacts), phases)
        assert not balance.ratio.any()


def test_a_batch_sees_what_each_robot_sees_alone() -> None:
    rng, paces = np.random.default_rng(2), np.array([0.9, 0.7])
    cycles = PERIOD_S * paces
    together, alone = _balance((2,), paces), [_balance(pace_hz=pace_hz) for pace_hz in paces]
    alarmed = False
    for tick in range(800):
        phases = (tick * cycles[:, np.newaxis] + PHASES) % 1
        lean = 0.002 * rng.standard_normal((2, 2))
        if tick > 500:
            change = _change(2)[:, int(12 * phases[1, 0])]
            lean[1] += change[:2]
        quaternions = np.stack([np.ones(2), -lean[:, 1] / 2, lean[:, 0] / 2, np.zeros(2)], axis=-1)
        quaternions[tick % 7 == 0, :] = np.nan
        contacts = (phases < 1 / 3) | (phases >= 2 / 3)
        contacts[1, 1] &= tick <= 500
        if tick == 700:
            together.silence(np.array([True, False]))
            alone[0].silence(np.array(True))
        together.update(RobotState(np.zeros((2, 18)), 0.0, False, None, quaternions, contacts), phases)
        for row, one in enumerate(alone):
            state = RobotState(np.zeros(18), 0.0, False, None, quaternions[row], contacts[row])
            one.update(state, phases[row])
            assert (together.ratio[row] == one.ratio).all()
        alarmed |= bool((together.ratio[1] > 1).any())
    assert alarmed


def _drive(monitor: LegMonitor, ticks: range, change: FloatArray | None) -> list[str]:
    """What a monitor says of a walk without contacts whose lean changes."""
    said = []
    for tick in ticks:
        phases = (tick * PERIOD_S * PACE_HZ + PHASES) % 1
        lean = np.zeros(2) if change is None else change[:2, int(12 * phases[0])]
        monitor.update(_state(lean, np.zeros(6, dtype=bool), contacts_told=False), phases)
        if monitor.new.any():
            suspicion = monitor.suspicion(tick)
            assert suspicion.evidence == "balance"
            said.append(str(suspicion))
        monitor.sent(np.zeros(18))
    return said


def test_how_the_leg_failed_stays_unknown_and_it_is_missed_again_after_a_trial(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(leg_monitor, "shipped_signatures", lambda: {seen: _made_up(seen) for seen in SENSORS})
    change = _change(4)
    monitor = LegMonitor(shipped(), (), PERIOD_S, np.array(PACE_HZ), patterns_of=_patterns_of)
    assert _drive(monitor, range(500), None) == []
    assert _drive(monitor, range(500, 800), change) == ["leg 4 unknown"]
    assert _drive(monitor, range(800, 1000), None) == []
    monitor.believe_whole(4)
    assert _drive(monitor, range(1000, 1300), change) == ["leg 4 unknown"]
    monitor = LegMonitor(shipped(), (), PERIOD_S, np.array(PACE_HZ), patterns_of=_patterns_of)
    assert _drive(monitor, range(500), None) == []
    monitor.gait_changes(np.array(True))
    assert _drive(monitor, range(500, 900), change) == [], "in another gait nothing is said"


@pytest.mark.slow
@pytest.mark.parametrize("sensors", [("foot_contacts", "imu"), ("imu",), ("joint_positions", "imu")])
def test_a_dead_leg_of_servos_without_loads_is_found_in_the_simulation(sensors: tuple[Sensor, ...]) -> None:
    measured, robot = "joint_positions" in sensors, replace(shipped(), sensors=sensors)
    dead, kind = ("missing", "missing") if measured else ("limp", "unknown")
    events = [[], [parse_failure_event(f"2:{dead}@8")], [parse_failure_event("6:missing@8.4")]]
    trials = [sim_trial(robot=robot, events=each, seed=1, duration_s=12.0) for each in events]
    results = run_sim_trials(trials, make_controller=watched_walk(WalkOn()))
    found = [[one.failure for one in each.noticed] for each in results]
    assert found == [[], [Failure(leg=2, kind=kind)], [Failure(leg=6, kind=kind)]]
