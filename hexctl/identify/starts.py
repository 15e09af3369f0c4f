"""Values from which the search for a robot's servos starts."""

from dataclasses import replace

import numpy as np

from hexctl.identify.parameters import PARAMETERS, RobotValues
from hexctl.robot.model import Robot

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


def starts_of(robot: Robot) -> list[RobotValues]:
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
