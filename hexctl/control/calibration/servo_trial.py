"""Trials of single servos on a bus: slow movements of a few degrees with little torque.

Each begins limp, gets its own position as its goal, and then holds; it ends with its torque as it was.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np

from hexctl.backends.bus.servo import Servo
from hexctl.backends.clock import Clock, WallClock
from hexctl.control.calibration.operator import EndedError
from hexctl.errors import RobotFaultError

#: Movement that shows which servo it is, and movement of a test.
WIGGLE_DEG, TEST_DEG = 5.0, 10.0

WIGGLE_DEG_S, TEST_DEG_S = 20.0, 40.0

#: Minimum room within its limits to move a servo.
LEAST_DEG = 2.0

#: Distance from a goal within which a servo has followed, and how long to wait for it.
NEAR_DEG, SETTLES_S = 2.0, 0.8

#: A servo beyond its limits by at most this holds at the limit.
BEYOND_DEG = 1.0

#: Control periods between two readings of voltage and load.
LOOK_EVERY = 10


@dataclass(frozen=True, slots=True, kw_only=True)
class ServoTrial:
    """Response of a servo to a movement to both sides and back.

    Attributes:
        error_deg: maximum distance from a goal at rest.
        speed_deg_s: mean speed of the longest move.
        commanded_deg_s: speed of its goal.
        delay_s: delay behind its goal.
        voltage_v: before it moved, or None.
        least_voltage_v: while it moved, or None.
        temperature_c: at the end, or None.
        most_effort: maximum load as a share, or current in A, or None.
    """

    servo_id: int
    model: str | None
    followed: bool
    moved_deg: tuple[float, float]
    error_deg: float
    speed_deg_s: float
    commanded_deg_s: float
    delay_s: float
    voltage_v: float | None
    least_voltage_v: float | None
    temperature_c: float | None
    most_effort: float | None
    error: str


@contextmanager
def softly_powered(servo: Servo) -> Iterator[float]:
    """Hold a servo softly at a count, which is yielded, and restore its torque; raises RobotFaultError."""
    name = f"the servo with id {servo.servo_id}"
    if refusal := servo.settings().refusal:
        raise RobotFaultError(f"{name}: {refusal}")
    before = servo.torque()
    if before is None or not servo.set_torque(on=False):
        raise RobotFaultError(f"{name} does not report its torque, or keeps it; is its cable good?")
    try:
        if said := servo.soften():
            raise RobotFaultError(f"{name} does not take a limit of its torque and speed ({said})")
        here = servo.position()
        if here is None:
            raise RobotFaultError(f"{name} does not say where it is; is its cable good?")
        start = _within_limits(servo, here)
        if said := servo.go(start):
            raise RobotFaultError(f"{name} refuses a goal where it is ({said})")
        if not servo.set_torque(on=True):
            raise RobotFaultError(f"{name} does not hold ({servo.look().error or 'it does not say why'})")
        yield start
    finally:
        if not before:
            servo.set_torque(on=False)
        servo.restore()


def _within_limits(servo: Servo, here: float) -> float:
    """Count at which a servo may hold: its position, or the nearest limit."""
    least, most = servo.limits()
    start = float(np.clip(here, least, most))
    if abs(start - here) > BEYOND_DEG * servo.type.counts_per_deg:
        raise RobotFaultError(
            f"the servo with id {servo.servo_id} is at {here:.0f}, beyond the limits {least:.0f} to "
            f"{most:.0f} stored in it, and would jump there; turn it by hand"
        )
    return start


def wiggle(
    servo: Servo, *, stop_requested: Callable[[], bool] = lambda: False, clock: Clock | None = None
) -> float:
    """Move a servo to one side and back; the movement in degrees. Raises RobotFaultError.

    A stop ends the movement in the control period in which it is requested, and raises EndedError.
    """
    with softly_powered(servo) as start:
        sweep = _Sweep(servo, clock or WallClock(), stop_requested)
        end = _ends(servo, start, WIGGLE_DEG)[0]
        sweep.move(start, end, WIGGLE_DEG_S)
        sweep.settle(end)
        sweep.move(end, start, WIGGLE_DEG_S)
        sweep.settle(start)
    return (end - start) / servo.type.counts_per_deg


def try_servo(servo: Servo, *, clock: Clock | None = None) -> ServoTrial:
    """Move a servo to both sides and back, and measure its response; raises RobotFaultError."""
    before = servo.look()
    with softly_powered(servo) as start:
        sweep = _Sweep(servo, clock or WallClock())
        ends = _ends(servo, start, TEST_DEG)
        errors: list[float] = []
        reached: list[float] = []
        at = start
        for goal in (*ends, start):
            if goal != at:
                sweep.move(at, goal, TEST_DEG_S)
            reached.append(sweep.settle(goal))
            errors.append(abs(reached[-1] - goal))
            at = goal
        after = servo.look()
    scale = servo.type.counts_per_deg
    return ServoTrial(
        servo_id=servo.servo_id,
        model=before.model,
        followed=bool(max(errors) <= NEAR_DEG * scale),
        moved_deg=(round((reached[0] - start) / scale, 2), round((reached[1] - start) / scale, 2)),
        error_deg=round(max(errors) / scale, 2),
        speed_deg_s=round(sweep.speed / scale, 1),
        commanded_deg_s=TEST_DEG_S,
        delay_s=round(sweep.delay / scale / TEST_DEG_S, 3),
        voltage_v=before.voltage_v,
        least_voltage_v=min(sweep.voltages, default=before.voltage_v),
        temperature_c=after.temperature_c,
        most_effort=max(sweep.efforts, default=None),
        error=after.error,
    )


def _ends(servo: Servo, start: float, far_deg: float) -> tuple[float, float]:
    """Ends of a movement about a count within the stored limits: the one with more room first."""
    far, (least, most) = far_deg * servo.type.counts_per_deg, servo.limits()
    ends = sorted((max(start - far, least), min(start + far, most)), key=lambda end: -abs(end - start))
    if abs(ends[0] - start) < LEAST_DEG * servo.type.counts_per_deg:
        raise RobotFaultError(
            f"the servo with id {servo.servo_id} has no room to move within its limits {least:.0f} to "
            f"{most:.0f}"
        )
    return ends[0], ends[1]


@dataclass(slots=True)
class _Sweep:
    """Movements of a servo, in counts, with mean speed and lag in counts of the longest."""

    servo: Servo
    clock: Clock
    stop_requested: Callable[[], bool] = lambda: False
    voltages: list[float] = field(default_factory=list)
    efforts: list[float] = field(default_factory=list)
    speed: float = 0.0
    delay: float = 0.0
    _longest: float = 0.0

    def move(self, begin: float, end: float, speed_deg_s: float) -> None:
        duration_s = abs(end - begin) / (speed_deg_s * self.servo.type.counts_per_deg)
        began_s = self.clock.tick().time_s
        seen: list[tuple[float, float, float]] = []  # time, position, goal
        share, step = 0.0, 0
        while share < 1.0:
            self._check_stop()
            share = min(1.0, (self.clock.now_s - began_s) / duration_s)
            goal = begin + share * (end - begin)
            if said := self.servo.go(goal):
                raise RobotFaultError(f"the servo with id {self.servo.servo_id} refuses a goal ({said})")
            if (position := self._look(step)) is not None:
                seen.append((self.clock.now_s, position, goal))
            step += 1
            self.clock.tick()
        if len(seen) > 1 and abs(end - begin) > self._longest:
            self._longest = abs(end - begin)
            (first_s, first, _), (last_s, last, _) = seen[0], seen[-1]
            self.speed = abs(last - first) / max(last_s - first_s, 1e-3)
            behind = [(goal - position) * np.sign(end - begin) for _, position, goal in seen]
            self.delay = float(np.mean(behind))

    def settle(self, goal: float) -> float:
        """Wait for the servo to come near its goal; its position then. Raises RobotFaultError."""
        near, position = 0.25 * self.servo.type.counts_per_deg, None
        until_s = self.clock.now_s + SETTLES_S
        while self.clock.now_s < until_s:
            self._check_stop()
            self.clock.tick()
            read = self.servo.position()
            position = position if read is None else read
            if position is not None and abs(position - goal) <= near:
                break
        if position is None:
            raise RobotFaultError(
                f"the servo with id {self.servo.servo_id} does not say where it is any more"
            )
        return position

    def _check_stop(self) -> None:
        """End the movement where the servo is, if a stop is requested."""
        if self.stop_requested():
            if (position := self.servo.position()) is not None:
                self.servo.go(position)
            raise EndedError

    def _look(self, step: int) -> float | None:
        """Position of the servo; every `LOOK_EVERY` steps also its voltage and load."""
        if step % LOOK_EVERY != LOOK_EVERY // 2:
            return self.servo.position()
        found = self.servo.look()
        if found.voltage_v is not None:
            self.voltages.append(found.voltage_v)
        if found.effort is not None:
            self.efforts.append(found.effort)
        return None if found.position is None else float(found.position)
