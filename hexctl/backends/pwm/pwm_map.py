"""The PWM map: the output of a board for each joint's hobby servo, and its pulses."""

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray

from hexctl.errors import InputError
from hexctl.robot.servos.raw_map import IntPerJoint, RawMap, check_driver, check_once, joint_value
from hexctl.robot.servos.servo_map import pulses_of
from hexctl.robot.servos.servo_schema import ServosSection
from hexctl.types import JOINT_NAMES, JOINTS_PER_LEG, N_JOINTS, N_LEGS

#: Number of outputs of a driver's boards.
OUTPUTS = {"servo2040": 18, "pca9685": 32}

#: Output 16 is the first one of the second board.
PCA9685_CHANNELS = 16

#: Shortest and longest pulse of a servo2040, whose firmware clips others.
SERVO2040_US = (500.0, 2500.0)

#: Default touch inputs of the legs: the firmware's L1, L2, L3, then R3, R2, R1.
USUAL_TOUCHES = (0, 1, 2, 5, 4, 3)


@dataclass(frozen=True, eq=False, kw_only=True)
class PwmMap(RawMap):
    """Output of each joint, (18,), touch input of each leg, (6,), from 0, and the pulses of angles.

    Below `low_battery_v`, if the board measures it, the robot sits down; None without a threshold.
    """

    unit: ClassVar[str] = "us"
    driver: str
    outputs: IntPerJoint
    touches: Annotated[NDArray[np.int64], (N_LEGS,)]
    addresses: tuple[int, int] = (0x40, 0x41)
    oscillators_mhz: tuple[float, float] = (25.0, 25.0)
    low_battery_v: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        most = OUTPUTS[self.driver] - 1
        for name, output in zip(JOINT_NAMES, self.outputs.tolist(), strict=True):
            if not 0 <= output <= most:
                raise InputError(f"servos.{name}.id: got {output}; allowed: 0 to {most} with {self.driver}")
        check_once("id", JOINT_NAMES, self.outputs)
        check_once("touch", JOINT_NAMES[JOINTS_PER_LEG - 1 :: JOINTS_PER_LEG], self.touches)
        if self.driver == "servo2040":
            self._check_pulses(*SERVO2040_US)

    def servo_name(self, joint: int) -> str:
        """The servo of a joint, 0..17, by its output, with a PCA9685 also by the printed channel."""
        output = int(self.outputs[joint])
        if self.driver != "pca9685":
            return f"output {output}"
        board, channel = divmod(output, PCA9685_CHANNELS)
        return f"output {output}, channel {channel} at {self.addresses[board]:#x}"

    def _check_pulses(self, least_us: float, most_us: float) -> None:
        for name, low, high in zip(JOINT_NAMES, self.least, self.most, strict=True):
            if low < least_us or high > most_us:
                raise InputError(
                    f"servos.{name}: got min_us {low:g} and max_us {high:g}; allowed: {least_us:g} to "
                    f"{most_us:g} us with {self.driver}"
                )


def pwm_map_of(section: ServosSection, driver: str) -> PwmMap:
    """PWM map of a section, with joint ids as outputs; raises InputError for what the board does not have."""
    check_driver(section, driver)
    for name in JOINT_NAMES:
        touch = getattr(section, name).touch
        if touch is not None and not name.endswith("tibia"):
            raise InputError(f"servos.{name}: got touch {touch:g}; allowed: touch under the tibia")
        if touch is not None and driver != "servo2040":
            raise InputError(f"servos.{name}: got touch {touch:g}; allowed: no touch with {driver}")
    outputs = [joint_value(section, joint, "id", joint) for joint in range(N_JOINTS)]
    touches = [
        joint_value(section, JOINTS_PER_LEG * leg + JOINTS_PER_LEG - 1, "touch", usual)
        for leg, usual in enumerate(USUAL_TOUCHES)
    ]
    return PwmMap(
        driver=driver,
        outputs=np.array(outputs, dtype=np.int64),
        touches=np.array(touches, dtype=np.int64),
        addresses=(int(section.addresses[0]), int(section.addresses[1])),
        oscillators_mhz=section.oscillator_mhz,
        low_battery_v=section.low_battery_v,
        **pulses_of(section),
    )
