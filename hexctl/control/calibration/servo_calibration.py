"""Servo calibration: by hand if servos report their positions, otherwise by their motors."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from hexctl.backends.base import CalibratedServos
from hexctl.backends.registry import BackendOptions, check_options, find_backend, make_servos
from hexctl.control.calibration.backdriving import BackdrivingDialogue
from hexctl.control.calibration.calibration import BackdrivenCalibration, JoggedCalibration
from hexctl.control.calibration.jogging import JoggingDialogue
from hexctl.control.calibration.operator import INTRODUCTION, CalibrationResult, Operator
from hexctl.control.guard import MAX_EXPIRY_S, Guard
from hexctl.errors import InputError, argument
from hexctl.options import RARE, Typed, check_fields, check_names
from hexctl.robot.configs import find_config
from hexctl.robot.loader import RobotFile, load_robot_file
from hexctl.robot.servos.servos_section import check_writable
from hexctl.types import JOINT_NAMES


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationOptions:
    """Which servos are calibrated, and where they are."""

    backend: str | None = None
    """Servos: mavlink (a servo board), a driver such as dynamixel or servo2040, or package.module:Class
    (custom servos with a servo map). (default: the driver of the robot file, or mavlink)
    """

    port: str | None = None
    """Port of the servos: a serial device such as /dev/ttyUSB0 or /dev/ttyACM0:115200, or udpout:HOST:PORT.
    (default: that of the robot file, or udpout:127.0.0.1:14550)
    """

    joints: str | None = None
    """Only these joints, such as leg1_coxa,leg2_tibia or leg3. (default: all 18)"""

    credentials: Annotated[str | Path | None, Typed(flag="keys"), RARE] = None
    """Folder with mavlink.key, the board's secret, for a board that obeys only it. (default: none)"""

    insecure: Annotated[bool, RARE] = False
    """Command a board beyond this computer without that secret."""

    def __post_init__(self) -> None:
        check_fields(self)


def calibrate(
    robot: str | Path,
    operator: Operator,
    *,
    stop_requested: Callable[[], bool] = lambda: False,
    **options: Any,
) -> CalibrationResult:
    """Calibrate servos with an operator; writes signs, offsets and limits to the robot file joint by joint.

    Servos with position feedback lose their torque and are moved by hand; others are moved slowly, one at a
    time. `stop_requested` is polled at every tick. Options are fields of `CalibrationOptions`.

    Raises InputError for a file, joints, options or servos that cannot be calibrated, and RobotFaultError for
    a robot that cannot be reached or stops.
    """
    check_names(calibrate, options, CalibrationOptions)
    asked = CalibrationOptions(**options)
    with opened_calibration(robot, asked, stop_requested) as calibration:
        operator.tell(INTRODUCTION)
        joints = chosen_joints(asked.joints)
        if isinstance(calibration, BackdrivenCalibration):
            BackdrivingDialogue(calibration, operator).run(joints)
        else:
            JoggingDialogue(calibration, operator).run(joints)
    return calibration.result


@contextmanager
def opened_calibration(
    robot: str | Path, asked: CalibrationOptions, stop_requested: Callable[[], bool]
) -> Iterator[JoggedCalibration | BackdrivenCalibration]:
    """Connect the servos of a robot file to calibrate them; nothing moves. Raises what `calibrate` raises."""
    path = find_config("robots", robot)
    check_writable(path)
    file = load_robot_file(path)
    name = _backend(file, asked.backend)
    chosen_joints(asked.joints)
    given = {field: getattr(asked, field) for field in ("port", "credentials", "insecure")}
    check_options(name, **given)
    servos = _calibrated(name, BackendOptions(robot=file.robot, robot_file=file, **given))
    # One joint at a time, slowly: a busy moment of the computer must not end a long session.
    with Guard(servos, expiry_s=MAX_EXPIRY_S) as guard:
        guard.clock.tick()
        by_hand = guard.read().measured and servos.servo_map.unit == "counts"
        kind = BackdrivenCalibration if by_hand else JoggedCalibration
        yield kind(guard, servos, CalibrationResult(file.path), stop_requested)


def _backend(file: RobotFile, given: str | None) -> str:
    """The given backend, else the driver of the robot file.

    Raises InputError for a backend other than the driver: its keys would be mixed with the driver's.
    """
    driver = file.content.servos.driver
    if given is None or driver is None or given == driver or find_backend(given) is None:
        return given or driver or "mavlink"
    raise InputError(
        f"{argument('backend')}: got {given} for a file whose servos.driver is {driver}; allowed: {driver}"
    )


def _calibrated(backend: str, options: BackendOptions) -> Any:
    servos = make_servos(backend, options)
    if not isinstance(servos, CalibratedServos):
        raise InputError(
            f"{argument('backend')}: got {backend}, whose servos have no servo map; allowed: mavlink, a "
            "driver of servos, or custom servos with `servo_map` and `remap`"
        )
    return servos


def chosen_joints(text: str | None) -> list[int]:
    """The joints, 0..17, of a text such as `leg1_coxa,leg3`; all for None.

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
