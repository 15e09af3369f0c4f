"""Interface of simulated servos on a bus."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from inspect import isclass
from pkgutil import resolve_name

import numpy as np

from hexctl.backends.bus.bus_map import BusMap
from hexctl.backends.bus.packets import PacketFormat
from hexctl.backends.bus.servo_type import ServoType
from hexctl.errors import InputError
from hexctl.simulators.board_faults import BusFaults
from hexctl.types import BoolArray, FloatArray, RobotState

#: Voltage and temperature of servos that nothing is wrong with, in V and degrees Celsius.
USUAL_V, USUAL_C = 12.0, 35.0


#: Counts of a bus: understood instructions, answers, packets with goals and garbage.
BUS_COUNTS = ("packets", "answers", "goals", "garbage")


class SimulatedServo(ABC):
    """One servo on a simulated bus."""

    usual_v = USUAL_V
    servo_id: int

    @property
    @abstractmethod
    def holds(self) -> bool:
        """Whether it holds its goal."""

    @abstractmethod
    def goal(self, now_s: float) -> float:
        """Count that it steers for at a time."""

    @abstractmethod
    def show(self, count: float, effort: float, voltage_v: float, temperature_c: float) -> None:
        """Set a count, a share of the maximum torque, a supply and a temperature."""

    @abstractmethod
    def trip(self, *, hot: bool = False) -> None:
        """Lose the torque because of an overload or heat, as the family does."""

    @abstractmethod
    def restart(self) -> None:
        """Restart after a loss of power, without torque."""

    def lose_id(self, servo_id: int) -> None:
        """Change the id, also after a restart."""
        self.servo_id = servo_id


class SimulatedServos(ABC):
    """Eighteen servos of one family on a simulated bus, initially at the counts `stance`, (18,).

    `counts` are those of the bus, by the names in `BUS_COUNTS`.
    """

    packets: PacketFormat
    servos: Sequence[SimulatedServo]

    def __init__(
        self, bus_map: BusMap, stance: FloatArray, faults: BusFaults, counts: dict[str, int]
    ) -> None:
        self._faults, self._counts = faults, counts
        self.packets = bus_map.family.formats[bus_map.protocol]
        parts = zip(bus_map.ids.tolist(), bus_map.models, stance.tolist(), strict=True)
        self.servos = [self._new_servo(*each) for each in parts]

    @abstractmethod
    def _new_servo(self, servo_id: int, model: ServoType, count: float) -> SimulatedServo:
        """A servo of the family that stands at a count."""

    @abstractmethod
    def obey(self, servo_id: int, instruction: int, parameters: bytes, now_s: float) -> list[bytes]:
        """Execute an instruction at a time; return the answers."""

    def busy_s(self, servo_id: int, instruction: int, parameters: bytes) -> float:
        """Time of an instruction on another line behind a board, which the next one waits for, in s."""
        return 0.0

    def reports(self, state: RobotState) -> list[bytes]:
        """What a board sends unasked in a control period."""
        return []

    def answer_together(self, servo_id: int, instruction: int) -> bool:
        """Whether several servos that an instruction asks answer at once, not in turn."""
        return True

    def show(self, counts: FloatArray, efforts: FloatArray) -> None:
        """Set the joints' counts and their shares of the maximum torques, (18,)."""
        for joint, servo in enumerate(self.servos):
            temperature_c = self._faults.temperatures.get(joint, USUAL_C)
            servo.show(counts[joint], efforts[joint], self._faults.voltage(servo.usual_v), temperature_c)
            if temperature_c > self._faults.HOT_C:
                servo.trip(hot=True)

    def goals(self, now_s: float) -> FloatArray:
        """Counts, (18,), that the servos steer for at a time."""
        return np.array([servo.goal(now_s) for servo in self.servos])

    def holds(self) -> BoolArray:
        """Which servos hold their goals, (18,)."""
        return np.array([servo.holds for servo in self.servos])

    def named(self, ids: Sequence[int]) -> list[int]:
        """Joints of some ids, in their order, without mute ones."""
        return [
            joint
            for servo_id in ids
            for joint, servo in enumerate(self.servos)
            if servo.servo_id == servo_id and not self._faults.mute[joint]
        ]


def simulated_servos(bus_map: BusMap) -> type[SimulatedServos]:
    """Simulated servos of a map's family; raises InputError for a family without any."""
    name = bus_map.family.simulated
    try:
        found = resolve_name(name)
    except (ImportError, AttributeError, ValueError) as error:
        raise InputError(f"simulated servos: {name} cannot be loaded ({error})") from error
    if not (isclass(found) and issubclass(found, SimulatedServos)):
        raise InputError(f"simulated servos: got {name}; allowed: a subclass of SimulatedServos")
    return found
