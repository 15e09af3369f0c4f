"""Search for the servos and the trunk of a robot, from several starts."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from operator import itemgetter

import numpy as np

from hexctl.identify.fit import Fit, OnStage, fit_values, mean_errors_rad, near_values
from hexctl.identify.parameters import PARAMETERS, RobotValues
from hexctl.identify.robot_log import OF_JOINTS, RobotLog
from hexctl.robot.model import Robot

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


def fit_robot(replays: Sequence[RobotLog], on_step: OnStage) -> Fit[RobotValues]:
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
