"""A family of bus servos: all that is special about their protocol, in one value."""

from collections.abc import Mapping
from dataclasses import dataclass

from hexctl.backends.bus.packet_line import PacketLine
from hexctl.backends.bus.packets import PacketFormat
from hexctl.backends.bus.servo import Servo
from hexctl.backends.bus.servo_bus import ServoBus
from hexctl.backends.bus.servo_type import ServoType
from hexctl.errors import InputError, argument
from hexctl.robot.plugins import find_named
from hexctl.robot.servos.drivers import FAMILIES


@dataclass(frozen=True, kw_only=True, eq=False)
class Family:
    """Servos that share a protocol on a bus.

    Attributes:
        name: their driver in robot files and commands.
        models: the default first, and the likely one of each version of the protocol before its others.
        bauds: usual bits per second, the default first.
        formats: packets by version of the protocol, the likely one first; servos without registers have 1.
        servo: class of a single servo, by which tools ask it.
        bus: class of the servos of all joints.
        id_question: instruction that each servo answers with its id, also to a broadcast; None without one.
        ids_differ: whether the id of an unknown model may be at another address, and is never changed.
        modem_lines: whether DTR and RTS are set on an open port; some boards restart with them.
        simulated: its `hexctl.simulators.bus_servos.SimulatedServos`, as `package.module:Class`.
    """

    name: str
    models: tuple[ServoType, ...]
    bauds: tuple[int, ...]
    formats: Mapping[int, PacketFormat]
    servo: type[Servo]
    bus: type[ServoBus]
    id_question: int | None = None
    ids_differ: bool = False
    modem_lines: bool = True
    simulated: str

    @property
    def reports_model(self) -> bool:
        """Whether its servos report a model number."""
        return any(model.number is not None for model in self.models)

    def model(self, name: str | None) -> ServoType:
        """The model of a name, or the default for None; raises InputError for an unknown one."""
        for model in self.models:
            if name in (None, model.name):
                return model
        known = ", ".join(model.name for model in self.models)
        raise InputError(f"servos.model: got {name} with {self.name}; allowed: {known}")

    def servo_with(self, packets: PacketLine, protocol: int, servo_id: int) -> Servo:
        """One servo by its id, of the model that it reports, else of the likely one."""
        models = [model for model in self.models if model.protocol == protocol]
        return self.servo.identified(packets, servo_id, models)


def find_family(name: str, *, named: str = argument("driver")) -> Family:
    """Family of a driver's name, which messages call `named`; raises InputError as `find_named`."""
    return find_named("families", name, FAMILIES, Family, named)
