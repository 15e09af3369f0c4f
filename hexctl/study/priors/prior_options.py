"""Options for building a prior or a repertoire."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from hexctl.adapt.prior.prior import PRIOR_DURATION_S
from hexctl.control.trial_plan import SelfRotation
from hexctl.errors import argument
from hexctl.options import RARE, Panel, Range, Typed, check_fields, check_used, listed
from hexctl.robot.failure_grammar import parse_legs
from hexctl.study.study_options import ALL_LEGS, ComputeOptions

PriorHold = Literal["none", "heading", "line"]

#: Size of each leg's own block of worlds. Six legs see six times as many; each block is evenly spread.
WORLDS_PER_LEG = 1024
WORLDS = Range(low=2, high=WORLDS_PER_LEG, whole=True)
DIRECTIONS = Range(low=1, high=12, whole=True)

#: Two failed legs leave 24 codes: one is the safest, and as many as these are drawn.
CODES = Range(low=0, high=11, whole=True)

#: Options that only a repertoire takes, and those that only a prior takes.
OF_REPERTOIRE = ("directions", "codes", "pairs")
OF_PRIOR = ("legs", "failure", "self_rotation", "hold", "duration_s")

REPERTOIRE = Panel("Repertoire")


def _pairs(text: str) -> tuple[str, ...]:
    """Failures of both legs of pairs, from a text with commas; none for `none`."""
    return () if text == "none" else listed(text)


@dataclass(frozen=True, slots=True, kw_only=True)
class PriorOptions(ComputeOptions):
    """Options of `hexctl prior build`.

    Raises InputError for an invalid value, and for an option of the other kind of file.
    """

    PANEL: ClassVar = "Prior"

    robot: Annotated[str, Typed(words="robots")] = "ant"
    """Robot: a name that hexctl robot list prints, or a YAML file."""

    legs: Annotated[Sequence[int], Typed(parse=parse_legs)] = ALL_LEGS
    """Legs that fail, with commas."""

    failure: Annotated[str, Typed(words="failures")] = "locked"
    """How they fail: locked (stiff), limp, missing, weak:FRACTION of the torque, stuck:JOINT:DEGREES, or
    unknown to the controller.
    """

    hold: PriorHold = "none"
    """What the walks hold by feedback. With line or heading the prior is of their speed, cost, tilt and
    steadiness.
    """

    self_rotation: Annotated[SelfRotation | None, RARE] = None
    """Turn before the walk until the failed leg points to the rear or the front, or none: no turn. (default:
    rear, but none with --hold line)
    """

    duration_s: Annotated[float, PRIOR_DURATION_S] = 30.0
    """Seconds that each gait walks, {}, in steps of 2."""

    worlds: Annotated[int | None, WORLDS] = None
    """Worlds that each failed leg's gaits walk in, {}; with --repertoire of each family, up to 16. (default:
    16, with --repertoire 4)
    """

    family: Annotated[str | None, Typed(words="families"), RARE] = None
    """Family of worlds to draw from: randomised, or a YAML file; with --repertoire several with commas.
    (default: randomised, with --repertoire transfer,real)
    """

    out: Path | None = None
    """File to write, .npz. (default: runs/priors/ROBOT-FAILURE-ROTATION-SECONDS[-HOLD].npz, with --repertoire
    runs/repertoires/ROBOT.npz)
    """

    repertoire: Annotated[bool, REPERTOIRE] = False
    """Build a repertoire instead, for hexctl run --recover: gaits after each failure of a leg, a joint or two
    legs.
    """

    directions: Annotated[int | None, DIRECTIONS, RARE, REPERTOIRE] = None
    """With --repertoire, directions of travel, a whole number {}: 1, 2, 4, 6, 8 or 12. (default: 12)"""

    codes: Annotated[int | None, CODES, RARE, REPERTOIRE] = None
    """With --repertoire, next codes by the static margin, and as many at random, a whole number {}.
    (default: 2)
    """

    pairs: Annotated[Sequence[str] | None, Typed(parse=_pairs), RARE, REPERTOIRE] = None
    """With --repertoire, how both legs of pairs fail, with commas, or none. (default: locked,limp,missing)"""

    def __post_init__(self) -> None:
        check_fields(self)
        if self.repertoire:
            check_used(self, OF_PRIOR, f"without {argument('repertoire')}")
        else:
            check_used(self, OF_REPERTOIRE, f"with {argument('repertoire')}")
