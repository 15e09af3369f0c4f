"""Options of a search for a gait."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from hexctl.backends.robot_options import FAILURE, RobotOptions, check_backend_options
from hexctl.control.trial_plan import DURATION_S, HEADING_DEG, Hold, SelfRotation
from hexctl.errors import InputError, argument
from hexctl.options import RARE, UNTYPED, Panel, Range, Typed, check_fields
from hexctl.robot.failure import Failure
from hexctl.robot.failure_grammar import read_failures_before
from hexctl.types import TOO_HOT_C

#: What a search allows in place of a failure that comes during a walk.
BEFORE_SEARCH = "a failure before the search, such as 5:limp"

WALK, ON_ROBOT = Panel("Walk"), Panel("On a robot")

#: Whether a search trims its walks.
TrimChoice = Literal["auto", "off"]

BUDGET = Range(low=1, high=100_000, whole=True)

REPEATS = Range(low=0, whole=True)

GAIN_M = Range(low=0, unit="m")

#: Servos do not cool down below 25 degrees Celsius, and the guard stops a robot whose servos are too hot.
COOL_C = Range(low=25, high=TOO_HOT_C, unit="degrees Celsius")


@dataclass(frozen=True, slots=True, kw_only=True)
class AdaptOptions(RobotOptions):
    """Options of `hexctl adapt`; raises InputError for an invalid value."""

    PANEL: ClassVar = "Search"

    budget: Annotated[int, BUDGET] = 20
    """Most trials to walk, {}."""

    optimizer: Annotated[Any, Typed(words="optimizers")] = None
    """What chooses the next gait: {}, or package.module:Class. trim straightens one gait by its paths (see
    --trim), strides varies pace, step length and swing share, and bayes knows simulated worlds. (default:
    trim; strides for speed and cost; else bayes if a prior fits, else random)

    In Python also a class.
    """

    trim: TrimChoice = "auto"
    """Whether trials are trimmed: their course, and in open loop their turn, is corrected by what earlier
    walks drifted. off searches gaits only. (default: auto, with the objectives final and progress, --hold
    none or heading, and no other --optimizer)
    """

    prior: Annotated[str | Path | None, Typed(words="priors"), RARE] = None
    """Prior, what trim and bayes believe before the first trial: auto (made by hexctl prior build, or
    shipped), a file, or none. (default: auto)
    """

    early_stop: Annotated[bool, RARE] = False
    """With bayes: end a walk as soon as it is clear that it misses."""

    objective: Annotated[Any, Typed(words="objectives")] = "final"
    """What to make small: final, mean or max distance from the line of travel, progress (final, per share of
    the ideal distance walked); steered walks by their speed (time per metre), cost of transport, tilt or
    steadiness; or package.module:name for your own.

    In Python also an Objective, or a function of a valid `TrialResult`.
    """

    target: Annotated[str | float | None, Typed()] = None
    """Stop once the objective is this small: in its unit, which is metres (0.05), but s/m for speed, degrees
    for tilt and m/s for steadiness; or as a share of the ideal distance of a walk (1%); bayes once it is
    90 % sure, trim once a walk within it repeats that. (default: 0.025 with bayes and trim, else none)
    """

    target_m: Annotated[float | None, Range(low=0, above=True), UNTYPED] = None
    """The target as a number, in the unit of the objective."""

    worth_m: Annotated[float | None, GAIN_M, RARE] = None
    """With bayes: end the search once all trials that are left are expected to gain less than this, in
    metres, {}; 0 goes on whatever the gain. (default: the noise between trials, or the simulation's own
    uncertainty; 0.04 on a real robot; 1 % of the score of steered walks)
    """

    uncertainty_m: Annotated[float | None, GAIN_M, UNTYPED] = None
    """The simulation's own uncertainty of where walks end, counted when a gait is confirmed; None is the one
    that was measured for such walks, 0 counts none.
    """

    confirm: Annotated[int, REPEATS, RARE] = 0
    """Of the budget, trials kept to repeat the best gait, {}."""

    count_repeats: Annotated[bool, RARE] = False
    """Walk a gait again when the optimizer asks for it again."""

    baseline: Annotated[bool, UNTYPED] = True
    """Walk the gaits that the robot would use anyway, `auto`, its default and the tripod, before the first
    trial, to compare with; they do not count.
    """

    duration_s: Annotated[float, DURATION_S, WALK] = 30.0
    """Seconds that each trial walks, {}."""

    heading_rad: Annotated[float, HEADING_DEG, WALK, RARE] = 0.0
    """Direction of travel in degrees, {}, counter-clockwise from forward.

    In Python in rad.
    """

    self_rotation: Annotated[SelfRotation | None, RARE, WALK] = None
    """Turn before the walk until the failed leg points to the rear or the front of the way, or none: no turn.
    (default: none where the walks hold their line, else rear)
    """

    hold: Annotated[Hold | None, WALK] = None
    """What the walks hold by feedback: line, heading, auto (the best the robot allows) or none. (default:
    auto for speed, cost, tilt and steadiness, else none)
    """

    body_raise: Annotated[float | None, UNTYPED] = None
    """How much higher the body stands, as a fraction of the robot's size; None suits the leg where walks are
    steered, and else is 0.
    """

    recovery: Annotated[str | None, RARE, FAILURE, Typed(words="recoveries")] = None
    """What a trial does about another leg that it notices to have failed: stop, glide, or
    package.module:Class; such a trial does not count and ends the search. With walk-on no legs are
    watched. (default: walk-on)
    """

    arena_m: Annotated[float | None, Range(low=0, above=True, unit="m"), UNTYPED] = None
    """Radius in which a robot is kept that stays where a walk ends, around its first place."""

    home_m: Annotated[tuple[float, float] | list[float] | None, UNTYPED] = None
    """Middle (x, y) of the arena in the world, in place of the robot's first place."""

    cool_down_c: Annotated[float | None, COOL_C, RARE, ON_ROBOT] = None
    """With servos that tell their temperature: sit before each trial until all are cooler than this, in
    degrees Celsius, {}. (default: none, it does not wait)
    """

    ask: Annotated[bool, ON_ROBOT] = False
    """On a robot that does not know where it is: you put it on its mark before each trial and type in, in
    metres, where it ended.
    """

    def __post_init__(self) -> None:
        failures = read_failures_before(self.failure, self.failed_leg, BEFORE_SEARCH)
        if not failures:
            raise InputError(f"{argument('failed_leg')}: is missing; allowed: 1..6")
        if len(failures) > 1:
            legs = ",".join(str(one.leg) for one in failures)
            raise InputError(f"{argument('failed_leg')}: got {legs}; allowed: one leg")
        object.__setattr__(self, "failure", failures)
        object.__setattr__(self, "failed_leg", None)
        check_fields(self)

    def check(self) -> None:
        """Raise UnusedError for options that the backend would ignore, except the seed of the search."""
        if ":" not in self.backend:
            check_backend_options(self, but=("seed",))

    @property
    def broken(self) -> Failure:
        """The failure of the leg."""
        (failure,) = read_failures_before(self.failure, None, BEFORE_SEARCH)
        return failure
