"""The PWM map: the output of a board that each joint's hobby servo is plugged into, and its pulses."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hexctl.errors import InputError
from hexctl.robot.schema import PWM_DRIVERS, JointServoSection, ServosSection
from hexctl.robot.servo_map import ServoMap, servo_map_of
from hexctl.types import JOINT_NAMES, JOINTS_PER_LEG, N_JOINTS, N_LEGS, ArrayFields, check_finite

IntArray = NDArray[np.int64]

#: Outputs of a driver's boards.
OUTPUTS = {"servo2040": 18}

#: Shortest and longest pulse of a servo2040, whose firmware clips others.
SERVO2040_US = (500.0, 2500.0)

#: Touch inputs of the legs, where the file has none: the firmware's L1, L2, L3, then R3, R2, R1.
USUAL_TOUCHES = (0, 1, 2, 5, 4, 3)


@dataclass(frozen=True, eq=False, kw_only=True)
class PwmMap(ArrayFields):
    """Which output moves which joint.

    Attributes:
        driver: one of `PWM_DRIVERS`.
        outputs: output of each joint, leg-major, (18,), each once, counted from 0.
        touches: touch input of each leg, (6,), each once, counted from 0.
        pulses: conversion between angles and pulses; its channels have no meaning here.
    """

    driver: str
    outputs: IntArray
    touches: IntArray
    pulses: ServoMap

    def __post_init__(self) -> None:
        check_finite(self.outputs, (N_JOINTS,), "servos.outputs")
        check_finite(self.touches, (N_LEGS,), "servos.touches")
        most = OUTPUTS[self.driver] - 1
        for name, output in zip(JOINT_NAMES, self.outputs.tolist(), strict=True):
            if not 0 <= output <= most:
                raise InputError(f"servos.{name}.id: got {output}; allowed: 0 to {most} with {self.driver}")
        _check_once("id", JOINT_NAMES, self.outputs)
        _check_once("touch", JOINT_NAMES[JOINTS_PER_LEG - 1 :: JOINTS_PER_LEG], self.touches)
        if self.driver == "servo2040":
            self._check_pulses(*SERVO2040_US)

    def _check_pulses(self, least_us: float, most_us: float) -> None:
        for name, low, high in zip(JOINT_NAMES, self.pulses.min_us, self.pulses.max_us, strict=True):
            if low < least_us or high > most_us:
                raise InputError(
                    f"servos.{name}: got min_us {low:g} and max_us {high:g}; allowed: {least_us:g} to "
                    f"{most_us:g} us with {self.driver}"
                )


def pwm_map_of(section: ServosSection, driver: str) -> PwmMap:
    """PWM map of a section `servos` for a driver; `id` of a joint is its output, else 0, 1 ... 17.

    Raises InputError for outputs, inputs or pulses that the board does not have.
    """
    if driver not in PWM_DRIVERS:
        raise InputError(f"servos.driver: got {driver!r}; allowed: {', '.join(PWM_DRIVERS)}")
    if section.driver not in (None, driver):
        raise InputError(f"servos.driver: got {section.driver}; allowed: {driver}, with the backend {driver}")
    joints: list[JointServoSection] = [getattr(section, name) for name in JOINT_NAMES]
    for name, joint in zip(JOINT_NAMES, joints, strict=True):
        if joint.touch is not None and not name.endswith("tibia"):
            raise InputError(f"servos.{name}: got touch {joint.touch:g}; allowed: touch under the tibia")
    outputs = [number if joint.id is None else joint.id for number, joint in enumerate(joints)]
    tibiae = joints[JOINTS_PER_LEG - 1 :: JOINTS_PER_LEG]
    touches = [
        usual if joint.touch is None else joint.touch
        for usual, joint in zip(USUAL_TOUCHES, tibiae, strict=True)
    ]
    return PwmMap(
        driver=driver,
        outputs=np.array(outputs, dtype=np.int64),
        touches=np.array(touches, dtype=np.int64),
        pulses=servo_map_of(section),
    )


def _check_once(key: str, names: tuple[str, ...], values: IntArray) -> None:
    """Raise InputError unless each value stands once."""
    for value in values.tolist():
        sharing = [name for name, own in zip(names, values.tolist(), strict=True) if own == value]
        if len(sharing) > 1:
            raise InputError(f"servos: got {key} {value} for {' and '.join(sharing)}; allowed: each once")
