"""A bus of Dynamixel or Feetech servos, which have registers."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from hexctl.backends.bus.families.register_servo import RegisterServo
from hexctl.backends.bus.families.registers import Register
from hexctl.backends.bus.packet_line import PacketLine
from hexctl.backends.bus.packets import BROADCAST, READ, SYNC_READ, SYNC_WRITE, StatusPacket
from hexctl.backends.bus.servo import TRIES
from hexctl.backends.bus.servo_bus import BusCounters, Report, ServoBus
from hexctl.backends.bus.servo_type import ServoType
from hexctl.types import BoolArray, FloatArray

#: Number of servos read one by one in a control period, if they do not answer a common packet.
ONE_BY_ONE = 5

#: Time of the servos' own watchdog, in 20 ms.
WATCHDOG_20MS = 10

#: How often a servo that raises its alert is asked why.
ALERT_S = 1.0


class RegisterBus(ServoBus):
    """Servos with one table of registers on one line."""

    servos: Sequence[RegisterServo]

    def __init__(self, packets: PacketLine, models: Mapping[int, ServoType], counters: BusCounters) -> None:
        super().__init__(packets, models, counters)
        self.servos = [RegisterServo(packets, servo_id, model) for servo_id, model in models.items()]
        self.table = self.servos[0].table
        self._indices = {servo_id: index for index, servo_id in enumerate(self.ids)}
        self._errors = [0] * len(self.ids)  # the error bytes of the newest reports
        self._alerts: dict[int, tuple[float, str]] = {}  # why servos raise their alert, and since when known
        self._next = 0

    def torque(self, index: int, *, tries: int = TRIES) -> bool | None:
        """Whether a servo holds its goal; None without an answer.

        AX servos set their torque limit to 0 after an overload and then hold nothing; it is read if they
        complain.
        """
        on = super().torque(index, tries=tries)
        if on and (tries > 1 or self._errors[index]):
            return self.servos[index].raw(self.table.torque_limit, tries=tries) != 0
        return on

    def set_torque(self, on: bool, indices: Sequence[int] | None = None) -> None:
        """Switch the torque of some servos, and their watchdogs if they have one.

        No servo answers a broadcast: torque off is read back and sent again if necessary; `hold` reads torque
        on back.
        """
        left = list(self._every if indices is None else indices)
        self._write_all(self.table.torque, float(on), left)
        if on:
            self.renew_watchdog(left)
            return
        self._beyond[left] = False
        self.end_watchdog(left)
        for _ in range(TRIES - 1):
            left = [index for index in left if self.servos[index].raw(self.table.torque, tries=1) != 0]
            if not left:
                return
            self._write_all(self.table.torque, 0.0, left)

    def _hold(self, here: FloatArray, which: BoolArray) -> BoolArray:
        """Set up again what a restart or an overload has undone; write goals and torques until read back."""
        holds: BoolArray = np.zeros(len(self.ids), dtype=bool)
        for index in np.flatnonzero(which).tolist():
            if self.servos[index].torque() is False:
                self.servos[index].set_up()
            self.servos[index].renew_torque_limit()
        for _ in range(TRIES):
            left = np.flatnonzero(which & ~holds).tolist()
            if not left:
                break
            self.end_watchdog(left)  # an expired one refuses goals
            self._sync_write(self.table.goal, here, left)
            there = [index for index in left if self.servos[index].value(self.table.goal) == here[index]]
            if there:
                self.set_torque(True, there)
            for index in there:
                holds[index] = self.torque(index) is True
        return holds

    def renew_watchdog(self, indices: Sequence[int] | None = None) -> None:
        """Treat silence as a failure from now on; expired watchdogs end."""
        if self.table.watchdog is not None:
            self.end_watchdog(indices)
            self._write_all(self.table.watchdog, float(WATCHDOG_20MS), indices)

    def end_watchdog(self, indices: Sequence[int] | None = None) -> None:
        """Stop the watchdogs."""
        if self.table.watchdog is not None:
            self._write_all(self.table.watchdog, 0.0, indices)

    def _send_goals(self, goals: FloatArray) -> None:
        self._sync_write(self.table.goal, goals, np.flatnonzero(np.isfinite(goals)).tolist())

    def poll(self, until: Callable[[], bool] = lambda: False) -> list[Report]:
        """Reports of all servos, or one by one of the next few until `until` is true."""
        reports: list[Report] = []
        if self.table.sync_read:
            reports = self._ask_reports(self._every)
        else:
            for _ in range(ONE_BY_ONE):
                reports += self._ask_reports([self._next])
                self._next = (self._next + 1) % len(self.ids)
                if until():
                    break
        self._ask_for_an_alert()
        return reports

    def _ask_reports(self, indices: Sequence[int]) -> list[Report]:
        """Reports of some servos, by one sync read if they can."""
        if not indices:
            return []
        packets, (first, size) = self._packets.packets, self.table.block
        block, ids = packets.address_bytes(first, size), bytes(self.ids[index] for index in indices)
        if self.table.sync_read:
            request = packets.instruction(BROADCAST, SYNC_READ, block + ids)
            wire_s = self._packets.line.wire_s(len(request) + len(ids) * packets.status_size(size))
            answers = self._packets.transact(request, ids, wire_s)
        else:
            asked = (self._packets.ask(servo_id, READ, block) for servo_id in ids)
            answers = [answer for answer in asked if answer is not None]
        now_s = self._time.now()
        reports = [self._report(answer, now_s) for answer in answers if len(answer.parameters) == size]
        self._count(indices, reports)
        return reports

    def _report(self, answer: StatusPacket, now_s: float) -> Report:
        index = self._indices[answer.servo_id]
        position, effort, current_a, voltage_v, temperature_c = self.table.numbers(answer.parameters)
        complaint = self._complaint(index, answer.error)
        return Report(index, now_s, position, effort, current_a, voltage_v, temperature_c, complaint)

    def _complaint(self, index: int, error: int) -> str:
        self._errors[index] = error
        words = self.table.complaint(error)
        if self.table.hardware_error is None or not words:
            self._alerts.pop(index, None)
        else:  # why it raises its alert is asked later
            words = self._alerts.setdefault(index, (-np.inf, words))[1]
        return ", ".join(filter(None, (words, self._complaint_of_limits(index))))

    def _ask_for_an_alert(self) -> None:
        """Ask one of the alerted servos for the reason, each at intervals."""
        now_s = self._time.now()
        for index, (asked_at_s, words) in self._alerts.items():
            if asked_at_s < now_s - ALERT_S:
                reason = self.servos[index].hardware_error()
                self._alerts[index] = (now_s, f"hardware alert ({reason})" if reason else words)
                return

    def _write_all(self, register: Register, value: float, indices: Sequence[int] | None) -> None:
        self._sync_write(register, np.full(len(self.ids), value), self._every if indices is None else indices)

    def _sync_write(self, register: Register, values: FloatArray, indices: Sequence[int]) -> None:
        """Write a register of some servos, values (n,), in one packet, which no servo answers."""
        head = self._packets.packets.address_bytes(register.address, register.size)
        rows = [
            bytes([self.ids[index]]) + self.table.packed(register, float(values[index])) for index in indices
        ]
        self._packets.tell(BROADCAST, SYNC_WRITE, head + b"".join(rows))
