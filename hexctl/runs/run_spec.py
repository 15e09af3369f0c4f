"""Checked options of a run, and the plan of its trial."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, ClassVar

from hexctl.backends.registry import check_options, option_values
from hexctl.backends.robot_options import FAILURE, RecordedOptions
from hexctl.control.monitor.recovery import MOST_RECOVERED, Recovery, default_recovery, make_recovery
from hexctl.control.planning.crawl import auto_gait
from hexctl.control.planning.leg_sets import doubt, leg_set
from hexctl.control.planning.static_stability import check_tucked, stable_slots_of
from hexctl.control.planning.top_speed import fast_gaits
from hexctl.control.trial_plan import (
    AUTO_ROTATION,
    DURATION_S,
    HEADING_DEG,
    TRIM_DEG,
    TURN_TRIM_DEG_S,
    AskedRotation,
    GaitChange,
    GroundOptions,
    Hold,
    TrialPlan,
    WalkOptions,
    suited_rotation,
)
from hexctl.control.walks.ground_contact import step_height
from hexctl.control.walks.turning import body_heading_rad
from hexctl.errors import InputError, UnusedError, argument
from hexctl.gait.encoding import code_count
from hexctl.gait.gait import (
    AUTO,
    BEST,
    DEFAULT_GAIT,
    SWING,
    SWING_SHARE,
    Gait,
    gait_text,
    make_gait,
    names_best,
    parse_slots,
)
from hexctl.gait.posture import POSTURE, Posture
from hexctl.options import RARE, UNTYPED, Typed, check_fields
from hexctl.recording.rrd import probe_file
from hexctl.robot.failure import Failure, FailureEvent
from hexctl.robot.failure_grammar import (
    AUTO_LEG,
    parse_legs,
    read_failures,
    read_healings,
)
from hexctl.robot.model import Robot

#: Options that cannot be combined with `fast`.
FAST_CHOOSES = ("pace_hz", "amplitude", "swing_share", "turn_rate_rad_s", "then")


def _shift(text: str) -> tuple[float, float]:
    try:
        forward, left = (float(part) for part in text.split(","))
    except ValueError:
        raise ValueError(f"got {text!r}; allowed: two numbers such as 0.02,-0.01") from None
    return forward, left


@dataclass(frozen=True, slots=True, kw_only=True)
class RunSpec(RecordedOptions, WalkOptions, GroundOptions):
    """Robot, backend and walk of a run. Its fields are the options of `hexctl run`."""

    PANEL: ClassVar = "Walk"

    gait: Annotated[str | int | Sequence[int] | Gait, Typed(parse=gait_text, words="gaits")] = DEFAULT_GAIT
    """Gait: demo, tripod, wave, ripple; auto (the most stable); best or best:SESSION (the best that is known
    for the failed leg); a code, 1..720, or 1..120 with a failed leg; or six slots such as 5,1,2,4,3,6.

    Slots say when in the cycle legs 1..6 step. In Python also a Gait.
    """

    chosen_gait: Annotated[bool, UNTYPED] = False
    """Whether the gait was chosen for the failed leg, as `auto` always is; the self-rotation `auto` depends
    on it. `best_gait` of `hexctl.adapt.best` says so.
    """

    heading_rad: Annotated[float | None, HEADING_DEG] = None
    """Direction of travel in degrees, {}, counter-clockwise from where the body points; 90 is to the left.
    (default: 0)

    In Python in rad. None is forward, or no travel in a turn in place.
    """

    duration_s: Annotated[float, DURATION_S] = 30.0
    """Seconds to walk, {}."""

    body_raise: Annotated[float | None, POSTURE, RARE] = None
    """How much higher the body stands, as a fraction of the robot's size, {}. (default: 0; with --gait auto
    0.012 off a locked leg that does not trail)
    """

    stance_shift: Annotated[tuple[float, float] | None, Typed(parse=_shift), RARE] = None
    """How far the body stands forward and to the left over its feet, as fractions of the robot's size, such
    as 0.02,-0.01. (default: 0,0)
    """

    tucked_legs: Annotated[Sequence[int], Typed(flag="tuck", parse=parse_legs), RARE] = ()
    """Legs held up in the air, of 1..6, with commas. (default: none)"""

    swing_share: Annotated[float | None, SWING, RARE] = None
    """How long a foot is in the air, as a fraction of the cycle, {}. (default: 1/3)"""

    fast: bool = False
    """Walk straight as fast as the servos follow: at the pace, amplitude and, with --gait auto and a failed
    leg, swing share that its joints allow. (default: at the robot's pace)
    """

    then: Annotated[Sequence[str | GaitChange], RARE] = ()
    """Change the gait in stride, to one that --gait takes, such as wave@10: from 10 s on; may be given
    several times, with times that ascend. (default: never)

    In Python also GaitChanges, which keep their pace, amplitude and posture.
    """

    heal: Annotated[Sequence[str | FailureEvent], RARE, FAILURE] = ()
    """In a simulation, let a leg be intact again: LEG@SECONDS, such as 5@20. Repeatable. (default: never)"""

    recovery: Annotated[str | Recovery | None, Typed(words="recoveries"), RARE, FAILURE] = None
    """What to do when a leg fails: walk-on, stop, glide (walk on without it), or package.module:Class.
    (default: glide with sim, else stop)

    In Python also a recovery.
    """

    self_rotation: Annotated[AskedRotation, RARE] = AUTO_ROTATION
    """Turn before the walk until the failed leg points to the rear or the front, or none: no turn. auto:
    none with --gait auto or best where the line is held, else rear.
    """

    hold: Hold = "auto"
    """What feedback holds: line (by position and yaw), heading (by yaw), none (open loop), or auto: the best
    that the robot's sensors allow.
    """

    trim_rad: Annotated[float | None, TRIM_DEG, RARE] = None
    """With --hold heading or --turn-trim, course correction in degrees, {}, counter-clockwise: after a walk
    that ended E to the left after S, -atan(E / S) more. (default: 0)

    In Python in rad.
    """

    turn_trim_rad_s: Annotated[float | None, TURN_TRIM_DEG_S, RARE] = None
    """With --hold none, turn that removes the curve of a straight walk, in degrees per second, {},
    counter-clockwise, as hexctl adapt learns it. (default: none)

    In Python in rad/s.
    """

    def __post_init__(self) -> None:
        legs = None if self.failed_leg == AUTO_LEG else self.failed_leg
        failures, events = read_failures(self.failure, legs)
        object.__setattr__(self, "failure", (*failures, *events))
        if self.failed_leg != AUTO_LEG:
            object.__setattr__(self, "failed_leg", None)
        object.__setattr__(self, "heal", read_healings(self.heal))
        check_fields(self)

    @property
    def failures(self) -> tuple[Failure, ...]:
        """Failures before the walk, by leg."""
        return read_failures(self.failure).failures

    @property
    def events(self) -> tuple[FailureEvent, ...]:
        """Simulated failures during the walk, and healings."""
        return (*read_failures(self.failure).events, *read_healings(self.heal))

    @property
    def simulated(self) -> bool:
        """Whether the robot is a simulation in this process."""
        return self.backend == "sim"

    @property
    def paced(self) -> bool:
        """Whether a wall clock paces the walk."""
        return self.realtime or not self.simulated

    @property
    def asks_for_best(self) -> bool:
        """Whether a gait is `best`, which `best_gait` finds."""
        return any(names_best(name) for name in (self.gait, *self.names_then))

    @property
    def names_then(self) -> tuple[str, ...]:
        """Names, codes or slots of the gaits to change to."""
        return tuple(str(change).rpartition("@")[0] for change in self.then)

    @property
    def records(self) -> bool:
        """Whether the walk is recorded."""
        return self.record is not None or self.record_folder is not None

    def made_recovery(self, *, failures_come: bool) -> Recovery:
        """The recovery, also for simulated failures during the walk; raises InputError."""
        usual = default_recovery(simulated=self.simulated, failures_come=failures_come)
        recovery = usual if self.recovery is None else self.recovery
        return make_recovery(recovery) if isinstance(recovery, str) else recovery

    @property
    def gait_text(self) -> str:
        """Name, code or slots of the gait."""
        gait = self.gait.slots if isinstance(self.gait, Gait) else self.gait
        return str(gait) if isinstance(gait, str | int) else ",".join(str(slot) for slot in gait)

    def check(self) -> None:
        """Raise InputError for options that the backend would ignore, and for an impossible recording."""
        # A failure also belongs to the plan: on a real robot it informs the controller.
        check_options(self.backend, **option_values(self, but=("robot", "failures", "events")))
        for event in self.events:
            check_options(self.backend, names={"events": _option_of(event)}, events=str(event))
        names = ("pace_hz", "amplitude", "height", "body_raise", "stance_shift", "swing_share")
        steps = {name: getattr(self, name) for name in names} | {"tucked_legs": self.tucked_legs or None}
        self._check_fast()
        steps["fast"] = self.fast or None
        for name, value in steps.items() if isinstance(self.gait, Gait) else ():
            if value is not None:
                raise InputError(
                    f"{argument(name)} cannot be combined with a Gait, or with a session that has searched "
                    "strides; allowed: with a name, a code or slots"
                )
        self._check_course()
        if len(self.failures) > 1 and self.self_rotation not in (AUTO_ROTATION, "none"):
            raise InputError(
                f"{argument('self_rotation')}: got {self.self_rotation} with failed legs "
                f"{', '.join(str(one.leg) for one in self.failures)}; allowed: {AUTO_ROTATION}, none"
            )
        late = [event for event in self.events if event.at_s >= self.duration_s]
        if late:
            what = argument(_option_of(late[0]))
            raise InputError(f"{what}: got {late[0]}; allowed: before {self.duration_s:g} s, the end")
        if self.record is not None:
            probe_file(Path(self.record))

    def _check_course(self) -> None:
        """Raise UnusedError for trims that the hold does not use, and a hold that a turn does not."""
        trim, turn_trim = argument("trim_rad"), argument("turn_trim_rad_s")
        if self.turn_trim_rad_s is not None and self.hold != "none":
            raise UnusedError(f"{turn_trim} requires {argument('hold')} none; got {self.hold}")
        if self.trim_rad is not None and self.hold != "heading" and self.turn_trim_rad_s is None:
            raise UnusedError(f"{trim} requires {argument('hold')} heading or {turn_trim}; got {self.hold}")
        arc = self.turn_rate_rad_s is not None and (self.turn_rate_rad_s or self.heading_rad is None)
        if self.trim_rad is not None and arc:
            raise UnusedError(f"{trim} cannot be combined with a turn, which holds no heading")
        if arc and self.hold in ("heading", "line"):
            raise UnusedError(
                f"{argument('hold')}: got {self.hold} with {argument('turn_rate_rad_s')}; allowed: in a "
                "straight walk; with a turn auto or none"
            )

    def _check_fast(self) -> None:
        """Raise UnusedError for options that `fast` chooses or excludes."""
        for name in FAST_CHOOSES if self.fast else ():
            if getattr(self, name):
                raise UnusedError(
                    f"{argument('fast')}: got {argument(name)} too; allowed: one or the other", field=name
                )


def _option_of(event: FailureEvent) -> str:
    return "heal" if event.failure is None else "failure"


def spec_of(options: Mapping[str, Any]) -> RunSpec:
    """Spec of keywords, the fields of `RunSpec`; `record=False` leaves no recording."""
    given = dict(options)
    if given.get("record") is False:
        given["record"] = given["record_folder"] = None
    return RunSpec(**given)


def plan_of(spec: RunSpec, robot: Robot) -> TrialPlan:
    """Plan of the trial of a spec; raises InputError for a bad gait, posture or motion."""
    if spec.failed_leg == AUTO_LEG:
        raise InputError(
            f"{argument('failed_leg')}: got {AUTO_LEG}, which stands for a leg; allowed: 1..6, or the "
            "failures that hexctl.diagnose() finds"
        )
    _check_found(spec)
    plan = _asked_plan(spec, _gait_of(spec, robot))
    stand_up = spec.body_raise is None
    if spec.gait == AUTO:
        _check_recoverable(plan, robot)
        plan = replace(plan, gait=auto_gait(robot, plan, stand_up=stand_up))
    if spec.fast:
        plan = replace(plan, gait=_fast(spec, robot, plan))
    check_tucked(robot, plan)
    return replace(plan, changes=_changes_of(spec.then, robot, plan, stand_up=stand_up))


def _gait_of(spec: RunSpec, robot: Robot) -> Gait:
    """For `auto` the default gait, of which only the slots are replaced."""
    if isinstance(spec.gait, Gait):
        return spec.gait
    if names_best(spec.gait):
        raise InputError(
            f"{argument('gait')}: got {spec.gait}, which stands for another; allowed: the spec that "
            "hexctl.adapt.best.best_gait(spec) gives for it"
        )
    gait = make_gait(
        robot,
        "demo" if spec.gait == AUTO else spec.gait,
        pace_hz=spec.pace_hz,
        amplitude=spec.amplitude,
        height=step_height(robot, spec.feet) if spec.height is None else spec.height,
        failed_legs=tuple(one.leg for one in spec.failures),
        besides=_besides(spec.failures),
    )
    posture = Posture(
        body_raise=spec.body_raise or 0.0,
        shift=spec.stance_shift or (0.0, 0.0),
        tucked_legs=tuple(spec.tucked_legs),
    )
    swing_share = SWING_SHARE if spec.swing_share is None else spec.swing_share
    return replace(gait, posture=posture, swing_share=swing_share)


def _fast(spec: RunSpec, robot: Robot, plan: TrialPlan) -> Gait:
    heading_rad = body_heading_rad(robot, plan)
    gaits = fast_gaits(
        robot, plan.gait, heading_rad=heading_rad, lost=plan.failed_legs, reorder=spec.gait == AUTO
    )
    if not gaits:
        raise InputError(
            f"{argument('fast')}: the servos of {robot.name} do not carry this gait at any pace; "
            "allowed: without; hexctl check says which joint is too weak"
        )
    return gaits[0]


def _asked_plan(spec: RunSpec, gait: Gait) -> TrialPlan:
    in_place = spec.turn_rate_rad_s is not None and spec.heading_rad is None
    rotation = suited_rotation(
        "none" if len(spec.failures) > 1 else spec.self_rotation,
        "none" if spec.turn_rate_rad_s is not None else spec.hold,
        chosen_gait=spec.gait == AUTO or spec.chosen_gait,
    )
    return TrialPlan(
        gait=gait,
        level=spec.level,
        heading_rad=spec.heading_rad or 0.0,
        travel=0.0 if in_place else 1.0,
        turn_rate_rad_s=spec.turn_rate_rad_s or 0.0,
        duration_s=spec.duration_s,
        failures=spec.failures,
        self_rotation=rotation,
        hold=spec.hold,
        feet=spec.feet,
        trim_rad=spec.trim_rad or 0.0,
        turn_trim_rad_s=spec.turn_trim_rad_s,
    )


def _check_recoverable(plan: TrialPlan, robot: Robot) -> None:
    """Raise InputError for more failed legs than `auto` has gaits for."""
    if len(plan.failed_legs) > MOST_RECOVERED:
        raise InputError(
            f"{argument('failed_leg')}: got {','.join(map(str, plan.failed_legs))} with {argument('gait')} "
            f"{AUTO}; {doubt(leg_set(robot, plan.gait, plan.failed_legs, (plan.heading_rad,)))}; allowed: "
            f"one leg or two, or a gait by its name or code, 1..{code_count(plan.failed_legs)}"
        )


def _besides(failures: Sequence[Failure]) -> tuple[str, str]:
    return AUTO, BEST if failures else f"{BEST} (with a failed leg)"


def name_and_time(text: str) -> tuple[str, float]:
    """Gait and time of a change such as `wave@10`; raises InputError for another text."""
    name, at, time_text = text.rpartition("@")
    try:
        time_s = float(time_text)
    except ValueError:
        at, time_s = "", 0.0
    if not at:
        raise InputError(
            f"{argument('then')}: got {text!r}; allowed: a gait and a time in s, such as wave@10"
        )
    return name, time_s


def _check_found(spec: RunSpec) -> None:
    if len(spec.failures) < 2 or AUTO not in (spec.gait, *spec.names_then):
        return
    for name in ("swing_share", "stance_shift"):
        if (value := getattr(spec, name)) is not None:
            got = ",".join(f"{one:g}" for one in (value if isinstance(value, tuple | list) else (value,)))
            raise InputError(
                f"{argument(name)}: got {got} with failed legs "
                f"{', '.join(str(one.leg) for one in spec.failures)} and {argument('gait')} {AUTO}, which "
                "finds its own; allowed: with one failed leg, or with a gait by its name, code or slots"
            )


def _changes_of(
    asked: Sequence[str | GaitChange], robot: Robot, plan: TrialPlan, *, stand_up: bool
) -> tuple[GaitChange, ...]:
    """Raises InputError for times that do not ascend."""
    changes = tuple(_change_of(one, robot, plan, stand_up=stand_up) for one in asked)
    for (first, before), (second, after) in pairwise(zip(asked, changes, strict=True)):
        if after.at_s <= before.at_s:
            raise InputError(
                f"{argument('then')}: got {first} and then {second}; allowed: times that ascend, one gait "
                "at each"
            )
    return changes


def _change_of(asked: str | GaitChange, robot: Robot, plan: TrialPlan, *, stand_up: bool) -> GaitChange:
    """A change, or that of a text such as `wave@10`: in the posture of the plan's gait without its crawl.

    With `stand_up` the body stands up for the gait `auto` with more than one failed leg.
    """
    name, time_s = ("", asked.at_s) if isinstance(asked, GaitChange) else name_and_time(asked)
    if names_best(name):
        raise InputError(
            f"{argument('then')}: got {asked!r}, which stands for another gait; allowed: the spec that "
            "hexctl.adapt.best.best_gait(spec) gives for it"
        )
    if time_s >= plan.duration_s:
        raise InputError(f"{argument('then')}: got {asked}; allowed: before {plan.duration_s:g} s, the end")
    if isinstance(asked, GaitChange):
        return asked
    if name == AUTO and len(plan.failures) > 1:
        return GaitChange(gait=auto_gait(robot, plan, stand_up=stand_up), at_s=time_s)
    try:
        slots = (
            stable_slots_of(robot, plan)
            if name == AUTO
            else parse_slots(name, plan.failed_legs, _besides(plan.failures))
        )
    except InputError as error:
        raise InputError(f"{argument('then')}: got {asked!r} ({error})") from error
    plain = replace(plan.gait, slots=slots)
    if plan.gait.phases is not None:  # a gait of slots has the swings of the paper
        posture = replace(plan.gait.posture, shift=(0.0, 0.0))
        plain = replace(plain, phases=None, swing_share=SWING_SHARE, posture=posture)
    return GaitChange(gait=plain, at_s=time_s)
