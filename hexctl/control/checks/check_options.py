"""Options of a check of a robot."""

from dataclasses import dataclass
from typing import Annotated, ClassVar

from hexctl.control.trial_plan import DURATION_S, HEADING_DEG, WalkOptions
from hexctl.errors import argument
from hexctl.gait.gait import DEFAULT_GAIT, gait_text
from hexctl.options import RARE, Panel, Typed, check_fields, check_used

#: Options that only a measurement of the simulation uses.
OF_PHYSICS = ("world", "duration_s")

FINDINGS, SIMULATION = Panel("Findings"), Panel("Simulation")


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckOptions(WalkOptions):
    """Options of a check of a robot; raises InputError for invalid values and combinations."""

    PANEL: ClassVar = "Walk"

    robot: Annotated[str, Typed(words="robots")] = "ant"
    """The robot, as an option: a name that hexctl robot list prints, or a YAML file."""

    gait: Annotated[str, Typed(parse=gait_text, words="gaits")] = DEFAULT_GAIT
    """Gait: demo, tripod, wave, ripple; auto (the most stable); a code, 1..720; or six slots such as
    5,1,2,4,3,6.
    """

    heading_rad: Annotated[float | None, HEADING_DEG] = None
    """Direction of travel in degrees, {}, counter-clockwise from forward. (default: all round, every 15)

    In Python in rad.
    """

    envelope: Annotated[bool, FINDINGS] = False
    """Print the maximum velocities by direction, and the static margins with and without each leg."""

    leg_sets: Annotated[bool, FINDINGS] = False
    """Print without which legs the robot can walk, one, two or three, by the static margin."""

    physics: Annotated[bool, SIMULATION] = False
    """Measure the simulation's own uncertainty, in a minute or two, and keep it under runs/ for adapt and
    study.
    """

    world: Annotated[str | None, Typed(words="worlds"), RARE, SIMULATION] = None
    """With --physics, the simulated world: flat, slippery, slope, rough, a YAML file, or one of a family such
    as randomised:7. (default: flat)
    """

    duration_s: Annotated[float | None, DURATION_S, RARE, SIMULATION] = None
    """With --physics, seconds that each gait walks, {}. (default: 30)"""

    def __post_init__(self) -> None:
        check_fields(self)
        if not self.physics:
            check_used(self, OF_PHYSICS, f"with {argument('physics')}")
