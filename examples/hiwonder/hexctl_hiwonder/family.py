"""The family `hiwonder`: LX servos whose commands a board repeats, with the board's battery and IMU.

The board is reached with 1,000,000 baud, and its servos with 115200: a move takes 0.9 ms, a reading 1.2 ms,
and a question to a silent servo 5 ms. Therefore moves and readings are shared out over the ticks as on a line
of LX-16A servos. Added are the packets, the reports of the board, and the times behind it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import ClassVar

import numpy as np

from hexctl.backends.bus.families import lx16a as lx
from hexctl.backends.bus.packet_line import PacketLine
from hexctl.backends.bus.packets import StatusPacket
from hexctl.backends.bus.servo_bus import BusBoardState, BusCounters, Report
from hexctl.backends.bus.servo_type import ServoType
from hexctl.types import BoolArray, FloatArray
from hexctl_hiwonder.inertial import Inertial
from hexctl_hiwonder.packets import IMU, REPORT, SYSTEM, BoardPackets, moves

#: Time of an order on the line of the servos: ten bits a byte, at 115200 baud.
MOVE_S = 10 * lx.MOVE_BYTES / 115_200

#: Reports of the IMU: six floats, acceleration in g and rates in degrees per second, and their ranges.
IMU_BYTES, IMU_RANGES = 24, np.repeat([16.0, 2000.0], 3)

#: Report of the system that has the voltage of the battery, in mV.
BATTERY = 4

#: Longest time at connect until the IMU is ready.
SETTLES_S = 1.5

#: Age up to which a report counts: the battery's come once a second, those of the IMU about 100 times.
BATTERY_S, IMU_S = 3.0, 0.2


class HiwonderServo(lx.Lx16aServo):
    """One servo. The board cannot read its mode."""

    def _is_motor(self) -> bool:
        return False


class HiwonderBus(lx.Lx16aBus):
    """Servos behind the board, with its battery and its IMU. It has no watchdog."""

    servo_class: ClassVar[type[lx.Lx16aServo]] = HiwonderServo

    def __init__(self, packets: PacketLine, models: Mapping[int, ServoType], counters: BusCounters) -> None:
        super().__init__(packets, models, counters)
        packets.on_report = self._take_report
        self._inertial, self._samples = Inertial(), list[FloatArray]()
        self._battery_v, self._battery_at_s, self._imu_at_s = np.nan, -np.inf, -np.inf

    def find(self) -> BoolArray:
        """Which servos answer, (n,); a robot at rest has its orientation then."""
        found, until_s = super().find(), self._time.now() + SETTLES_S
        while found.any() and self._inertial.quaternion is None and self._time.now() < until_s:
            self._time.sleep(0.02)
            self._packets.discard()
            self._feel()
        return found

    def board(self) -> BusBoardState:
        """Newest measurements of the board."""
        now_s, inertial = self._time.now(), self._inertial
        feels = now_s - self._imu_at_s <= IMU_S
        return BusBoardState(
            battery_v=self._battery_v if now_s - self._battery_at_s <= BATTERY_S else None,
            quaternion=inertial.quaternion if feels else None,
            angular_velocity_rad_s=inertial.angular_velocity_rad_s if feels else None,
        )

    def _take_report(self, report: StatusPacket) -> None:
        data, now_s = report.parameters, self._time.now()
        if report.servo_id == REPORT + SYSTEM and len(data) == 3 and data[0] == BATTERY:
            self._battery_v, self._battery_at_s = int.from_bytes(data[1:], "little") / 1000, now_s
        elif report.servo_id == REPORT + IMU and len(data) == IMU_BYTES:
            sample = np.frombuffer(data, dtype="<f4").astype(np.float64)
            if (np.abs(sample) <= IMU_RANGES).all():  # no NaN is
                self._samples.append(sample)

    def _ask_reports(self, indices: Sequence[int]) -> list[Report]:
        reports = super()._ask_reports(indices)
        self._feel()
        return reports

    def _feel(self) -> None:
        """Take the samples that have come, which belong to the time since those before."""
        if self._samples:
            self._imu_at_s = self._time.now()
            self._inertial.take(np.array(self._samples), self._imu_at_s)
            self._samples.clear()

    def _write_moves(self, chosen: Sequence[int], times_ms: FloatArray) -> None:
        """One packet for all servos that have the same time."""
        by_time: dict[int, list[tuple[int, int]]] = {}
        for index in chosen:
            time_ms = min(int(times_ms[index]), lx.MOST_MOVE_MS)
            by_time.setdefault(time_ms, []).append((self.ids[index], int(self._sent[index])))
        self._line.write(b"".join(moves(goals, time_ms) for time_ms, goals in by_time.items()))
        self._wait_for_servos(len(chosen))

    def _write(self, packets: Sequence[bytes]) -> None:
        super()._write(packets)
        self._wait_for_servos(len(packets))

    def _wait_for_servos(self, orders: int) -> None:
        """Answers come once the board has passed the orders on."""
        self._line.free_s = max(self._line.free_s, self._time.now()) + orders * MOVE_S

    def _move_s(self) -> float:
        return MOVE_S


HIWONDER = replace(
    lx.LX16A,
    name="hiwonder",
    bauds=(1_000_000,),
    formats={1: BoardPackets()},
    servo=HiwonderServo,
    bus=HiwonderBus,
    modem_lines=False,  # they reset boards with a CH9102; the vendor's SDK keeps them low as well
    simulated="hexctl_hiwonder.simulated:HiwonderBoard",
)
