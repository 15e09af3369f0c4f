"""Servos on a bus as a controller sees them: they conform, and what goes wrong is named."""

import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hexctl.backends.base import LegServos
from hexctl.backends.bus.bus_map import BusMap
from hexctl.backends.bus.families.registers import Register
from hexctl.backends.bus.servo_bus import Report
from hexctl.backends.bus.servos import BusServos
from hexctl.control.guard import Guard
from hexctl.errors import RobotFaultError
from hexctl.simulators.register_servos import BusServo
from hexctl.types import BoolArray, FloatArray, RobotState
from tests.backends.bus.boards import (
    MODELS_BY_NAME,
    MemoryBus,
    a_map,
    bus_board,
    memory_bus,
    register_servo_of,
    servos_on,
)
from tests.backends.powering import PoweringConformance
from tests.backends.standing import command, stand, until
from tests.robots import shipped

#: The servo that is not as the others.
ODD = 7

X_MAP, LX_MAP = a_map("dynamixel", "xl430-w250"), a_map("lx16a", "lx16a")


class OnBus(PoweringConformance):
    bus_map: BusMap

    @pytest.fixture(autouse=True)
    def board(self) -> Iterator[None]:
        with memory_bus(self.bus_map) as self.bus:
            yield

    def make(self) -> LegServos:
        return servos_on(self.bus, self.bus_map)

    def holding(self) -> BoolArray:
        return self.bus.board._family.holds()


class TestFeetech(OnBus):
    #: A count is 0.0015 rad.
    bus_map = a_map()


class TestLx16a(OnBus):
    #: A count is 0.0042 rad.
    bus_map = LX_MAP


def _said(words: str) -> Callable[[RobotState], bool]:
    return lambda state: any(words in each for each in state.warnings)


@pytest.mark.realtime
def test_a_bus_on_a_pseudo_terminal_is_walked_and_found_again(tmp_path: Path) -> None:
    """On the wall clock, with a device that goes and comes back."""
    device = tmp_path / "ttyUSB0"
    with bus_board(a_map()) as board:
        device.symlink_to(board.path)
        servos = BusServos(shipped("phantomx"), bus_map=a_map(), port=str(device))
        guard = Guard(servos, expiry_s=1.0)
        guard.connect()
        command(guard)
        assert guard.read().healthy
    device.unlink()
    with guard:
        until(guard, lambda _: guard.stopped is not None, write=False)
        until(guard, lambda _: not guard.peek().healthy, write=False)
        assert "the port" in str(guard.peek().fault)
        with bus_board(a_map()) as board:
            device.symlink_to(board.path)
            until(guard, lambda _: guard.peek().healthy, write=False)
            guard.clear()
            assert not board._servos[0].holds, "nothing is switched on by itself"
            command(guard)
            until(guard, lambda _: board._servos[0].holds, write=False)
        assert guard.link_counts["reopened"] == 1


def test_a_watchdog_that_has_expired_is_renewed() -> None:
    """X servos refuse goals then: after a program that was killed, and after a bus that was held up."""
    with memory_bus(X_MAP) as bus:
        for expires in (True, False):
            with servos_on(bus, X_MAP) as servos:
                if expires:
                    stand(servos, 25)
            for joint in range(18):
                memory = register_servo_of(bus.board, joint).memory
                memory[98] = 255 if expires else memory[98]  # as if nothing had ended it
        with servos_on(bus, X_MAP) as servos:
            stance = servos.robot.stance_angles_rad
            assert stand(servos, 40, 0.1).joint_positions_rad == pytest.approx(stance + 0.1, abs=5e-3)
            for joint in range(18):
                register_servo_of(bus.board, joint).memory[98] = 255
            bus.time.work(0.6)  # the thread of the bus is held up
            assert stand(servos, 40).joint_positions_rad == pytest.approx(stance, abs=5e-3)


def test_a_robot_that_was_moved_by_hand_is_where_it_is_and_stays_there() -> None:
    with memory_bus(a_map()) as bus:
        bus.robot._positions_rad += 0.05
        with servos_on(bus, a_map()) as servos:
            here_rad = servos.read().joint_positions_rad
            assert here_rad == pytest.approx(servos.robot.stance_angles_rad + 0.05, abs=2e-3)
            assert stand(servos, 25, 0.05).joint_positions_rad == pytest.approx(here_rad, abs=2e-3)
            assert bus.board._family.holds().all()


def test_a_servo_that_has_let_go_is_named_and_gets_no_goals_until_the_torque_was_off() -> None:
    """Some switch their torque on with a goal, and would jump to it."""
    with memory_bus(a_map()) as bus, servos_on(bus, a_map()) as servos:
        stand(servos, 15)
        servo = register_servo_of(bus.board, ODD)
        servo.memory[40] = 0
        state = until(servos, lambda state: state.warnings)
        assert state.warnings == ("no torque: leg 3 femur (id 8)",)
        before = bytes(servo.memory[42:44])
        for tick in range(30):
            stand(servos, 1, 0.004 * tick)
        assert bytes(servo.memory[42:44]) == before
        assert not servo.holds
        assert register_servo_of(bus.board, 8).holds
        servos.disable_torque()
        until(servos, lambda state: not state.warnings)
        until(servos, lambda _: servo.holds)


def test_one_wrong_answer_about_the_torque_is_not_believed(monkeypatch: pytest.MonkeyPatch) -> None:
    with memory_bus(a_map()) as bus, servos_on(bus, a_map()) as servos:
        stand(servos, 15)
        assert servos._thread is not None
        answers = [False]
        monkeypatch.setattr(
            servos._thread._device, "torque", lambda *_, **__: answers.pop() if answers else True
        )
        assert stand(servos, 10).warnings == ()
        assert not answers


def test_torque_off_is_sent_until_every_servo_has_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """No servo answers the packet for all, so that one that is lost is noticed by reading."""
    with memory_bus(a_map()) as bus, servos_on(bus, a_map()) as servos:
        stand(servos, 15)
        obey = bus.board._family._sync_write  # type: ignore[attr-defined]
        lost: list[bytes] = []

        def lossy(parameters: bytes) -> None:
            if parameters[0] == 40 and len(lost) < 2:
                lost.append(parameters)
            else:
                obey(parameters)

        monkeypatch.setattr(bus.board._family, "_sync_write", lossy)
        servos.disable_torque()
        until(servos, lambda _: not bus.board._family.holds().any(), write=False)
        assert len(lost) == 2


def _goals_seen(servos: BusServos, monkeypatch: pytest.MonkeyPatch) -> list[FloatArray]:
    """Goals that are sent from now on."""
    assert servos._thread is not None
    device, seen = servos._thread._device, []
    write = device.write_goals

    def seeing(counts: FloatArray) -> None:
        seen.append(counts.copy())
        write(counts)

    monkeypatch.setattr(device, "write_goals", seeing)
    return seen


def test_goals_come_in_steps_after_a_program_that_left_the_robot_standing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    bus_map = a_map()
    with memory_bus(bus_map) as bus:
        with servos_on(bus, bus_map) as servos:
            stand(servos, 25)
        with servos_on(bus, bus_map) as servos:
            before = bus_map.raw(servos.read().joint_positions_rad)
            seen = _goals_seen(servos, monkeypatch)
            stand(servos, 50, 0.5)
        speeds = np.degrees(servos.robot.joint_max_speed_rad_s) * bus_map.per_deg
        assert (np.abs(seen[0] - before) <= 0.03 * speeds + 1).all()
        assert (np.abs(np.diff(np.array(seen), axis=0)).max(axis=0) <= 0.03 * speeds + 1e-6).all()
        goal = bus_map.raw(servos.robot.stance_angles_rad + 0.5)
        assert seen[-1] == pytest.approx(np.clip(goal, bus_map.least, bus_map.most))


@pytest.mark.parametrize("bus_map", [a_map(), LX_MAP], ids=["feetech", "lx16a"])
def test_a_servo_that_falls_silent_is_named_and_the_others_walk_on(bus_map: BusMap) -> None:
    with memory_bus(bus_map, "mute:5:femur@1") as bus, servos_on(bus, bus_map) as servos:
        state = until(servos, lambda state: state.warnings)
        assert state.warnings == ("mute: leg 5 femur (id 14)",)
        assert state.healthy
        assert state.servos is not None
        assert state.servos.ages_s[13] > 0.4
        assert np.delete(state.servos.ages_s, 13).max() < 0.4
        assert np.isfinite(state.joint_positions_rad).all()
        assert state.stale_joints is not None
        assert np.flatnonzero(state.stale_joints).tolist() == [13]


def test_a_servo_whose_positions_jump_is_stale_and_named_and_not_mute(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with memory_bus(a_map()) as bus, servos_on(bus, a_map()) as servos:
        stand(servos, 15)
        thread, polls = servos._thread, 0
        assert thread is not None
        poll = thread._device.poll

        def jumping(until: Callable[[], bool]) -> list[Report]:
            nonlocal polls
            polls += 1
            wild = 500.0 * (1 + polls % 2)
            return [replace(each, position=wild) if each.index == 13 else each for each in poll(until)]

        monkeypatch.setattr(thread._device, "poll", jumping)
        (warning,) = until(servos, _said("jump")).warnings
        assert "leg 5 femur (id 14)" in warning
        state = servos.read()
        assert state.stale_joints is not None
        assert np.flatnonzero(state.stale_joints).tolist() == [13]


def test_servos_of_two_legs_may_be_missing_at_connect_and_not_more() -> None:
    two = [f"mute:{leg}:{joint}" for leg in (1, 2) for joint in ("coxa", "femur", "tibia")]
    with memory_bus(a_map(), *two) as bus, servos_on(bus, a_map()) as servos:
        assert servos.read().joint_positions_rad.shape == (18,)
    with (
        memory_bus(a_map(), *two, "mute:3:coxa") as bus,
        pytest.raises(RobotFaultError, match=r"leg 1 coxa \(id 1\), .*leg 3 coxa"),
    ):
        servos_on(bus, a_map()).connect()


def test_joints_of_lx16a_are_heard_in_turn_while_all_of_them_move() -> None:
    with memory_bus(LX_MAP) as bus, servos_on(bus, LX_MAP) as servos:
        ages = []
        for tick in range(100):
            state = stand(servos, 1, 0.1 * np.sin(0.1 * tick))
            assert state.servos is not None
            ages.append(float(state.servos.ages_s.max()))
        assert float(np.median(ages)) < 0.4
        assert state.warnings == ()


@pytest.mark.parametrize("bus_map", [a_map(), LX_MAP], ids=["feetech", "lx16a"])
def test_garbled_answers_stop_nothing(bus_map: BusMap) -> None:
    with memory_bus(bus_map, "garble:0.05") as bus, Guard(servos_on(bus, bus_map)) as guard:
        for _ in range(150):
            state = stand(guard, 1)
            assert state.joint_positions_rad == pytest.approx(guard.robot.stance_angles_rad, abs=0.02)
        assert guard.stopped is None
        counts = guard.link_counts
        assert 0 < counts["missed"] < 0.5 * counts["reports"]


def test_a_line_that_is_pulled_stops_the_robot_until_it_is_back_and_cleared() -> None:
    with memory_bus(a_map(), "unplug@1", "replug@2.5") as bus, Guard(servos_on(bus, a_map())) as guard:
        command(guard)
        until(guard, lambda _: guard.stopped is not None)
        assert str(guard.stopped).startswith(f"fault: no servo answers on {bus.path}")
        until(guard, lambda state: state.age_s < 0.1, write=False)
        guard.clear()
        assert stand(guard, 5).healthy


def test_a_port_that_goes_is_a_fault_until_it_is_back() -> None:
    with memory_bus(a_map()) as bus, servos_on(bus, a_map()) as servos:
        stand(servos, 10)
        bus.unplugged = True
        assert "the port" in str(until(servos, lambda state: not state.healthy).fault)
        bus.unplugged = False
        assert until(servos, lambda state: state.healthy).fault is None
        assert servos.link_counts["reopened"] == 1


# What is stored in servos, at connect: set up, refused or told; and what an overload leaves.


def _stored(bus: MemoryBus, register: Register, value: float) -> BusServo:
    """The odd servo, in which a setting is another for good."""
    servo = register_servo_of(bus.board, ODD)
    servo.set(register, value)
    servo._keep()
    return servo


@pytest.mark.parametrize(
    ("driver", "model", "mode", "kept"),
    [
        ("dynamixel", "xl430-w250", 4, 3),
        ("dynamixel", "xl320", 1, 2),
        ("feetech", "sts3215", 1, 1),  # whose lock keeps it from being saved
    ],
)
def test_a_servo_in_another_mode_is_set_to_position_mode_while_it_is_limp(
    driver: str, model: str, mode: int, kept: int
) -> None:
    bus_map, table = replace(a_map(driver, model), p_gain=48), MODELS_BY_NAME[model].table
    assert table.mode is not None
    assert table.p_gain is not None
    with memory_bus(bus_map) as bus:
        servo = _stored(bus, table.mode.register, mode)
        with servos_on(bus, bus_map) as servos:
            assert _said(f"from {mode} to {table.mode.value}: leg 3 femur")(servos.read())
            until(servos, lambda _: servo.holds)
            servo.restart()  # which undoes what is not saved
            assert servo.number(table.p_gain) != 48
            servos.disable_torque()
            until(servos, lambda _: servo.holds)
            assert servo.number(table.p_gain) == 48
        servo.restart()
        assert servo.number(table.mode.register) == kept


def test_positions_beyond_one_turn_are_switched_off_and_the_lock_is_shut() -> None:
    table, flags = MODELS_BY_NAME["sts3215"].table, Register(18)
    assert table.unlock is not None
    with memory_bus(a_map()) as bus:
        servo = _stored(bus, flags, 0b11100)
        servo.set(table.unlock, 0)
        with servos_on(bus, a_map()) as servos:
            assert _said("beyond one turn from 1 to 0: leg 3 femur (id 8)")(servos.read())
        assert servo.number(flags) == 0b01100
        assert servo.number(table.unlock) == 1


@pytest.mark.parametrize(("driver", "model"), [("dynamixel", "xl430-w250"), ("dynamixel", "ax12a")])
def test_limits_in_a_servo_are_told_and_goals_end_there(driver: str, model: str) -> None:
    """These servos refuse goals beyond their limits, and would stay where they are."""
    bus_map, table = a_map(driver, model), MODELS_BY_NAME[model].table
    with memory_bus(bus_map) as bus:
        servo = register_servo_of(bus.board, ODD)
        limit = servo.number(table.position) + np.sign(bus_map.signs[ODD]) * 15
        _stored(bus, table.most if bus_map.signs[ODD] > 0 else table.least, limit)
        with servos_on(bus, bus_map) as servos:
            assert any("stored limits" in each and "(id 8)" in each for each in servos.read().warnings)
            stand(servos, 25)
            until(servos, lambda _: servo.number(table.position) == limit, offset_rad=0.2)
            state = until(servos, lambda state: state.servos and state.servos.errors[ODD], offset_rad=0.2)
            assert state.servos is not None
            assert state.servos.errors[ODD].startswith("goal beyond the limits")


def test_an_overload_of_an_x_servo_is_told_with_its_reason_and_needs_a_restart() -> None:
    with memory_bus(X_MAP, "overload:3:femur@2") as bus, servos_on(bus, X_MAP) as servos:
        until(servos, _said("(overload): leg 3 femur (id 8)"))
        until(servos, _said("no torque: leg 3 femur (id 8)"))
    with memory_bus(X_MAP, "overload:3:femur") as bus, servos_on(bus, X_MAP) as servos:
        assert any(re.search(r"overload.*power.*: leg 3 femur", each) for each in servos.read().warnings)


def test_an_overload_of_an_ax_servo_is_told_and_ends_with_the_next_walk() -> None:
    """It sets its torque limit to 0, and leaves its torque on."""
    bus_map, table = a_map("dynamixel", "ax12a"), MODELS_BY_NAME["ax12a"].table
    assert table.torque_limit is not None
    with memory_bus(bus_map, "overload:3:femur@1") as bus, servos_on(bus, bus_map) as servos:
        limp, servo = "no torque: leg 3 femur (id 8)", register_servo_of(bus.board, ODD)
        until(servos, _said(limp))
        assert servo.number(table.torque) == 1
        stand(servos, 15)
        assert not servo.holds, "it is not switched on by itself"
        assert servos.disable_torque()
        bus.time.sleep(0.2)
        until(servos, lambda _: servo.holds)
        assert servo.number(table.torque_limit) == 1
        until(servos, lambda state: not _said(limp)(state))


@pytest.mark.parametrize(
    ("number", "advice"), [(1060, "`model: xl430-w250`"), (0, "check `model`"), (4711, "check `model`")]
)
def test_another_model_than_the_robot_file_says_is_refused_and_named(number: int, advice: str) -> None:
    bus_map = a_map("dynamixel", "xl330-m288")
    with memory_bus(bus_map) as bus:
        register_servo_of(bus.board, 0).memory[0:2] = number.to_bytes(2, "little")
        with pytest.raises(RobotFaultError, match=rf"leg 1 coxa .* {number}, not 1200 .*{advice}"):
            servos_on(bus, bus_map).connect()
