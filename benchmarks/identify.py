"""Identification of simulated robots with drawn servos and trunks.

`python -m benchmarks.identify [DRAWS [FIRST]]` prints each error, and how many are small enough.

The truth is a world's; the sensors have noise. Nothing of it is used by the search.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

from hexctl.backends.sim.flaws import SensorNoise
from hexctl.backends.sim.world import World
from hexctl.identify.identification import identify, move_on_stand
from hexctl.identify.parameters import RobotValues
from hexctl.robot.loader import load_robot
from hexctl.robot.model import Robot
from hexctl.runs.run import run

#: Largest error of each parameter: a share of the truth, or a time.
ALLOWED = {
    "rotor_inertia_kg_m2": 0.15,
    "stiffness_nm_per_rad": 0.10,
    "dry_friction_nm": 0.15,
    "dead_time_s": 0.003,
}

#: Parameters whose errors are in the unit, not shares of the truth.
ABSOLUTE = ("dead_time_s", "trunk_com_x_m", "trunk_com_y_m")

#: Duration of the walk: the weight that it carries sets the scale of stiffness and inertia.
WALK_S = 10.0

ROBOTS = ("ant", "lukas", "pexod", "jethexa")


def drawn_world(robot: Robot, seed: int) -> World:
    """A stand with servos drawn as far apart as published ones are, and a trunk with a load."""
    draw, trunk = np.random.default_rng([42, seed]), np.random.default_rng([42, seed, 1])
    shift_m = 0.1 * np.array(robot.body.size_m) * (*trunk.uniform(-1, 1, 2), 0.0)
    torque_nm = float(robot.joint_max_torque_nm.mean())
    return World(
        on_stand=True,
        rotor_inertia_kg_m2=float(np.exp(draw.uniform(np.log(0.001), np.log(0.03)))),
        servo_stiffness=float(np.exp(draw.uniform(np.log(0.6), np.log(1.6)))),
        servo_damping=float(np.exp(draw.uniform(np.log(0.5), np.log(2.0)))),
        joint_friction_nm=float(torque_nm * draw.uniform(0.01, 0.08)),
        servo_delay_s=float(0.002 * draw.integers(2, 16)),
        added_mass_share=float(trunk.uniform(0.0, 0.3)),
        body_mass_shift_m=tuple(shift_m.tolist()),
        sensor_noise=SensorNoise(joint_deg=0.05),
    )


def truth(robot: Robot, world: World) -> dict[str, float]:
    """The drawn values."""
    values = RobotValues.of(robot)
    assert isinstance(world.joint_friction_nm, float)
    assert world.rotor_inertia_kg_m2 is not None
    return {
        "rotor_inertia_kg_m2": world.rotor_inertia_kg_m2,
        "stiffness_nm_per_rad": values.stiffness_nm_per_rad * world.servo_stiffness,
        "dry_friction_nm": world.joint_friction_nm,
        "dead_time_s": values.dead_time_s + world.servo_delay_s,
        "trunk_mass_kg": robot.body.mass_kg + world.added_mass_share * robot.mass_kg,
        "trunk_com_x_m": values.trunk_com_x_m + world.body_mass_shift_m[0],
        "trunk_com_y_m": values.trunk_com_y_m + world.body_mass_shift_m[1],
    }


def error(name: str, found: float, true: float) -> float:
    """Error of a parameter: a share of the truth, or one in s or m."""
    return abs(found - true) if name in ABSOLUTE else abs(found / true - 1)


def main(draws: int, first: int) -> None:
    """Identify drawn servos, and print each error and how many are allowed."""
    held = dict.fromkeys(ALLOWED, 0)
    for seed in range(first, first + draws):
        robot = load_robot(ROBOTS[seed % len(ROBOTS)])
        world = drawn_world(robot, seed)
        with tempfile.TemporaryDirectory() as folder:
            stand, walk = Path(folder) / "stand.rrd", Path(folder) / "walk.rrd"
            move_on_stand(robot=robot, world=world, record=stand, seed=seed)
            floor = world.model_copy(update={"on_stand": False})
            run(robot=robot, world=floor, record=walk, seed=seed, duration_s=WALK_S, hold="none")
            found = identify([stand, walk])
        true = truth(robot, world)
        errors = {name: error(name, found.estimates[name].value, true[name]) for name in true}
        for name, largest in ALLOWED.items():
            held[name] += errors[name] <= largest
        shown = ", ".join(f"{name} {value:.4f}" for name, value in errors.items())
        print(f"{seed:2d} {robot.name}: {shown}", flush=True)
    print({name: f"{count} of {draws}" for name, count in held.items()})


if __name__ == "__main__":
    given = [int(one) for one in sys.argv[1:]]
    main(*given, *(20, 0)[len(given) :])
