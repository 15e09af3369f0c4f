"""`hexctl identify` as a library call: a robot's servos and trunk from its motions, or a servo on a bench."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hexctl.errors import InputError, argument
from hexctl.identify.fit import Fit, OnStage, Replay, mean_errors_rad
from hexctl.identify.parameters import OF_TRUNK, SCALE, Estimate, RobotValues
from hexctl.types import ArrayFields

if TYPE_CHECKING:
    from hexctl.identify.bench_run import BenchRun
    from hexctl.robot.model import Robot

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
    robot: "Robot | None" = None,
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
        from hexctl.identify.bench_run import read_bench_run

        return _of_bench([read_bench_run(path) for path in paths], p_gain, on_step)
    if kinds != {".rrd"}:
        raise InputError(
            f"LOG: got {', '.join(sorted(kinds)) or 'none'}; allowed: recordings (.rrd) of a robot, or runs "
            "(.json) of a servo on a bench"
        )
    if p_gain is not None:
        raise InputError(f"{argument('p_gain')}: got one with recordings; allowed: with runs on a bench")
    from hexctl.identify.robot_fit import fit_robot
    from hexctl.identify.robot_log import read_robot_log

    replays = tuple(read_robot_log(path, robot) for path in paths)
    return Identification(fit_robot(replays, on_step), {}, replays)


def _of_bench(runs: Sequence["BenchRun"], p_gain: int | None, on_step: OnStage) -> Identification:
    from hexctl.identify.bench_run import fit_bench

    fitted, judged = (runs[::2], runs[1::2]) if len(runs) >= ENOUGH_TO_JUDGE else (runs, [])
    fit = fit_bench(fitted, on_step)
    gain = max(1, round(max(run.p_gain for run in runs))) if p_gain is None else p_gain
    return Identification(fit, mean_errors_rad(judged, fit.values), (*fitted, *judged), gain)
