"""Leg servos on a bus, and the thread that owns the bus."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from hexctl.backends.bus.bus_map import BusMap
from hexctl.backends.bus.damage import Damage
from hexctl.backends.bus.line_condition import LineCondition
from hexctl.backends.bus.readings import BelievedReadings, polls
from hexctl.backends.bus.serial_line import SerialLine
from hexctl.backends.bus.servo_bus import MANY_MUTE, BusBoardState, BusCounters, Report, ServoBus
from hexctl.backends.bus.tools import bus_of, check_no_unexpected_ids, lost_id_notes, other_settings
from hexctl.backends.clock import Clock
from hexctl.backends.port_thread import PortThread
from hexctl.backends.ticked_servos import PortServos
from hexctl.errors import RobotFaultError
from hexctl.robot.model import Robot
from hexctl.time_source import WALL_TIME, TimeSource
from hexctl.types import N_JOINTS, TOO_HOT_C, WARM_C, BoolArray, FloatArray, RobotState, ServoReadings

#: With more mute servos than those of two legs it is the bus, not a leg.
MOST_MUTE = 6

#: A bus of which nothing was heard for this long is named, as long as guards wait for a state.
SILENT_S = 0.2

#: After a gap this long between its packets the servos' own watchdog may have expired.
GAP_S = 0.15


class BusThread(PortThread[ServoBus]):
    """Owns a bus of servos that report positions, and hold there before they follow.

    `speeds` are maximum, (18,), in counts per second; `limp` are joints whose servos should hold and do not,
    (18,).
    """

    def __init__(
        self,
        opened: Callable[[], ServoBus],
        bus: ServoBus,
        readings: BelievedReadings,
        counters: BusCounters,
        speeds: FloatArray,
        *,
        time: TimeSource = WALL_TIME,
    ) -> None:
        super().__init__(opened, bus, counters=counters, speeds=speeds, name="servo bus", time=time)
        self._readings, self._counters = readings, counters
        self._asked = 0  # joint whose torque was read last
        self._active_at_s = -np.inf
        self.limp: BoolArray = np.zeros(len(speeds), dtype=bool)
        self._held: BoolArray = np.zeros(len(speeds), dtype=bool)

    def start(self) -> None:
        """Start; servos that hold already approach the first targets from their positions."""
        self._sent = self._readings.positions if self.on else None
        self._held = np.isfinite(self._readings.positions)
        super().start()

    def newest(self) -> tuple[FloatArray, ServoReadings, FloatArray]:
        """Newest positions in counts, readings, and how long each servo was silent in s, (18,)."""
        with self._lock:
            now_s = self._time.now()
            readings = self._readings
            return readings.positions, readings.servos(now_s), now_s - readings.heard_at_s

    def board(self) -> BusBoardState:
        """Newest measurements of a board."""
        return self._device.board()

    def _follow(self, targets: FloatArray) -> FloatArray:
        if not self.on:
            self._hold_where_it_is()
        elif self._time.now() - self._active_at_s > GAP_S:
            self._device.renew_watchdog()
        near = self._stepped(targets)
        # Some servos switch their torque on with a goal: a released servo would jump to it.
        self._device.write_goals(np.where(self._held, near, np.nan))
        return near

    def _let_go(self) -> None:
        self._device.set_torque(False)
        self.limp[:] = False

    def _poll(self) -> None:
        reports = self._device.poll(lambda: self._targets is not None)
        self._take(reports)
        if reports:  # where none came, another question would only be waited for too
            self._check_torque()
        self._active_at_s = self._time.now()

    def _meet(self) -> None:
        with self._lock:
            self._readings.distrust()

    def _finish(self) -> None:
        self._device.end_watchdog()

    def _hold_where_it_is(self) -> None:
        """Switch the torque on with each goal at the joint's position, so that nothing jumps."""
        with self._lock:
            self._readings.distrust()
        begun_s = self._time.now()
        for reports in polls(self._device, self._readings):
            self._take(reports)
        with self._lock:
            here = self._readings.positions
        heard: BoolArray = self._readings.heard_at_s >= begun_s
        known: BoolArray = self._readings.trusted & heard
        self._held = self._device.hold(np.where(known, here, 0.0), known)
        self.limp = heard & ~self._held
        self._sent = np.where(known, here, np.nan)

    def _check_torque(self) -> None:
        """Ask one joint after the other whether it holds: servos trip, and restart without torque."""
        if not self.on or self._device.reports_limp:
            return
        self._asked = (self._asked + 1) % len(self.limp)
        torque = self._device.torque(self._asked, tries=1)
        if torque is False:  # one wrong answer is rare, and two in a row are not wrong
            torque = self._device.torque(self._asked, tries=1)
        if torque is False:
            self.limp[self._asked], self._held[self._asked] = True, False

    def _take(self, reports: Sequence[Report]) -> None:
        with self._lock:
            self._readings.take(reports)
            self._counters.implausible = self._readings.implausible


class BusServos(PortServos[BusMap, BusThread, BusCounters]):
    """Eighteen servos on a serial bus.

    A thread owns the port, and neither `read` nor `write` waits for it. No torque is switched before the
    first `write`; then each servo holds its position before it follows. After `close` the robot holds its
    pose. Servos without an answer are named in `warnings`; a silent joint has its last position, else its
    target.

    Args:
        baud: bits per second; the driver's usual one unless given.
        clock: a wall clock unless given.
        note: first of the warnings, or empty.
    """

    what = "the servo bus"

    def __init__(
        self,
        robot: Robot | str | Path,
        *,
        bus_map: BusMap,
        port: str,
        baud: int | None = None,
        clock: Clock | None = None,
        note: str = "",
    ) -> None:
        super().__init__(robot, servo_map=bus_map, port=port, counters=BusCounters(), clock=clock)
        self._note = note
        self._baud = baud or bus_map.family.bauds[0]
        self._held = False
        self._notes: tuple[str, ...] = ()
        self._garbled = 0  # bytes until something was heard last
        self._condition = LineCondition(bus_map, self.counters.shares, time=self._clock.time)

    @property
    def holds(self) -> bool:
        """Whether any servo is known to hold."""
        return self._thread is not None and (self._thread.on or self._held)

    def disable_torque(self) -> bool:
        """Let all joints go limp until the next targets."""
        self._held = False
        return super().disable_torque()

    def _prepared(self) -> BusThread:
        """The thread; raises RobotFaultError if servos of all or of more than two legs are missing."""
        bus = self._open(first=True)
        readings = BelievedReadings(self._speeds, self._map.per_deg)
        try:
            for reports in polls(bus, readings):
                readings.take(reports)
            heard = np.isfinite(readings.positions)
            on = self._on(bus, heard)
        except BaseException:
            bus.close()
            raise
        self._held = bool(on.any())
        time = self._clock.time
        thread = BusThread(self._open, bus, readings, self.counters, self._speeds, time=time)
        thread.on = bool(heard.any() and on[heard].all())
        return thread

    def _open(self, *, first: bool = False) -> ServoBus:
        """Open the port and find enough servos; on the first call, without unexpected ids."""
        line = SerialLine(
            self._port, self._baud, modem_lines=self._map.family.modem_lines, time=self._clock.time
        )
        try:
            bus = bus_of(self._map, line, self.counters)
            bus.speeds = self._speeds
            found = bus.find()
            advice = ""
            if first and not found.any() and (not bus.damage or bus.damage.at_many_ids):
                line.close()
                driver = self._map.family.name
                advice = other_settings(self._port, driver, (self._baud,), drivers=(driver,))
            if bus.board_answers and not found.any():
                raise RobotFaultError(
                    f"the board on {self._port} answers, but none of its servos; are they powered, and are "
                    "the ids those of the robot file?"
                )
            self._check_found(found, bus.damage, advice and f"; {advice}")
            noise = [bus.damage.description(self._port)] if bus.damage.noisy and found.all() else []
            if first and bus.damage and not noise:  # two servos with one id would move together
                raise RobotFaultError(bus.damage.description(self._port))
            if first:
                check_no_unexpected_ids(line, self._map, found)
            self._check_models(bus, found)
            unpowered = np.flatnonzero(found & ~self._on(bus, found)).tolist()
            notes = self._grouped({joint: bus.servos[joint].set_up() for joint in unpowered})
            notes += self._stored(bus, found)
            given = (self._note,) if self._note else ()
            self._notes = (*given, *noise, *notes, *lost_id_notes(bus, self._map, found))
        except BaseException:
            line.close()
            raise
        return bus

    def _check_found(self, found: BoolArray, damage: Damage, advice: str = "") -> None:
        if damage and np.count_nonzero(~found) > MOST_MUTE:
            raise RobotFaultError(damage.description(self._port) + advice)
        if not found.any():
            raise RobotFaultError(
                f"no servo answers on {self._port} at {self._baud} baud; are they powered, and are driver, "
                f"baud and ids those of the robot file?{advice}"
            )
        if np.count_nonzero(~found) > MOST_MUTE:
            raise RobotFaultError(f"servos do not answer on {self._port}: {self._map.names(~found)}")

    def _check_models(self, bus: ServoBus, found: BoolArray) -> None:
        for joint in np.flatnonzero(found).tolist():
            model, number = self._map.models[joint], bus.servos[joint].model_number()
            if None not in (model.number, number) and number != model.number:
                raise RobotFaultError(
                    f"{self._name(joint)} reports model number {number}, not {model.number} ({model.name}); "
                    f"{self._model_advice(number)}"
                )

    def _model_advice(self, number: int | None) -> str:
        names = [each.name for each in self._map.family.models if each.number == number and number]
        if not names:
            return "check `model` in the robot file; or do the servos need another driver?"
        which = " or ".join(names)
        return f"it is of the model {which}: `model: {names[0]}` in the robot file"

    def _grouped(self, notes: Mapping[int, Sequence[str]]) -> list[str]:
        """Notes on joints: each once, with the names of all joints that it is about."""
        every = dict.fromkeys(note for each in notes.values() for note in each)
        about = {
            note: np.array([note in notes.get(joint, ()) for joint in range(N_JOINTS)]) for note in every
        }
        return [f"{note}: {self._map.names(joints)}" for note, joints in about.items()]

    def _stored(self, bus: ServoBus, joints: BoolArray) -> list[str]:
        """Notes on stored settings; raises RobotFaultError for a servo that would not follow goals."""
        settings = bus.settings(joints)
        for joint, stored in settings.items():
            if stored.refusal:
                raise RobotFaultError(f"{self._name(joint)}: {stored.refusal}")
            if stored.shadow_id in set(self._map.ids.tolist()) - {int(self._map.ids[joint])}:
                raise RobotFaultError(
                    f"{self._name(joint)}: it also follows the goals of id {stored.shadow_id}; set its "
                    "secondary id (register 12) to 255 with the vendor's tool"
                )
        notes = self._grouped({joint: stored.notes for joint, stored in settings.items()})
        notes += self._odd_firmware({joint: stored.firmware for joint, stored in settings.items()})
        ends = self._map.raw(np.array([self._robot.joint_lower_rad, self._robot.joint_upper_rad]))
        needed = np.rint(np.sort(np.clip(ends, self._map.least, self._map.most), axis=0))
        for joint in np.flatnonzero((needed[0] < bus.lowest) | (needed[1] > bus.highest)).tolist():
            notes.append(
                f"its stored limits {bus.lowest[joint]:.0f} to {bus.highest[joint]:.0f} end within the "
                f"joint's {needed[0, joint]:.0f} to {needed[1, joint]:.0f}: {self._name(joint)}"
            )
        return notes

    def _odd_firmware(self, versions: Mapping[int, str]) -> list[str]:
        """Note on servos whose firmware is not that of most."""
        known = {joint: each for joint, each in versions.items() if each}
        if len(set(known.values())) < 2 or len({self._map.models[joint] for joint in known}) > 1:
            return []  # models have versions of their own
        usual = max(known.values(), key=list(known.values()).count)
        odd = {joint: [each] for joint, each in known.items() if each != usual}
        return [f"firmware differs, {usual} on most servos: {'; '.join(self._grouped(odd))}"]

    def _name(self, joint: int) -> str:
        return self._map.names(np.arange(N_JOINTS) == joint)

    @staticmethod
    def _on(bus: ServoBus, found: BoolArray) -> BoolArray:
        """Which servos hold already, (18,); unknown counts as holding."""
        return np.array([bool(found[joint] and bus.torque(joint) is not False) for joint in range(N_JOINTS)])

    def _state(self, thread: BusThread) -> RobotState:
        counts, servos, silences_s = thread.newest()
        board = thread.board()
        age_s = float(servos.ages_s.min())
        heard: BoolArray = np.isfinite(counts)
        positions = np.where(heard, self._map.angles_rad(np.where(heard, counts, 0.0)), self._sent_rad)
        stale = servos.ages_s > self._map.family.bus.stale_s
        efforts = self._map.signs * servos.efforts
        torques = None if np.isnan(efforts).any() else efforts * self._robot.joint_max_torque_nm
        warnings = self._warnings(servos, silences_s, thread.limp)
        return RobotState(
            positions,
            stamp_s=max(0.0, self._clock.now_s - age_s),
            measured=True,
            age_s=age_s,
            healthy=thread.gone is None,
            fault=self._fault(thread.gone, float(silences_s.min())),
            base_quaternion_world=board.quaternion,
            angular_velocity_body_rad_s=board.angular_velocity_rad_s,
            battery_v=_median(servos.voltages_v) if board.battery_v is None else board.battery_v,
            low_battery_v=self._map.low_battery_v,
            joint_torques_nm=torques,
            servos=servos,
            warnings=warnings,
            stale_joints=stale if stale.any() else None,
        )

    def _fault(self, gone: str | None, silence_s: float) -> str | None:
        if gone is not None:
            return self._gone(gone)
        if silence_s <= SILENT_S:
            self._garbled = self.counters.garbled
        elif self.counters.garbled > self._garbled:
            return (
                f"all that comes on {self._port} is damaged: a bad cable, noise, a missing ground, or "
                "another program or controller on the bus"
            )
        else:
            return (
                f"no servo answers on {self._port} any more; is the cable in, have they power, or is this "
                "computer too busy?"
            )
        return None

    def _warnings(self, servos: ServoReadings, silences_s: FloatArray, limp: BoolArray) -> tuple[str, ...]:
        """Warnings about single servos, by their silences and which are limp, (18,)."""
        warnings = [*self._notes]
        if limp.any():
            warnings.append(f"no torque: {self._map.names(limp)}")
        mute_s = self._map.family.bus.mute_s
        mute = silences_s > mute_s
        warnings += self._condition.warnings(servos, limp, mute)
        if np.count_nonzero(mute) > MOST_MUTE:
            warnings.append(MANY_MUTE)  # the same words while they come and go
        elif mute.any():
            warnings.append(f"mute: {self._map.names(mute)}")
        if (wild := (servos.ages_s > mute_s) & ~mute).any():
            warnings.append(f"answers, but its positions jump: {self._map.names(wild)}")
        hot = servos.temperatures_c >= TOO_HOT_C
        warm = (servos.temperatures_c >= WARM_C) & ~hot
        for word, which in (("hot", hot), ("warm", warm)):
            if which.any():
                most_c = servos.temperatures_c[which].max()
                warnings.append(f"{word}, {most_c:.0f} degrees C: {self._map.names(which)}")
        for error in dict.fromkeys(filter(None, servos.errors)):
            which = np.array([each == error for each in servos.errors])
            if error == "hot":
                which &= ~hot  # named above
            if which.any():
                warnings.append(f"{error}: {self._map.names(which)}")
        return tuple(warnings)


def _median(values: FloatArray) -> float | None:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else None
