"""Options of a manual drive: robot, walk and input devices."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from hexctl.backends.robot_options import FAILURE, RobotOptions, check_backend_options
from hexctl.control.trial_plan import GroundOptions
from hexctl.errors import InputError, argument
from hexctl.gait.gait import CHOSEN_GAITS, DEFAULT_GAIT, gait_text
from hexctl.gait.posture import POSTURE
from hexctl.options import RARE, Panel, Typed, check_fields, check_used
from hexctl.teleop.page_options import PageOptions

DriveHold = Literal["auto", "none"]

RECORDING, WALK = Panel("Recording"), Panel("Walk")


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveOptions(PageOptions, RobotOptions, GroundOptions):
    """Input devices of a drive, and its walk. Its fields are the options of `hexctl drive`.

    Raises InputError for an invalid value.
    """

    PANEL: ClassVar = "Driving"

    keyboard: Annotated[bool, RARE] = True
    """Drive with the keys of this terminal."""

    gamepad: Annotated[str | None, Typed(words="gamepads")] = None
    """Drive with a gamepad while a shoulder button is held: auto takes the first that is plugged in, at any
    time; or its event file, or none. (default: auto)
    """

    page_view: Annotated[str | None, RARE] = None
    """Show on the page what a camera sees: the http or https URL of its stream or picture, such as
    http://127.0.0.1:8018/stream.mjpg of hexctl see. (default: none)
    """

    gait: Annotated[str, Typed(parse=gait_text, words="gaits"), WALK] = DEFAULT_GAIT
    """Gait: demo, tripod, wave, ripple; a code, 1..720; or when in the cycle legs 1..6 step, six slots such
    as 5,1,2,4,3,6.
    """

    policy: Annotated[Path | None, WALK] = None
    """Walk by a trained policy instead of a gait, within the velocities of its contract: an ONNX file.
    (default: none)
    """

    body_raise: Annotated[float, POSTURE, WALK, RARE] = 0.0
    """How much higher the body stands, as a fraction of the robot's size, {}."""

    hold: Annotated[DriveHold, WALK] = "auto"
    """Correct slip with the pose or the yaw that the robot measures (auto), or walk in open loop (none)."""

    recovery: Annotated[str | None, FAILURE, RARE, Typed(words="recoveries")] = None
    """What to do about a leg that is noticed to have failed: walk-on, stop, glide, or package.module:Class.
    (default: glide with sim, else stop)
    """

    record: Annotated[Path | None, RECORDING] = None
    """Recording to write, a new .rrd file, whose folder is made. (default: none)"""

    def check(self) -> None:
        """Raise UnusedError for options that the backend would ignore."""
        check_backend_options(self)

    def __post_init__(self) -> None:
        check_fields(self)
        if self.gait.partition(":")[0] in CHOSEN_GAITS:
            raise InputError(
                f"{argument('gait')}: got {self.gait}, chosen for a failed leg before a walk; "
                "allowed: a gait by name, code or slots"
            )
        self.check_page()
        if self.page is None and self.page_view is not None:
            raise InputError(f"{argument('page_view')}: used without --page; allowed: with --page HOST:PORT")
        if self.policy is not None:
            names = ("gait", "body_raise", "level", "feet", "hold", "recovery")
            check_used(self, names, f"without {argument('policy')}, which walks without a gait")
        self._check_devices()

    def _check_devices(self) -> None:
        if self.page_view is not None:
            from hexctl.teleop.picture_relay import PictureRelay

            PictureRelay(self.page_view)
        if self.pad is not None:
            from hexctl.teleop.gamepad import check_gamepad

            check_gamepad(self.pad)

    def check_keys(self, *, terminal: bool) -> None:
        """Raise InputError without any input device; `terminal` is whether there are keys."""
        if (self.keyboard and terminal) or self.page or self.gamepad not in (None, "none"):
            return
        others = "--page HOST:PORT, or --gamepad auto"
        if not self.keyboard:
            raise InputError(f"--no-keyboard requires another input device; allowed: {others}")
        raise InputError(f"--keyboard: got no terminal to read keys from; allowed: a terminal, {others}")

    @property
    def pad(self) -> Path | None:
        """The given event file of a gamepad."""
        return None if self.gamepad in (None, "auto", "none") else Path(str(self.gamepad))
