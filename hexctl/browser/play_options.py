"""Options of a robot to play with in the browser."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

from hexctl.backends.robot_options import SEED
from hexctl.control.trial_plan import GroundOptions
from hexctl.errors import InputError, argument
from hexctl.gait.gait import CHOSEN_GAITS, DEFAULT_GAIT, gait_text
from hexctl.options import RARE, Panel, Range, Typed, check_fields
from hexctl.teleop.drive_options import DriveHold

PAGE = Panel("Page")


@dataclass(frozen=True, slots=True, kw_only=True)
class PlayOptions(GroundOptions):
    """The simulated robot of `hexctl play` and its page; the page changes most of it without a restart.

    Raises InputError for an invalid value.
    """

    PANEL: ClassVar = "Robot"

    robot: Annotated[str | Path, Typed(words="robots")] = "ant"
    """Robot: a shipped name, such as phantomx, or a YAML file."""

    world: Annotated[str | Path, Typed(words="worlds")] = "flat"
    """Simulated world: flat, steps or another name, a YAML file, or one of a family such as transfer:504."""

    seed: Annotated[int, SEED, RARE] = 0
    """Seed of bumps and noise, a whole number, {}."""

    gait: Annotated[str, Typed(parse=gait_text, words="gaits"), Panel("Walk")] = DEFAULT_GAIT
    """Gait: demo, tripod, wave, ripple; a code, 1..720; or six slots such as 5,1,2,4,3,6."""

    recovery: Annotated[str, Typed(words="recoveries"), RARE, Panel("Walk")] = "glide"
    """Response to a failed leg: walk-on, stop, glide, or package.module:Class."""

    hold: Annotated[DriveHold, Panel("Walk")] = "auto"
    """Correct slip with the measured pose or yaw (auto), or walk in open loop (none)."""

    race: Annotated[bool, Panel("Walk")] = False
    """Show a second, grey robot that walks the same commands without recovery."""

    page_port: Annotated[int, Range(low=0, high=65535, whole=True), PAGE] = 8016
    """Port of the page on this computer, a whole number, {}; 0 takes a free one."""

    open_browser: Annotated[bool, PAGE] = True
    """Open the page in the browser of this computer, if it has a display."""

    def __post_init__(self) -> None:
        check_fields(self)
        if self.gait.partition(":")[0] in CHOSEN_GAITS:
            raise InputError(f"{argument('gait')}: got {self.gait}; allowed: a gait by name, code or slots")
