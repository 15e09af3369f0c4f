"""What `hexctl calibrate` does: ask about one servo after the other, and write down the answers."""

import math
import sys
from pathlib import Path

from hexctl.backends.mavlink.client import MavlinkServos
from hexctl.backends.mavlink.codec import read_signing_key
from hexctl.backends.mavlink.transport import DEFAULT_PORT, check_guarded, parse_port
from hexctl.cli.calibrationhands import Hands, Lines, QuitError
from hexctl.cli.console import DONE, INTERRUPTED, StopOnInterrupt
from hexctl.control.guard import MAX_EXPIRY_S, Guard
from hexctl.errors import InputError
from hexctl.robot.configs import find_config
from hexctl.robot.loader import load_robot_file
from hexctl.robot.model import Robot
from hexctl.robot.servo_map import (
    ServoMap,
    back_up,
    check_writable,
    flipped,
    limited,
    reference_deg,
    referenced,
    taken_over,
    write_servo_map,
)
from hexctl.types import JOINT_KINDS, JOINT_NAMES, JOINTS_PER_LEG

#: How far a joint is moved to see which way it turns.
NUDGE_DEG = 8.0

#: What a positive and a negative movement of each kind of joint look like.
SEEN = {
    "coxa": ("counter-clockwise seen from above", "clockwise seen from above"),
    "femur": ("up, with the whole leg", "down, with the whole leg"),
    "tibia": ("up and outward", "down and inward"),
}

#: What a joint looks like at angle zero.
AT_ZERO = {
    "coxa": "the leg points straight away from its mount",
    "femur": "the femur lies as in the robot file",
    "tibia": "the tibia lies as in the robot file",
}

#: What may be answered while a joint is being moved, and by how much it moves then.
STEPS_DEG = {"+": 1.0, "-": -1.0, "++": 5.0, "--": -5.0}
FARTHEST_DEG = 45.0

READY = (
    "Hold the robot up so that its legs hang free. Servos that nobody drives jump to their places now. "
    "Enter when ready:"
)
STEP_HELP = "+ or - 1 deg, ++ or -- 5, a number of degrees"


def execute(
    robot_name: str, *, connect: str | None, joints: str | None, keys: Path | None, insecure: bool
) -> int:
    """Calibrate as requested and return the exit code."""
    path = find_config("robots", robot_name)
    check_writable(path)
    file = load_robot_file(path)
    robot, servo_map = file.robot, file.servo_map
    chosen = chosen_joints(joints)
    port, signing_key = connect or DEFAULT_PORT, read_signing_key(keys)
    signed = signing_key is not None
    check_guarded(parse_port(port), option="--connect", text=port, signed=signed, insecure=insecure)
    servos = MavlinkServos(robot, servo_map=servo_map, port=port, signing_key=signing_key)
    # One joint at a time, slowly: a computer that is busy for a moment need not end a long sitting.
    guarded = Guard(servos, expiry_s=MAX_EXPIRY_S)
    with StopOnInterrupt() as interrupt, guarded as guard:
        guard.clock.tick()
        hands = Hands(guard, servos, Lines(sys.stdin.fileno()), interrupt.requested)
        hands.tell("skip leaves a step as it is, quit ends; every joint done is saved at once.")
        Calibration(robot, path, servo_map, hands).run(chosen)
        return INTERRUPTED if interrupt.requested() else DONE


def chosen_joints(text: str | None) -> list[int]:
    """Return the joints, 0..17, of a text such as `leg1_coxa,leg3`, in the order of the robot.

    Raises InputError for a name that there is not.
    """
    if text is None:
        return list(range(len(JOINT_NAMES)))
    chosen: set[int] = set()
    for part in (part.strip() for part in text.split(",")):
        named = [joint for joint, name in enumerate(JOINT_NAMES) if part in (name, name.split("_")[0])]
        if not named:
            raise InputError(f"--joints: got {part!r}; allowed: {', '.join(JOINT_NAMES)}, or leg1 .. leg6")
        chosen.update(named)
    return sorted(chosen)


class Calibration:
    """Asks about joints and saves what it learns of each before it goes on to the next."""

    def __init__(self, robot: Robot, path: Path, saved: ServoMap, hands: Hands) -> None:
        self._robot, self._path, self._saved, self._hands = robot, path, saved, hands
        self._backup: Path | None = None

    def run(self, joints: list[int]) -> None:
        """Calibrate some joints, 0..17, until done or told to quit."""
        done: list[str] = []
        try:
            self._hands.ask(READY, holding=False)
            for number, joint in enumerate(joints, start=1):
                channel = self._hands.servo_map.channels[joint]
                name = JOINT_NAMES[joint]
                self._hands.tell(f"{name}, channel {channel} ({number} of {len(joints)})")
                self._joint(joint)
                self._save(joint)
                done.append(name)
        except QuitError:
            pass
        saved = f"saved {', '.join(done)} in {self._path}" if done else "nothing was changed"
        before = "" if self._backup is None else f"; as it was before: {self._backup}"
        self._hands.tell(saved + before)

    def _joint(self, joint: int) -> None:
        """Find sign, offset and limits of one joint, and put it back where it was."""
        home_deg = self._hands.angle_deg(joint)
        self._find_sign(joint)
        self._find_offset(joint)
        self._find_limits(joint)
        self._hands.move(joint, home_deg)

    def _find_sign(self, joint: int) -> None:
        hands, kind = self._hands, JOINT_KINDS[joint % JOINTS_PER_LEG]
        at_deg = hands.angle_deg(joint)
        up = at_deg + NUDGE_DEG <= math.degrees(self._robot.joint_upper_rad[joint])
        seen = SEEN[kind][0 if up else 1]
        if hands.ask("  watch this joint. Enter to move it, skip:") == "skip":
            return
        while True:
            hands.move(joint, at_deg + (NUDGE_DEG if up else -NUDGE_DEG))
            answer = hands.ask(f"  did it move {seen}? yes, no, again, skip:")
            hands.move(joint, at_deg)
            if answer in ("n", "no"):
                hands.remap(flipped(hands.servo_map, joint, at_deg))
            if answer in ("y", "yes", "n", "no", "skip"):
                return

    def _find_offset(self, joint: int) -> None:
        hands, kind = self._hands, JOINT_KINDS[joint % JOINTS_PER_LEG]
        lower, upper = (
            math.degrees(limit[joint]) for limit in (self._robot.joint_lower_rad, self._robot.joint_upper_rad)
        )
        true_deg = reference_deg(lower, upper)
        hands.move(joint, true_deg)
        hands.tell(f"  turn it to {true_deg:g} deg; at 0 {AT_ZERO[kind]}")
        while True:
            answer = hands.ask(f"  {STEP_HELP}, at DEGREES if you measured, ok, skip:")
            measured_deg = _measured(answer)
            if answer == "skip":
                return
            if answer == "ok" or measured_deg is not None:
                true_deg = true_deg if measured_deg is None else measured_deg
                if not lower <= true_deg <= upper:
                    hands.tell(f"  got {true_deg:g}; allowed: {lower:g} to {upper:g} deg")
                    continue
                believed_deg = hands.angle_deg(joint)
                hands.remap(referenced(hands.servo_map, joint, believed_deg, true_deg))
                return
            self._step(joint, answer)

    def _find_limits(self, joint: int) -> None:
        """Take the pulses of both ends of the travel; an end that is skipped keeps its limit."""
        hands, servo_map = self._hands, self._hands.servo_map
        lowest, highest = servo_map.min_us[joint], servo_map.max_us[joint]
        low, high = (lowest, highest) if servo_map.signs[joint] > 0 else (highest, lowest)
        low = self._find_end(joint, "lower", float(low))
        high = self._find_end(joint, "upper", float(high))
        try:
            hands.remap(limited(servo_map, joint, (low, high)))
        except InputError as error:
            hands.tell(f"  {error}; the limits stay as they were")

    def _find_end(self, joint: int, which: str, limit_us: float) -> float:
        hands = self._hands
        while True:
            place = f"{hands.angle_deg(joint):.1f} deg, {hands.pulse_us(joint):.0f} us"
            answer = hands.ask(f"  {which} end of its travel ({place}): {STEP_HELP}, ok, skip:")
            if answer == "skip":
                return limit_us
            if answer == "ok":
                return hands.pulse_us(joint)
            self._step(joint, answer)

    def _step(self, joint: int, answer: str) -> None:
        """Move a joint as an answer says."""
        by_deg = _by_deg(answer)
        if by_deg is None:
            self._hands.tell(f"  got {answer!r}; allowed: {STEP_HELP}, up to {FARTHEST_DEG:g}")
        elif not self._hands.move(joint, self._hands.angle_deg(joint) + by_deg):
            self._hands.tell("  it is at the end of its range in the robot file, or of its pulses")

    def _save(self, joint: int) -> None:
        """Write what was learnt of one joint; nothing is known of those that were only held."""
        if self._backup is None:
            self._backup = back_up(self._path)
        self._saved = taken_over(self._saved, joint, self._hands.servo_map)
        write_servo_map(self._path, self._saved)


def _by_deg(answer: str) -> float | None:
    """Return by how much an answer wants a joint moved, or None for no such answer."""
    if answer in STEPS_DEG:
        return STEPS_DEG[answer]
    try:
        value = float(answer)
    except ValueError:
        return None
    return value if abs(value) <= FARTHEST_DEG else None  # not for nan


def _measured(answer: str) -> float | None:
    """Return the angle of an answer such as `at 12.5`, or None for another answer."""
    if not answer.startswith("at "):
        return None
    try:
        value = float(answer[3:])
    except ValueError:
        return None
    return value if math.isfinite(value) else None
