"""A bus of servos with registers, Dynamixel and Feetech: what one thread asks them and tells them."""

import time
from collections.abc import Callable, Sequence

import numpy as np

from hexctl.backends.bus.packet_line import PacketLine
from hexctl.backends.bus.packets import (
    BROADCAST,
    PROTOCOLS,
    READ,
    SYNC_READ,
    SYNC_WRITE,
    StatusPacket,
)
from hexctl.backends.bus.register.registers import Register, RegisterTable, table_of
from hexctl.backends.bus.register.servo import RegisterServo, place
from hexctl.backends.bus.register.stored_settings import (
    hardware_error,
    renew_torque_limit,
    set_up,
    settings_of,
)
from hexctl.backends.bus.serial_line import SerialLine
from hexctl.backends.bus.servo_bus import (
    ALL,
    TRIES,
    BusCounters,
    Report,
    ServoBus,
    beyond_stored_limits,
    complaint_of_limits,
    far_beyond,
)
from hexctl.errors import RobotFaultError
from hexctl.robot.servos.bus_map import BusMap
from hexctl.robot.servos.servo_models import ServoType
from hexctl.types import N_JOINTS, BoolArray, FloatArray

#: Servos that are asked one by one in a control period, where they do not answer one packet together.
ONE_BY_ONE = 5

#: Time of the servos' own watchdog, in 20 ms.
WATCHDOG_20MS = 10

#: How often a servo that raises its alert is asked why.
ALERT_S = 1.0


class RegisterBus(ServoBus):
    """Servos with registers on one line: Dynamixel and Feetech.

    Args:
        line: open.
        servos: which servo moves which joint.
        counters: what is counted.
    """

    def __init__(self, line: SerialLine, servos: BusMap, counters: BusCounters) -> None:
        self._line, self._counters = line, counters
        self._map = servos
        self.table: RegisterTable = table_of(servos.models[0].name)
        self._packets = PacketLine(line, PROTOCOLS[self.table.protocol])
        self._ids: list[int] = servos.ids.tolist()
        self._servos = [RegisterServo(self._packets, self.table, servo_id) for servo_id in self._ids]
        self._lowest, self._highest = np.full(N_JOINTS, -np.inf), np.full(N_JOINTS, np.inf)
        self._clipped: BoolArray = np.zeros(N_JOINTS, dtype=bool)
        self._beyond: BoolArray = np.zeros(N_JOINTS, dtype=bool)  # joints that may not hold where they are
        self._errors = [0] * N_JOINTS  # the error bytes of the newest reports
        self._notes: list[str] = []
        self._alerts: dict[int, tuple[float, str]] = {}  # why joints raise their alert, and since when known
        self._joints = {servo_id: joint for joint, servo_id in enumerate(self._ids)}
        self._next = 0

    def find(self) -> BoolArray:
        """Which joints have a servo that answers, (18,); learns whether the adapter echoes."""
        self._packets.learn_echo()
        return np.array([servo.answers() for servo in self._servos])

    def model_number(self, joint: int) -> int | None:
        """Model number that the servo of a joint reports, or None without an answer."""
        return self._servos[joint].sure(self.table.model)

    def answers(self, servo_id: int, model: ServoType) -> bool:
        """Whether a servo of a model answers to an id that no joint has."""
        number = RegisterServo(self._packets, self.table, servo_id).raw(self.table.model)
        return number is not None and model.number in (number, None)

    def prepare(self, joints: BoolArray) -> None:
        """Set up the servos of some joints, (18,), that have no torque, as `set_up` does.

        What was changed is among the notes of `check`.
        """
        self._notes = []
        for joint in np.flatnonzero(joints).tolist():
            self._notes += [f"{note}: {self._name(joint)}" for note in set_up(self._servos[joint])]

    def check(self, joints: BoolArray, least: FloatArray, most: FloatArray) -> tuple[str, ...]:
        """What is worth knowing of the settings of some joints' servos, (18,), and of their limits.

        Raises RobotFaultError for a servo that would not steer for its goals as they are meant.
        """
        notes = list(self._notes)
        for joint in np.flatnonzero(joints).tolist():
            settings = settings_of(self._servos[joint])
            if settings.refusal:
                raise RobotFaultError(f"{self._name(joint)}: {settings.refusal}")
            notes += [f"{note}: {self._name(joint)}" for note in settings.notes]
            self._lowest[joint], self._highest[joint] = settings.least, settings.most
        return (*notes, *beyond_stored_limits(self._map, self._lowest, self._highest, least, most))

    def torque(self, joint: int, *, tries: int = TRIES) -> bool | None:
        """Whether the servo of a joint holds its goal, or None without an answer.

        One whose torque limit is 0, as AX servos have it after an overload, holds nothing; it is asked for
        that where it complains.
        """
        servo = self._servos[joint]
        value = servo.raw(self.table.torque, tries=tries)
        if value == 1 and (tries > 1 or self._errors[joint]):
            return servo.raw(self.table.torque_limit, tries=tries) != 0
        return None if value is None else value == 1

    def set_torque(self, on: bool, joints: Sequence[int] = ALL) -> None:
        """Switch the torque of some joints, and the watchdog of their servos where they have one.

        No servo answers the packet for all: torque that is off is read back, and sent again where it did not
        arrive. Torque that is on is read back by `hold`.
        """
        self._sync_write(self.table.torque, np.full(N_JOINTS, float(on)), joints)
        if on:
            self.renew_watchdog(joints)
            return
        self._beyond[list(joints)] = False
        self.end_watchdog(joints)
        left = list(joints)
        for _ in range(TRIES - 1):
            left = [joint for joint in left if self._servos[joint].raw(self.table.torque, tries=1) != 0]
            if not left:
                return
            self._sync_write(self.table.torque, np.zeros(N_JOINTS), left)

    def hold(self, counts: FloatArray, joints: BoolArray) -> BoolArray:
        """Switch the torque of some joints on, (18,), each with its goal where it is, counts (18,).

        Goals and torques are read back, and written again where they did not arrive; which joints hold. A
        limit of the torque that an overload has left at 0 is renewed. A joint far beyond its stored limits is
        left limp: goals end there, so that it would move to the limit at full speed.
        """
        holds: BoolArray = np.zeros(N_JOINTS, dtype=bool)
        beyond = far_beyond(self._map, counts, self._lowest, self._highest)
        self._beyond, holding = joints & beyond, joints & ~beyond
        goals = np.rint(np.clip(counts, self._lowest, self._highest))
        for joint in np.flatnonzero(holding).tolist():
            renew_torque_limit(self._servos[joint])
        for _ in range(TRIES):
            left = np.flatnonzero(holding & ~holds).tolist()
            if not left:
                break
            self.end_watchdog(left)  # an expired one refuses goals
            self._sync_write(self.table.goal, goals, left)
            there = [joint for joint in left if self._servos[joint].value(self.table.goal) == goals[joint]]
            if there:
                self.set_torque(True, there)
            for joint in there:
                holds[joint] = self.torque(joint) is True
        return holds

    def close(self) -> None:
        """Close the line."""
        self._line.close()

    def renew_watchdog(self, joints: Sequence[int] = ALL) -> None:
        """Let silence be a failure from now on, also where it has been one: goals are taken again."""
        if self.table.watchdog is not None:
            self.end_watchdog(joints)
            self._sync_write(self.table.watchdog, np.full(N_JOINTS, float(WATCHDOG_20MS)), joints)

    def end_watchdog(self, joints: Sequence[int] = ALL) -> None:
        """Let silence be no failure any more."""
        if self.table.watchdog is not None:
            self._sync_write(self.table.watchdog, np.zeros(N_JOINTS), joints)

    def write_goals(self, counts: FloatArray) -> None:
        """Send goals in counts, (18,), in one packet, clipped to the stored limits; none where it is NaN."""
        goals = np.rint(np.clip(counts, self._lowest, self._highest))
        self._clipped = np.abs(np.rint(counts) - goals) > 0
        self._sync_write(self.table.goal, goals, np.flatnonzero(np.isfinite(goals)).tolist())
        self._counters.writes += 1

    def poll(self, until: Callable[[], bool] = lambda: False) -> list[Report]:
        """Reports of all servos, or of the next few, asked one by one until something else is to be sent."""
        reports = self._poll_next(until)
        self._ask_for_an_alert()
        return reports

    def _poll_next(self, until: Callable[[], bool]) -> list[Report]:
        if self.table.sync_read:
            return self._poll_together(list(range(N_JOINTS)))
        asked = [(self._next + step) % N_JOINTS for step in range(ONE_BY_ONE)]
        reports: list[Report] = []
        for joint in asked:
            self._next = (joint + 1) % N_JOINTS
            reports += self._poll_each([joint])
            if until():
                break
        return reports

    def poll_all(self) -> list[Report]:
        """Reports of all servos, each asked as often as it takes, up to `TRIES` times."""
        found: dict[int, Report] = {}
        for _ in range(TRIES):
            missing = [joint for joint in range(N_JOINTS) if joint not in found]
            reports = self._poll_together(missing) if self.table.sync_read else self._poll_each(missing)
            found.update({report.joint: report for report in reports})
            if len(found) == N_JOINTS:
                break
        return list(found.values())

    def _poll_together(self, joints: list[int]) -> list[Report]:
        if not joints:
            return []
        first, size = self.table.block
        ids = bytes(self._ids[joint] for joint in joints)
        packets = self._packets.packets
        request = packets.instruction(BROADCAST, SYNC_READ, place(self.table.protocol, first, size) + ids)
        wire_s = self._line.wire_s(len(request) + len(joints) * packets.status_size(size))
        answers = self._packets.transact(request, ids, wire_s)
        reports = [each for answer in answers if (each := self._report(answer)) is not None]
        self._count(joints, reports)
        return reports

    def _poll_each(self, joints: list[int]) -> list[Report]:
        reports: list[Report] = []
        for joint in joints:
            asked = place(self.table.protocol, *self.table.block)
            answer = self._packets.ask(self._ids[joint], READ, asked)
            report = None if answer is None else self._report(answer)
            if report is not None:
                reports.append(report)
        self._count(joints, reports)
        return reports

    def _count(self, asked: Sequence[int], reports: Sequence[Report]) -> None:
        self._counters.missed += len(asked) - len(reports)
        self._counters.shares.take(asked, {report.joint for report in reports})
        self._counters.garbled = self._packets.garbled

    def _report(self, answer: StatusPacket) -> Report | None:
        """Report of an answer; None for one of another servo or size."""
        table, joint = self.table, self._joints.get(answer.servo_id)
        if joint is None or len(answer.parameters) != table.block[1]:
            return None
        self._counters.reports += 1
        return Report(
            joint=joint,
            at_s=time.monotonic(),
            position=table.of_block(table.position, answer.parameters),
            effort=table.of_block(table.effort, answer.parameters),
            current_a=table.of_block(table.current, answer.parameters),
            voltage_v=table.of_block(table.voltage, answer.parameters),
            temperature_c=table.of_block(table.temperature, answer.parameters),
            error=self._complaint(joint, answer.error),
        )

    def _complaint(self, joint: int, error: int) -> str:
        """What a servo complains of, with the goals that end at its limits."""
        self._errors[joint] = error
        words = self.table.complaint(error)
        if self.table.hardware_error is None or not words:
            self._alerts.pop(joint, None)
        else:  # why it raises its alert is asked later
            words = self._alerts.setdefault(joint, (-np.inf, words))[1]
        stands, goal = bool(self._beyond[joint]), bool(self._clipped[joint])
        limits = complaint_of_limits(self._lowest[joint], self._highest[joint], stands=stands, goal=goal)
        return ", ".join(filter(None, (words, limits)))

    def _ask_for_an_alert(self) -> None:
        """Ask one of the servos that raise their alert for the reason, each once in a while."""
        now_s = time.monotonic()
        for joint, (asked_at_s, words) in self._alerts.items():
            if asked_at_s < now_s - ALERT_S:
                reason = hardware_error(self._servos[joint])
                said = f"hardware alert ({reason})" if reason else words
                self._alerts[joint] = (now_s, said)
                return

    def _name(self, joint: int) -> str:
        return self._map.names(np.arange(N_JOINTS) == joint)

    def _sync_write(self, register: Register, values: FloatArray, joints: Sequence[int] = ALL) -> None:
        """Write a register of some joints, values (18,), in one packet, which no servo answers."""
        head = place(self.table.protocol, register.address, register.size)
        rows = b"".join(
            bytes([self._ids[joint]]) + self.table.packed(register, float(values[joint])) for joint in joints
        )
        self._packets.tell(BROADCAST, SYNC_WRITE, head + rows)
