"""A bus of servos with registers, Dynamixel and Feetech: what one thread asks them and tells them."""

import time
from collections.abc import Callable, Sequence

import numpy as np

from hexctl.backends.bus.packet_line import PacketLine
from hexctl.backends.bus.packets import BROADCAST, PING, READ, SYNC_READ, SYNC_WRITE, WRITE, StatusPacket
from hexctl.backends.bus.registers import Register, RegisterTable, table_of
from hexctl.backends.bus.serial_line import SerialLine
from hexctl.backends.bus.servo_bus import ALL, TRIES, BusCounters, Report, ServoBus
from hexctl.robot.bus_map import BusMap
from hexctl.types import N_JOINTS, BoolArray, FloatArray

#: Servos that are asked one by one in a control period, where they do not answer one packet together.
ONE_BY_ONE = 5

#: Time of the servos' own watchdog, in 20 ms.
WATCHDOG_20MS = 10


class RegisterBus(ServoBus):
    """Servos with registers on one line: Dynamixel and Feetech.

    Args:
        line: open.
        servos: which servo moves which joint.
        counters: what is counted.
    """

    def __init__(self, line: SerialLine, servos: BusMap, counters: BusCounters) -> None:
        self._line, self._counters = line, counters
        self.table: RegisterTable = table_of(servos.models[0].name)
        self._packets = PacketLine(line, self.table.protocol)
        self._ids: list[int] = servos.ids.tolist()
        self._joints = {servo_id: joint for joint, servo_id in enumerate(self._ids)}
        self._next = 0

    def find(self) -> BoolArray:
        """Which joints have a servo that answers, (18,); learns whether the adapter echoes."""
        self._packets.learn_echo()
        found: BoolArray = np.zeros(N_JOINTS, dtype=bool)
        for joint, servo_id in enumerate(self._ids):
            found[joint] = self._packets.ask(servo_id, PING, tries=TRIES) is not None
        return found

    def model_number(self, joint: int) -> int | None:
        """Model number that the servo of a joint reports, or None without an answer."""
        return self._read(joint, self.table.model)

    def prepare(self, joints: BoolArray) -> None:
        """Set up the servos of some joints, (18,), that have no torque: answers without delay, position mode.

        What is as it should be is not written: some of it is kept in memory that wears out.
        """
        wanted = {self.table.return_delay.address: 0, **self.table.settings}
        for joint in np.flatnonzero(joints).tolist():
            for address, value in wanted.items():
                if self._read(joint, Register(address)) not in (value, None):
                    self._write(joint, Register(address), value)

    def torque(self, joint: int, *, tries: int = TRIES) -> bool | None:
        """Whether the servo of a joint holds its goal, or None without an answer."""
        value = self._read(joint, self.table.torque, tries=tries)
        return None if value is None else value == 1

    def set_torque(self, on: bool, joints: Sequence[int] = ALL) -> None:
        """Switch the torque of some joints, and the watchdog of their servos where they have one."""
        self._sync_write(self.table.torque, np.full(N_JOINTS, float(on)), joints)
        if on:
            self.renew_watchdog(joints)
        else:
            self.end_watchdog(joints)

    def hold(self, counts: FloatArray, joints: BoolArray) -> BoolArray:
        """Switch the torque of some joints on, (18,), each with its goal where it is, counts (18,).

        Goals and torques are read back, and written again where they did not arrive; which joints hold.
        """
        holds: BoolArray = np.zeros(N_JOINTS, dtype=bool)
        goals = np.rint(counts)
        for _ in range(TRIES):
            left = np.flatnonzero(joints & ~holds).tolist()
            if not left:
                break
            self.end_watchdog(left)  # an expired one refuses goals
            self._sync_write(self.table.goal, goals, left)
            there = [joint for joint in left if self._goal(joint) == goals[joint]]
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
        """Send goals in counts, (18,), in one packet."""
        self._sync_write(self.table.goal, np.rint(counts))
        self._counters.writes += 1

    def poll(self, until: Callable[[], bool] = lambda: False) -> list[Report]:
        """Reports of all servos, or of the next few, asked one by one until something else is to be sent."""
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
        request = packets.instruction(BROADCAST, SYNC_READ, self._place(first, size) + ids)
        wire_s = self._line.wire_s(len(request) + len(joints) * packets.status_size(size))
        answers = self._packets.transact(request, ids, wire_s)
        reports = [each for answer in answers if (each := self._report(answer)) is not None]
        self._count(missed=len(joints) - len(reports))
        return reports

    def _poll_each(self, joints: list[int]) -> list[Report]:
        reports: list[Report] = []
        for joint in joints:
            answer = self._packets.ask(self._ids[joint], READ, self._place(*self.table.block))
            report = None if answer is None else self._report(answer)
            if report is not None:
                reports.append(report)
        self._count(missed=len(joints) - len(reports))
        return reports

    def _count(self, *, missed: int) -> None:
        self._counters.missed += missed
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
            error=table.complaint(answer.error),
        )

    def _place(self, address: int, size: int) -> bytes:
        """Parameters that name some bytes of the memory."""
        width = self.table.protocol  # of a number in bytes: 1 in protocol 1.0, 2 in 2.0
        return address.to_bytes(width, "little") + size.to_bytes(width, "little")

    def _goal(self, joint: int) -> float | None:
        """Goal of the servo of a joint in counts, or None without an answer."""
        raw = self._read(joint, self.table.goal)
        return None if raw is None else self.table.goal.value(raw)

    def _read(self, joint: int, register: Register, *, tries: int = TRIES) -> int | None:
        """Raw number in a register of a joint's servo, or None without an answer."""
        answer = self._packets.ask(
            self._ids[joint], READ, self._place(register.address, register.size), tries=tries
        )
        if answer is None or len(answer.parameters) != register.size:
            return None
        return int.from_bytes(answer.parameters, self.table.byte_order)

    def _write(self, joint: int, register: Register, value: float) -> bool:
        """Write a register of a joint's servo; whether it answered."""
        address = register.address.to_bytes(self.table.protocol, "little")
        data = address + self.table.packed(register, value)
        return self._packets.ask(self._ids[joint], WRITE, data, tries=TRIES) is not None

    def _sync_write(self, register: Register, values: FloatArray, joints: Sequence[int] = ALL) -> None:
        """Write a register of some joints, values (18,), in one packet, which no servo answers."""
        head = self._place(register.address, register.size)
        rows = b"".join(
            bytes([self._ids[joint]]) + self.table.packed(register, float(values[joint])) for joint in joints
        )
        self._packets.tell(BROADCAST, SYNC_WRITE, head + rows)
