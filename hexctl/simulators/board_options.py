"""Options of simulated servo boards and buses."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from hexctl.errors import InputError, argument
from hexctl.options import RARE, Panel, Range, Typed, check_used
from hexctl.robot.servos.drivers import Driver
from hexctl.robot.servos.servo_models import BAUD, DEFAULT_BAUDS
from hexctl.server.serve_options import ServedOptions

BoardBackend = Literal["sim", "mock"]
EXPIRY_S = Range(low=0.05, high=1, unit="s")
RELEASE_S = Range(low=1, high=3600, unit="s")

CONNECTION = Panel("Connection")

#: Options that only a MAVLink board uses, and that only a bus uses.
OF_BOARD = ("connect", "pty", "expiry_s", "release_after_s", "credentials", "insecure", "link")
OF_BUS = ("model", "baud", "fault", "link")


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardOptions(ServedOptions):
    """Options of `hexctl sim board`; raises InputError for an invalid value."""

    PANEL: ClassVar = "Servo bus"

    backend: BoardBackend = "sim"
    """What the servos move: sim (simulation in real time) or mock (nothing)."""

    connect: str | None = None
    """Where controllers reach it: udpin:HOST:PORT (waits), udpout:HOST:PORT (calls) or a serial device such
    as /dev/ttyACM0:115200. (default: udpin:127.0.0.1:14550)
    """

    credentials: Annotated[str | Path | None, Typed(flag="keys"), RARE] = None
    """Folder with mavlink.key, the board's secret: only what it signed is obeyed. (default: none)"""

    insecure: Annotated[bool, RARE] = False
    """Let others than this computer command without that secret."""

    pty: Annotated[bool, CONNECTION] = False
    """Make a serial device instead, a pseudo-terminal, and print its name."""

    expiry_s: Annotated[float, EXPIRY_S, CONNECTION, RARE] = 0.2
    """Seconds without a command until the pose is held, {}."""

    release_after_s: Annotated[float, RELEASE_S, CONNECTION, RARE] = 10.0
    """Seconds without the controller until torque is disabled, {}."""

    bus: Driver | None = None
    """Simulate servos on a serial bus instead, on a pseudo-terminal: dynamixel, feetech, lx16a, or the board
    servo2040 with hobby servos; or two boards pca9685, on a socket. (default: a MAVLink board)
    """

    model: str | None = None
    """With --bus, model of all servos, such as ax12a or sts3215; with servo2040 its firmware, stock or fork.
    (default: that of the robot file, else xl430-w250, sts3215, lx16a or stock)
    """

    baud: Annotated[int | None, BAUD, RARE] = None
    """With --bus, bits per second: how long packets take, {}. (default: 1000000, with lx16a 115200, with
    pca9685 400000)
    """

    fault: Sequence[str] = ()
    """With --bus, what goes wrong, repeatable: mute:5:coxa@10, hot:2:femur:72@5, overload:4:femur@6,
    lost-id:3:tibia@8, same-id:3:tibia (that of the joint before it), only:1:coxa (all others are unplugged),
    bad-cable:3:femur:0.2, brown-out@12, battery:8.5@9 (volts), unplug@15, replug@18, garble:0.01, wild:0.01,
    wild-once@5, noise:0.5, echo; with servo2040 mute@10, trip:12@10, unplug@15, replug@18, garble:0.01; with
    pca9685 nack:0.01, reset@10, unplug@15, replug@18. (default: nothing)
    """

    def __post_init__(self) -> None:
        super(BoardOptions, self).__post_init__()
        if self.bus is None:
            check_used(self, OF_BUS, f"with {argument('bus')}")
        else:
            check_used(self, OF_BOARD, f"without {argument('bus')}")
        if self.bus == "servo2040" and self.baud is not None:
            raise InputError(
                f"{argument('baud')}: got {self.baud} with servo2040, a USB device; allowed: with other buses"
            )
        if self.bus == "pca9685" and self.model is not None:
            raise InputError(f"{argument('model')}: got {self.model} with pca9685; allowed: without")

    @property
    def signed(self) -> bool:
        """Whether only signed frames are accepted."""
        return self.credentials is not None

    @property
    def bits_per_s(self) -> int:
        """Speed of the line of a bus; 0 for a MAVLink board or a servo2040."""
        from hexctl.simulators.pca9685_board import BITS_PER_S

        usual = {"pca9685": BITS_PER_S, **DEFAULT_BAUDS}
        return self.baud or usual.get(str(self.bus), 0)
