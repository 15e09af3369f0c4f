"""Identification of simulated robots whose servos are drawn: `python -m benchmarks.identify [DRAWS]`.

The truth is a world's; the sensors have noise. Nothing of it is used by the search.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

from hexctl.backends.sim.flaws import SensorNoise
from hexctl.backends.sim.world import World
from hexctl.identify.identification import identify, move_on_stand
from hexctl.identify.servo_parameters import ServoValues
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

#: Duration of the walk: the weight that it carries sets the scale of stiffness and inertia.
WALK_S = 10.0

ROBOTS = ("ant", "lukas", "pexod", "jethexa")


def drawn_world(robot: Robot, seed: int) -> World:
    """A stand with servos drawn as far apart as published ones are."""
    draw = np.random.default_rng([42, seed])
    torque_nm = float(robot.joint_max_torque_nm.mean())
    return World(
        on_stand=True,
        rotor_inertia_kg_m2=float(np.exp(draw.uniform(np.log(0.001), np.log(0.03)))),
        servo_stiffness=float(np.exp(draw.uniform(np.log(0.6), np.log(1.6)))),
        servo_damping=float(np.exp(draw.uniform(np.log(0.5), np.log(2.0)))),
        joint_friction_nm=float(torque_nm * draw.uniform(0.01, 0.08)),
        servo_delay_s=float(0.002 * draw.integers(2, 16)),
        sensor_noise=SensorNoise(joint_deg=0.05),
    )


def truth(robot: Robot, world: World) -> dict[str, float]:
    """The drawn values."""
    values = ServoValues.of(robot)
    assert isinstance(world.joint_friction_nm, float)
    assert world.rotor_inertia_kg_m2 is not None
    return {
        "rotor_inertia_kg_m2": world.rotor_inertia_kg_m2,
        "stiffness_nm_per_rad": values.stiffness_nm_per_rad * world.servo_stiffness,
        "dry_friction_nm": world.joint_friction_nm,
        "dead_time_s": values.dead_time_s + world.servo_delay_s,
    }


def error(name: str, found: float, true: float) -> float:
    """Error of a parameter: a share of the truth, or a time in s."""
    return abs(found - true) if name == "dead_time_s" else abs(found / true - 1)


def main(draws: int) -> None:
    """Identify drawn servos, and print each error and how many are allowed."""
    held = dict.fromkeys(ALLOWED, 0)
    for seed in range(draws):
        robot = load_robot(ROBOTS[seed % len(ROBOTS)])
        world = drawn_world(robot, seed)
        with tempfile.TemporaryDirectory() as folder:
            stand, walk = Path(folder) / "stand.rrd", Path(folder) / "walk.rrd"
            move_on_stand(robot=robot, world=world, record=stand, seed=seed)
            floor = world.model_copy(update={"on_stand": False})
            run(robot=robot, world=floor, record=walk, seed=seed, duration_s=WALK_S, hold="none")
            found = identify([stand, walk])
        true = truth(robot, world)
        errors = {name: error(name, found.estimates[name].value, true[name]) for name in ALLOWED}
        for name, largest in ALLOWED.items():
            held[name] += errors[name] <= largest
        shown = ", ".join(f"{name} {value:.4f}" for name, value in errors.items())
        print(f"{seed:2d} {robot.name}: {shown}", flush=True)
    print({name: f"{count} of {draws}" for name, count in held.items()})


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 20)
