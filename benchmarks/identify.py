"""Identification of simulated robots with drawn servos and trunks.

`python -m benchmarks.identify [DRAWS [FIRST]]` prints each error, and how many are small enough.
`python -m benchmarks.identify real:9960 6 ant FOLDER` does so in worlds of a family: with joints that differ,
offsets, play and latency. It also prints how well the identified robot and the robot file predict motions
that were not fitted. The folder keeps logs and robot files.

The truth is a world's; the sensors have noise. Nothing of it is used by the search.
"""

import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from hexctl.backends.sim.flaws import SensorNoise
from hexctl.backends.sim.simulation_model import delay_steps
from hexctl.backends.sim.world import World, load_world, per_joint
from hexctl.identify.identification import identify
from hexctl.identify.identified_file import write_identified
from hexctl.identify.parameters import RobotValues
from hexctl.identify.robot_log import read_robot_log
from hexctl.identify.stand_run import move_on_stand
from hexctl.robot.loader import load_robot
from hexctl.robot.model import Robot
from hexctl.runs.run import run
from hexctl.types import N_LEGS, FloatArray

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

#: Walks that are not fitted.
HELD_OUT = ("tripod", "ripple")

ROBOTS = ("ant", "lukas", "pexod", "jethexa")


def drawn_world(robot: Robot, seed: int) -> World:
    """Servos drawn as far apart as published ones are, and a trunk with a load."""
    draw, trunk = np.random.default_rng([42, seed]), np.random.default_rng([42, seed, 1])
    shift_m = 0.1 * np.array(robot.body.size_m) * (*trunk.uniform(-1, 1, 2), 0.0)
    torque_nm = float(robot.joint_max_torque_nm.mean())
    return World(
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


def truth_of_joints(robot: Robot, world: World) -> dict[str, float]:
    """Values of a world of a family: means of joints; the dead time includes the age of the angles."""
    values = RobotValues.of(robot)
    coxa, femur, tibia = (
        (world.servo_stiffness * robot.stiffness_nm_per_rad * per_joint(world.joint_stiffness))
        .reshape(N_LEGS, -1)
        .mean(axis=0)
    )
    friction = robot.dry_friction_nm if world.joint_friction_nm is None else world.joint_friction_nm
    return {
        "stiffness_nm_per_rad": float(np.mean([coxa, femur, tibia])),
        "coxa_stiffness_ratio": coxa / tibia,
        "femur_stiffness_ratio": femur / tibia,
        "damping_nm_s_per_rad": values.damping_nm_s_per_rad * world.servo_damping,
        "rotor_inertia_kg_m2": world.rotor_inertia_kg_m2 or values.rotor_inertia_kg_m2,
        "dry_friction_nm": float(np.mean(friction)),
        "max_torque_nm": values.max_torque_nm * world.servo_strength,
        "dead_time_s": world.time_step_s * (delay_steps(robot, world) + world.latency_steps),
        "play_deg": float(np.mean(world.servo_backlash_deg)) or values.play_deg,
        "trunk_mass_kg": robot.body.mass_kg + world.added_mass_share * robot.mass_kg,
        "trunk_com_x_m": values.trunk_com_x_m + world.body_mass_shift_m[0],
        "trunk_com_y_m": values.trunk_com_y_m + world.body_mass_shift_m[1],
    }


def stand_and_walk(robot: Robot, world: World, seed: int, folder: Path) -> list[Path]:
    """Recordings of the motions on a stand and of a walk, made unless they are there."""
    stand, walk = (folder / f"{robot.name}-{seed}-{kind}.rrd" for kind in ("stand", "walk"))
    if not stand.exists():
        on_stand = world.model_copy(update={"on_stand": True})
        move_on_stand(robot=robot, world=on_stand, record=stand, seed=seed)
    if not walk.exists():
        run(robot=robot, world=world, record=walk, seed=seed, duration_s=WALK_S, hold="none")
    return [stand, walk]


def predicted_deg(robot: Robot, log: Path) -> float:
    """Mean absolute error of the joint angles of a robot that is simulated with the commands of a log."""
    errors_rad = read_robot_log(log, robot).errors_rad(RobotValues.of(robot))
    return float(np.degrees(np.abs(errors_rad).mean()))


def walked_m(robot: Robot, world: World, seed: int, gait: str, record: str | bool = False) -> FloatArray:
    """Displacement of a walk without course feedback, (2,)."""
    done = run(robot=robot, world=world, seed=seed, gait=gait, duration_s=WALK_S, hold="none", record=record)
    return np.asarray(done.trial.path_m[-1])


def print_predictions(robots: dict[str, Robot], world: World, seed: int) -> None:
    """Print errors of the predicted joint angles and ends of held-out walks."""
    for gait in HELD_OUT:
        with tempfile.TemporaryDirectory() as folder:
            log = Path(folder) / "walk.rrd"
            end_m = walked_m(robots["file"], world, seed, gait, record=str(log))
            for title, robot in robots.items():
                off_m = float(np.linalg.norm(walked_m(robot, World(), seed, gait) - end_m))
                print(f"{seed} {gait}, {title}: {predicted_deg(robot, log):.2f} deg, {off_m:.3f} m")


def identify_in(family: str, worlds: int, name: str, folder: Path) -> None:
    """Identify a robot in worlds, and print its errors and those of its predictions."""
    folder.mkdir(parents=True, exist_ok=True)
    kind, _, first = family.partition(":")
    misses: dict[bool, list[float]] = {True: [], False: []}
    for seed in range(int(first), int(first) + worlds):
        robot, world = load_robot(name), load_world(f"{kind}:{seed}")
        logs, begun_s = stand_and_walk(robot, world, seed, folder), time.process_time()
        found, file = identify(logs), folder / f"{name}-{seed}.yaml"
        print(f"{seed} {name}: CPU of the search {time.process_time() - begun_s:.0f} s")
        write_identified(name, found, file)
        for key, true in truth_of_joints(robot, world).items():
            one = found.estimates[key]
            misses[one.known].append(abs(one.value - true) / one.deviation)
            note = "" if one.known else "not determined"
            print(f"  {key:22s} {one.value:9.4f} +- {one.deviation:7.4f}, true {true:9.4f} {note}")
        print_predictions({"file": robot, "identified": load_robot(file)}, world, seed)
    for known, of_them in misses.items():
        within = [int(np.sum(np.array(of_them) <= most)) for most in (1, 2, 3)]
        what = "determined" if known else "other"
        print(f"{what}: true value within 1, 2, 3 standard errors: {within} of {len(of_them)}")


def main(draws: int, first: int) -> None:
    """Identify drawn servos, and print each error and how many are allowed."""
    held = dict.fromkeys(ALLOWED, 0)
    for seed in range(first, first + draws):
        robot = load_robot(ROBOTS[seed % len(ROBOTS)])
        world = drawn_world(robot, seed)
        with tempfile.TemporaryDirectory() as folder:
            found = identify(stand_and_walk(robot, world, seed, Path(folder)))
        true = truth(robot, world)
        errors = {name: error(name, found.estimates[name].value, true[name]) for name in true}
        for name, largest in ALLOWED.items():
            held[name] += errors[name] <= largest
        shown = ", ".join(f"{name} {value:.4f}" for name, value in errors.items())
        print(f"{seed:2d} {robot.name}: {shown}", flush=True)
    print({name: f"{count} of {draws}" for name, count in held.items()})


if __name__ == "__main__":
    if ":" in "".join(sys.argv[1:2]):
        identify_in(sys.argv[1], int(sys.argv[2]), sys.argv[3], Path(sys.argv[4]))
    else:
        given = [int(one) for one in sys.argv[1:]]
        main(*given, *(20, 0)[len(given) :])
