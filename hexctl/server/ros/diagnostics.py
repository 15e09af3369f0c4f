"""Diagnostics of a robot for ROS: one status of the robot, and one of each servo that reports anything."""

import math

from hexctl.control.stop_reason import reason_in_words
from hexctl.server.snapshot import RobotSnapshot
from hexctl.types import JOINT_NAMES, TOO_HOT_C, WARM_C, RobotState, ServoReadings
from hexctl.wire.ros.telemetry import DiagnosticStatus, Level

#: Age from which a servo's reading is stale.
STALE_S = 1.0


def statuses(snapshot: RobotSnapshot, node: str) -> list[DiagnosticStatus]:
    """Statuses of a robot and of its servos; `node` includes the namespace."""
    state = snapshot.state
    servos = state.servos
    joints = range(len(JOINT_NAMES))
    singles = [] if servos is None else [_servo(joint, state, servos, node) for joint in joints]
    return [_robot(snapshot, node), *singles]


def silent(node: str) -> list[DiagnosticStatus]:
    """Status of a silent robot."""
    return [DiagnosticStatus(Level.STALE, f"{node}: robot", "its control loop is silent")]


def _robot(snapshot: RobotSnapshot, node: str) -> DiagnosticStatus:
    state = snapshot.state
    level, message = Level.OK, snapshot.posture
    if state.warnings:
        level, message = Level.WARN, "; ".join(state.warnings)
    if not state.age_s <= STALE_S:
        level, message = Level.STALE, state.fault or "nothing new was measured"
    if snapshot.stopped is not None:
        level, message = Level.ERROR, f"stopped: {reason_in_words(snapshot.stopped)}"
    if not state.healthy:
        level, message = Level.ERROR, state.fault or "fault"
    values = {
        "posture": snapshot.posture,
        "controller": snapshot.controller or "none",
        "joints": "measured" if state.measured else "echoed",
        **_known("battery", state.battery_v, "V"),
        **_known("charge", None if state.battery_share is None else 100 * state.battery_share, "%"),
        **_known("current", state.current_a, "A"),
    }
    return DiagnosticStatus(level, f"{node}: robot", message, values)


def _servo(joint: int, state: RobotState, servos: ServoReadings, node: str) -> DiagnosticStatus:
    temperature_c, error = float(servos.temperatures_c[joint]), servos.errors[joint]
    level, message = Level.OK, "ok"
    if temperature_c >= WARM_C:
        level, message = Level.WARN, f"warm: {temperature_c:.0f} C"
    stale = state.stale_joints is not None and bool(state.stale_joints[joint])
    if stale or not servos.ages_s[joint] <= STALE_S:
        level, message = Level.STALE, "silent"
    if temperature_c >= TOO_HOT_C:
        level, message = Level.ERROR, f"hot: {temperature_c:.0f} C"
    if error:
        level, message = Level.ERROR, error
    values = {
        **_known("temperature", temperature_c, "C"),
        **_known("voltage", float(servos.voltages_v[joint]), "V"),
        **_known("current", float(servos.currents_a[joint]), "A"),
        **_known("effort", 100 * float(servos.efforts[joint]), "%"),
    }
    return DiagnosticStatus(level, f"{node}: {JOINT_NAMES[joint]}", message, values)


def _known(name: str, value: float | None, unit: str) -> dict[str, str]:
    return {} if value is None or not math.isfinite(value) else {f"{name} ({unit})": f"{value:.4g}"}
