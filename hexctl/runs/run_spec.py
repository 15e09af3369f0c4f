"""Checked options of a run."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar

from hexctl.backends.registry import check_options, option_values
from hexctl.backends.robot_options import FAILURE, RecordedOptions
from hexctl.control.monitor.recovery import MOST_RECOVERED, Recovery, default_recovery, make_recovery
from hexctl.control.policy.policy import Policy
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
    WalkOptions,
)
from hexctl.errors import InputError, UnusedError, argument
from hexctl.gait.gait import (
    AUTO,
    BEST,
    DEFAULT_GAIT,
    SWING,
    Gait,
    gait_text,
    names_best,
)
from hexctl.gait.posture import POSTURE
from hexctl.options import RARE, UNTYPED, Range, Typed, check_fields, check_used
from hexctl.recording.rrd import probe_file
from hexctl.robot.failure import Failure, FailureEvent
from hexctl.robot.failure_grammar import (
    AUTO_LEG,
    parse_legs,
    read_failures,
    read_healings,
)

#: Forward speed of a walk by a policy.
SPEED_M_S = Range(low=0, high=5, unit="m/s")

#: Options of gaits, which a policy does not have, by field.
OF_GAITS = (
    "gait",
    "pace_hz",
    "amplitude",
    "height",
    "body_raise",
    "stance_shift",
    "tucked_legs",
    "swing_share",
    "fast",
    "then",
    "recovery",
    "self_rotation",
    "hold",
    "trim_rad",
    "turn_trim_rad_s",
    "level",
    "feet",
)

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

    policy: Annotated[str | Path | Policy | None, Typed(words="")] = None
    """Walk by a trained policy instead of a gait: an ONNX file with a contract, as hexctl policy show
    prints. (default: none)

    In Python also a Policy.
    """

    speed_m_s: Annotated[float | None, SPEED_M_S, Typed(flag="speed"), RARE] = None
    """With --policy, commanded speed in metres per second, {}, in the direction of --heading. (default: half
    of the maximum that the policy was trained with)
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
    def failed_legs(self) -> tuple[int, ...]:
        """Legs that have failed before the walk, ascending."""
        return tuple(one.leg for one in self.failures)

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
        self._check_policy()
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
                f"{', '.join(map(str, self.failed_legs))}; allowed: {AUTO_ROTATION}, none"
            )
        late = [event for event in self.events if event.at_s >= self.duration_s]
        if late:
            what = argument(_option_of(late[0]))
            raise InputError(f"{what}: got {late[0]}; allowed: before {self.duration_s:g} s, the end")
        if self.record is not None:
            probe_file(Path(self.record))

    def check_gaits(self) -> None:
        """Raise InputError for a leg or a gait that stands for another, and legs that `auto` cannot spare."""
        if self.failed_leg == AUTO_LEG:
            raise InputError(
                f"{argument('failed_leg')}: got {AUTO_LEG}, which stands for a leg; allowed: 1..6, or the "
                "failures that hexctl.diagnose() finds"
            )
        if self.asks_for_best:
            raise InputError(
                f"{argument('gait' if names_best(self.gait) else 'then')}: got {BEST}, which stands for "
                "another gait; allowed: the spec that hexctl.adapt.best.best_gait(spec) gives for it"
            )
        if len(self.failures) < 2 or AUTO not in (self.gait, *self.names_then):
            return
        legs = f"{','.join(map(str, self.failed_legs))} with {argument('gait')} {AUTO}"
        if len(self.failures) > MOST_RECOVERED:
            raise InputError(
                f"{argument('failed_leg')}: got {legs}; no gait keeps a robot up on three legs; "
                "allowed: one leg or two, or a gait by its name or code"
            )
        for name in ("swing_share", "stance_shift"):
            if (got := getattr(self, name)) is not None:
                raise InputError(
                    f"{argument(name)}: got {got} for failed legs {legs}, which chooses it; "
                    "allowed: with one failed leg, or with a gait by its name, code or slots"
                )

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

    def _check_policy(self) -> None:
        """Raise UnusedError for options of gaits with a policy, and for a speed without one."""
        if self.policy is not None:
            check_used(self, OF_GAITS, f"without {argument('policy')}, which walks without a gait")
            if self.failed_leg == AUTO_LEG:
                raise UnusedError(f"{argument('failed_leg')}: got {AUTO_LEG}; allowed: 1..6 with a policy")
        elif self.speed_m_s is not None:
            raise UnusedError(
                f"{argument('speed_m_s')} requires {argument('policy')}; allowed: {argument('pace_hz')} or "
                f"{argument('amplitude')} with a gait"
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


def name_and_time(text: str) -> tuple[str, float]:
    """Gait and time of a change such as `wave@10`; raises InputError for another text."""
    name, _, time_text = text.rpartition("@")
    with suppress(ValueError):
        if name:
            return name, float(time_text)
    raise InputError(f"{argument('then')}: got {text!r}; allowed: a gait and a time in s, such as wave@10")
