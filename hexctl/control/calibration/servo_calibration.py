"""Servo calibration: by hand where servos tell their positions, by their motors elsewhere."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from hexctl.backends.base import CalibratedServos
from hexctl.backends.registry import BackendOptions, check_options, make_servos
from hexctl.control.calibration.backdriving import BackdrivenCalibration
from hexctl.control.calibration.jogging import JoggedCalibration, JointJogger
from hexctl.control.calibration.operator import INTRODUCTION, CalibrationResult, Operator
from hexctl.control.guard import MAX_EXPIRY_S, Guard
from hexctl.errors import InputError, argument
from hexctl.robot.configs import find_config
from hexctl.robot.loader import RobotFile, load_robot_file
from hexctl.robot.servos.servos_section import check_writable
from hexctl.types import JOINT_NAMES


def calibrate(
    robot: str | Path,
    operator: Operator,
    *,
    backend: str | None = None,
    joints: str | None = None,
    connect: str | None = None,
    credentials: Path | None = None,
    insecure: bool = False,
    stop_requested: Callable[[], bool] = lambda: False,
) -> CalibrationResult:
    """Calibrate servos with an operator, and write sign, offset and limits to the robot file joint by joint.

    Servos that measure where they are lose their torque and are moved by hand; others are moved one at a
    time, slowly.

    Args:
        robot: name or path of a robot file that may be written to.
        operator: asked what the joints do.
        backend: a backend whose servos are `CalibratedServos`; None is the robot file's driver, or mavlink.
        joints: names such as `leg1_coxa,leg3`; all 18 unless given.
        connect: where the servos are, or None for the port of the robot file or the backend's default.
        credentials: folder with the keys of the link, or None.
        insecure: True to allow a link beyond this computer without credentials.
        stop_requested: polled at every tick; True ends the calibration.

    Raises InputError for a file, joints, options or servos that cannot be calibrated, and RobotFaultError for
    a robot that cannot be reached or stops.
    """
    path = find_config("robots", robot)
    check_writable(path)
    file = load_robot_file(path)
    name = _backend(file, backend)
    chosen = chosen_joints(joints)
    given: dict[str, Any] = {"connect": connect, "credentials": credentials, "insecure": insecure}
    check_options(name, **given)
    servos = _calibrated(name, BackendOptions(robot=file.robot, robot_file=file, **given))
    result = CalibrationResult(file.path)
    # One joint at a time, slowly: a computer that is busy for a moment need not end a long sitting.
    with Guard(servos, expiry_s=MAX_EXPIRY_S) as guard:
        guard.clock.tick()
        operator.tell(INTRODUCTION)
        if guard.read().measured and servos.servo_map.unit == "counts":
            BackdrivenCalibration(guard, servos.servo_map, operator, result, stop_requested).run(chosen)
        else:
            jogger = JointJogger(guard, servos, stop_requested)
            JoggedCalibration(file.robot, jogger, operator, result).run(chosen)
    return result


def _backend(file: RobotFile, given: str | None) -> str:
    """The backend that is asked for, else the driver of the robot file.

    Raises InputError for another one than the driver: its keys would be written beside the driver's.
    """
    driver = file.content.servos.driver
    if given is None or driver is None or given == driver or ":" in given:
        return given or driver or "mavlink"
    raise InputError(
        f"{argument('backend')}: got {given} for a file whose servos.driver is {driver}; allowed: {driver}"
    )


def _calibrated(backend: str, options: BackendOptions) -> Any:
    """Servos that are both LegServos and CalibratedServos; raises InputError for others."""
    servos = make_servos(backend, options)
    if not isinstance(servos, CalibratedServos):
        raise InputError(
            f"{argument('backend')}: got {backend}, whose servos have no servo map; allowed: mavlink, a "
            "driver of servos, or servos of your own with `servo_map` and `remap`"
        )
    return servos


def chosen_joints(text: str | None) -> list[int]:
    """The joints, 0..17, of a text such as `leg1_coxa,leg3`, in the order of the robot; all for None.

    Raises InputError for an unknown name.
    """
    if text is None:
        return list(range(len(JOINT_NAMES)))
    chosen: set[int] = set()
    for part in (part.strip() for part in text.split(",")):
        named = [joint for joint, name in enumerate(JOINT_NAMES) if part in (name, name.split("_")[0])]
        if not named:
            raise InputError(
                f"{argument('joints')}: got {part!r}; allowed: {', '.join(JOINT_NAMES)}, or leg1 .. leg6"
            )
        chosen.update(named)
    return sorted(chosen)
