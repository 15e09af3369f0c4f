"""The PWM map: the output of a board for each joint's hobby servo, and its pulses."""

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray

from hexctl.errors import InputError
from hexctl.robot.servos.raw_map import IntPerJoint, RawMap, check_once, joint_value
from hexctl.robot.servos.servo_map import pulses_of
from hexctl.robot.servos.servo_schema import ServosSection
from hexctl.types import JOINT_NAMES, JOINTS_PER_LEG, N_JOINTS, N_LEGS, BoolArray

#: Tibias, under which a robot file has the foot switches of the legs.
TIBIAS = JOINT_NAMES[JOINTS_PER_LEG - 1 :: JOINTS_PER_LEG]

#: Place of a foot switch that a leg does not have.
NO_TOUCH = -1


@dataclass(frozen=True, kw_only=True)
class BoardSettings:
    """What a board has, and how a robot file sets it; drivers derive their settings.

    Attributes:
        outputs: number of outputs, counted from 0.
        pulses_us: shortest and longest pulse that it makes.
        touch_inputs: number of inputs that foot switches can have, counted from 0.
        usual_touches: inputs of the legs, (6,), for which the robot file has none.
    """

    outputs: int
    pulses_us: tuple[float, float] = (100.0, 5000.0)
    touch_inputs: int = 0
    usual_touches: tuple[int, ...] = (NO_TOUCH,) * N_LEGS

    def output_name(self, output: int) -> str:
        """Name of an output in messages, with what is printed on the board."""
        return f"output {output}"


@dataclass(frozen=True, eq=False, kw_only=True)
class PwmMap(RawMap):
    """Output of each joint, (18,), touch input of each leg, (6,), from 0, and the pulses of angles.

    A touch input is -1 without a switch. Below `low_battery_v`, if the board measures it, the robot sits
    down; None without a threshold.
    """

    unit: ClassVar[str] = "us"
    driver: str
    settings: BoardSettings
    outputs: IntPerJoint
    touches: Annotated[NDArray[np.int64], (N_LEGS,)]
    low_battery_v: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        settings = self.settings
        self._check_places("id", JOINT_NAMES, self.outputs, settings.outputs)
        if self.touched.any():
            self._check_places("touch", TIBIAS, self.touches, settings.touch_inputs)
        for name, low, high in zip(JOINT_NAMES, self.least, self.most, strict=True):
            least_us, most_us = settings.pulses_us
            if low < least_us or high > most_us:
                raise InputError(
                    f"servos.{name}: got min_us {low:g} and max_us {high:g}; allowed: {least_us:g} to "
                    f"{most_us:g} us with {self.driver}"
                )

    @property
    def touched(self) -> BoolArray:
        """Legs with a foot switch, (6,)."""
        legs: BoolArray = self.touches != NO_TOUCH
        return legs

    def servo_name(self, joint: int) -> str:
        """The servo of a joint, 0..17, by its output."""
        return self.settings.output_name(int(self.outputs[joint]))

    def _check_places(self, key: str, names: tuple[str, ...], places: NDArray[np.int64], count: int) -> None:
        """Raise InputError unless each place exists, and is used once."""
        for name, place in zip(names, places.tolist(), strict=True):
            if place == NO_TOUCH:
                raise InputError(f"servos.{name}: got no {key}; allowed: one for each leg, or none at all")
            if not 0 <= place < count:
                allowed = f"0 to {count - 1}" if count else f"no {key}"
                raise InputError(f"servos.{name}.{key}: got {place}; allowed: {allowed} with {self.driver}")
        check_once(key, names, places)


def map_of(section: ServosSection, driver: str, settings: BoardSettings) -> PwmMap:
    """PWM map of a section, with joint ids as outputs; raises InputError for what the board does not have."""
    for name in JOINT_NAMES:
        touch = getattr(section, name).touch
        if touch is not None and name not in TIBIAS:
            raise InputError(f"servos.{name}: got touch {touch:g}; allowed: touch under the tibia")
    outputs = [joint_value(section, joint, "id", joint) for joint in range(N_JOINTS)]
    touches = [
        joint_value(section, JOINTS_PER_LEG * leg + JOINTS_PER_LEG - 1, "touch", usual)
        for leg, usual in enumerate(settings.usual_touches)
    ]
    return PwmMap(
        driver=driver,
        settings=settings,
        outputs=np.array(outputs, dtype=np.int64),
        touches=np.array(touches, dtype=np.int64),
        low_battery_v=section.low_battery_v,
        **pulses_of(section),
    )
