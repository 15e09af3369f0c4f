"""`hexctl identify` as a library call: a robot's servos and trunk from its motions, or a servo on a bench."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from hexctl.backends.clock import PERIOD_S
from hexctl.backends.robot_options import RecordedOptions
from hexctl.backends.sim.world import World, load_world
from hexctl.control.preparation import WalkStart
from hexctl.errors import InputError, argument
from hexctl.identify.bench_run import BenchRun, fit_bench, read_bench_run
from hexctl.identify.fit import Fit, OnStage, Replay, fit_values, mean_errors_rad, near_values
from hexctl.identify.parameters import OF_TRUNK, PARAMETERS, SCALE, Estimate, RobotValues
from hexctl.identify.robot_log import OF_JOINTS, RobotLog, read_robot_log
from hexctl.identify.stand_motions import StandMotions
from hexctl.options import check_names
from hexctl.robot.model import Robot
from hexctl.runs.run import Run, RunResult
from hexctl.runs.run_spec import RunSpec
from hexctl.types import ArrayFields
from hexctl.waiting import StopRequested, never

#: Gain below which a search ends: legs differ, and no values explain all of them.
ROBOT_GAIN = 5e-3

#: Number of starts near whose values a first search looks for a minimum.
BEST_STARTS = 3

#: Error at which no other start can be better.
CLEAR_RAD = np.radians(0.1)

#: Least friction of a start, as a share of the torque: the effect of none cannot be measured.
LEAST_FRICTION = 0.02

#: Ranges of multiples of the robot file's values. Motions do not show a torque limit that is too large.
RANGES = {
    "stiffness_nm_per_rad": (0.6, 2.0),
    "damping_nm_s_per_rad": (0.5, 3.0),
    "rotor_inertia_kg_m2": (0.5, 5.0),
    "dry_friction_nm": (1.0, 5.0),
    "max_torque_nm": (0.2, 1.0),
}

#: Largest addition to the dead time, and number of drawn starts.
MOST_MORE_S, STARTS = 0.04, 63

#: Least number of bench runs of which every other one is kept to judge the result.
ENOUGH_TO_JUDGE = 4


@dataclass(frozen=True, slots=True, eq=False)
class Identification(ArrayFields):
    """Identified servos, and the trunk that they carry.

    Attributes:
        fit: values, uncertainties, and errors by log; the stiffness of a bench is per unit of P gain.
        judged_rad: mean absolute error of each judged bench run, by its name; empty for robots.
        replays: fitted logs, then judged ones.
        p_gain: by which a stiffness of a bench is multiplied; 1 for robots.
    """

    fit: Fit[Any]
    judged_rad: dict[str, float]
    replays: tuple[Replay[Any], ...]
    p_gain: float = 1.0

    @property
    def estimates(self) -> dict[str, Estimate]:
        """All identified values, by the names of `PARAMETERS`; the stiffness at the P gain."""
        one = self.fit.estimates[SCALE]
        stiffness = replace(one, value=one.value * self.p_gain, deviation=one.deviation * self.p_gain)
        return {**self.fit.estimates, SCALE: stiffness}

    @property
    def not_seen(self) -> list[str]:
        """Parameters of the trunk that no log shows, because none is of a robot on its feet."""
        trunk = OF_TRUNK if isinstance(self.fit.values, RobotValues) else ()
        return [name for name in trunk if name not in self.fit.estimates]

    def to_dict(self) -> dict[str, Any]:
        """The object that `hexctl identify --json` prints: angles in degrees."""
        return {
            "servo": {name: one.to_dict() for name, one in self.estimates.items() if name not in OF_TRUNK},
            "trunk": {name: one.to_dict() for name, one in self.estimates.items() if name in OF_TRUNK},
            "error_deg": {
                "before": _mean_deg(self.fit.before_rad),
                "after": _mean_deg(self.fit.after_rad),
                "judged": _mean_deg(self.judged_rad) if self.judged_rad else None,
            },
            "logs": [one.name for one in self.replays],
        }


def _mean_deg(errors_rad: Mapping[str, float]) -> float:
    return float(np.degrees(np.mean(list(errors_rad.values()))))


def identify(
    logs: Sequence[str | Path],
    *,
    robot: Robot | None = None,
    p_gain: int | None = None,
    on_step: OnStage = lambda _stage, _step, _error_rad: None,
) -> Identification:
    """Servos that explain logs: recordings (.rrd) of a robot, or runs (.json) of one servo on a bench.

    Args:
        robot: replaces that of the recordings; its geometry and the masses of its legs are taken as right.
        p_gain: of the firmware on the robot; None for the largest of the runs on the bench, rounded.
        on_step: follows the search.

    Raises InputError for files that cannot be read, or of both kinds.
    """
    paths = [Path(one) for one in logs]
    kinds = {path.suffix for path in paths}
    if kinds == {".json"}:
        return _of_bench([read_bench_run(path) for path in paths], p_gain, on_step)
    if kinds != {".rrd"}:
        raise InputError(
            f"LOG: got {', '.join(sorted(kinds)) or 'none'}; allowed: recordings (.rrd) of a robot, or runs "
            "(.json) of a servo on a bench"
        )
    if p_gain is not None:
        raise InputError(f"{argument('p_gain')}: got one with recordings; allowed: with runs on a bench")
    replays = tuple(read_robot_log(path, robot) for path in paths)
    return Identification(_fit_robot(replays, on_step), {}, replays)


def _fit_robot(replays: Sequence[RobotLog], on_step: OnStage) -> Fit[RobotValues]:
    """Values of servos and trunk: roughly those of the servos first, from several starts."""
    coarse = [one.coarse() for one in replays]
    ranked = [one for one in coarse if one.on_stand] or coarse
    near: list[tuple[float, RobotValues]] = []
    starts = sorted(_starts_of(replays[0].robot), key=partial(_error_rad, ranked))[:BEST_STARTS]
    for number, start in enumerate(starts, 1):
        stage = f"fastest part, start {number} of up to {BEST_STARTS}"
        near.append(near_values(coarse, start, OF_JOINTS, partial(on_step, stage)))
        if near[-1][0] < CLEAR_RAD:
            break
    _, best = min(near, key=itemgetter(0))
    searched = [name for name in PARAMETERS if any(name in one.parameters for one in replays)]
    _, best = near_values(replays, best, searched, partial(on_step, "complete logs"))
    fine = partial(on_step, "complete logs, fine")
    found = fit_values(replays, best, searched, enough_gain=ROBOT_GAIN, on_step=fine)
    return replace(found, before_rad=mean_errors_rad(replays, RobotValues.of(replays[0].robot)))


def _starts_of(robot: Robot) -> list[RobotValues]:
    """Values of a robot file, with some friction, and drawn ones: a search ends near its start."""
    file = RobotValues.of(robot)
    friction_nm = max(file.dry_friction_nm, LEAST_FRICTION * file.max_torque_nm)
    file = replace(file, dry_friction_nm=friction_nm)
    low, high = np.array(list(RANGES.values())).T
    shares = np.random.default_rng(0).uniform(size=(STARTS, len(RANGES) + 1))
    factors = low * (high / low) ** shares[:, :-1]
    return [file] + [
        replace(
            file,
            dead_time_s=min(file.dead_time_s + MOST_MORE_S * late, PARAMETERS["dead_time_s"].high),
            **{name: factor * getattr(file, name) for name, factor in zip(RANGES, row, strict=True)},
        )
        for row, late in zip(factors.tolist(), shares[:, -1].tolist(), strict=True)
    ]


def _error_rad(replays: Sequence[RobotLog], values: RobotValues) -> float:
    return sum(mean_errors_rad(replays, values).values())


def _of_bench(runs: Sequence[BenchRun], p_gain: int | None, on_step: OnStage) -> Identification:
    fitted, judged = (runs[::2], runs[1::2]) if len(runs) >= ENOUGH_TO_JUDGE else (runs, [])
    fit = fit_bench(fitted, on_step)
    gain = max(1, round(max(run.p_gain for run in runs))) if p_gain is None else p_gain
    return Identification(fit, mean_errors_rad(judged, fit.values), (*fitted, *judged), gain)


class IdentificationRun(Run):
    """A run that makes the motions on the stand: connected and recorded like a walk."""

    def __init__(self, spec: RunSpec) -> None:
        """Check a spec, whose gait and motion are ignored; raises InputError for a world without a stand."""
        if spec.simulated:
            world = load_world("stand") if spec.world is None else spec.world
            world = world if isinstance(world, World) else load_world(world)
            if not world.on_stand:
                raise InputError(
                    f"{argument('world')}: got one without a stand; allowed: stand, or one with on_stand"
                )
            spec = replace(spec, world=world)
        plain = {"hold": "none", "self_rotation": "none", "duration_s": 120.0, "gait": "demo"}
        super().__init__(replace(spec, **plain), controller=self._make_motions)  # type: ignore[arg-type]
        self.plan = replace(self.plan, failures=(), travel=0.0)

    @property
    def _walk_text(self) -> str:
        return "identification"

    @property
    def on_stand(self) -> bool:
        """A simulated one in its world, a real one as its operator was asked."""
        return True

    def _make_motions(self, start: WalkStart) -> StandMotions:
        return StandMotions(start.robot, start.period_s)

    @property
    def motions_s(self) -> float:
        """Duration of the motions."""
        return StandMotions(self.robot, PERIOD_S).duration_s


def move_on_stand(*, stop_requested: StopRequested = never, **where: Any) -> RunResult:
    """Make the motions on a stand and record them; `where` are fields of `RecordedOptions`.

    Raises InputError before anything moves, RobotFaultError for a robot or a link that fails.
    """
    check_names(move_on_stand, where, RecordedOptions)
    with IdentificationRun(RunSpec(**where)) as connected:
        return connected.walk(stop_requested=stop_requested)
