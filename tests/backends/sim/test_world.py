"""Worlds: what a file may say, and that each key does what it says."""

import math
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexctl.backends.sim.flaws import SensorFaults, SensorNoise
from hexctl.backends.sim.servos import SimServos
from hexctl.backends.sim.simulation_model import FIRST_JOINT, TOUCH, make_simulation
from hexctl.backends.sim.terrain import make_floor
from hexctl.backends.sim.world import World, load_world, with_step, without_step
from hexctl.errors import InputError
from hexctl.robot.rotations import yaw_rad
from hexctl.testing.servo_conformance import move
from hexctl.types import FloatArray, JointTargets, RobotState
from tests.robots import shipped


def _written(text: str, folder: Path) -> Path:
    path = folder / "world.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_keys_of_a_world_file_are_read_and_others_are_those_of_the_flat_world(tmp_path: Path) -> None:
    assert load_world(_written("# nothing\n", tmp_path)) == load_world("flat") == World()
    assert load_world(_written("friction: 0.6\n", tmp_path)) == World(friction=0.6)
    offsets = ", ".join(str(index) for index in range(18))
    text = (
        "payload_position_m: [0.01, 0, 0.03]\nfriction_cone: pyramidal\ntime_step_s: 0.004\n"
        f"joint_offset_deg: [{offsets}]\nsensor_noise: {{joint_deg: 0.1}}\n"
    )
    world = load_world(_written(text, tmp_path))
    assert world.payload_position_m == (0.01, 0, 0.03)
    assert world.joint_offset_deg == tuple(range(18))
    assert world.sensor_noise == SensorNoise(joint_deg=0.1)
    assert (world.steps_per_tick, world.friction_cone) == (5, "pyramidal")


#: Values that a world file cannot have, by key.
WRONG = {
    "fricton": "1",
    "sensor_noise": "1",
    "sensor_noise.yaw_deg": "-1 500",
    "friction": "0 -1 .nan .inf grippy yes",
    "payload_position_m": "[0,0] [0,0,5]",
    "friction_cone": "round",
    "time_step_s": "0.003 0 0.01",
    "servo_backlash_deg": "-1 yes",
    "joint_offset_deg": f"90 -1 .nan lots yes [1,2] {[0] * 17 + [99]}".replace(", ", ","),
    "sensor_faults.pose_frozen_s": "[[3,2]] [[-1,2]]",
    "sensor_faults.position_jump_m": "[0,.nan,0] [.inf,0,0] [0,0.5,0]",
}


@pytest.mark.parametrize("key", WRONG)
def test_a_bad_value_is_refused_with_file_and_key(key: str, tmp_path: Path) -> None:
    section, _, name = key.rpartition(".")
    for value in WRONG[key].split():
        line = f"{section}: {{{name}: {value}}}" if section else f"{name}: {value}"
        path = _written(line, tmp_path)
        with pytest.raises(InputError, match=name) as refused:
            load_world(path)
        assert str(refused.value).startswith(f"{path}: ")
        assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("- 1", "mapping"),
        ("sensor_faults: {position_jump_s: [[1, 2]], position_jump_m: [0, 1000, 0]}", "position_jump_m"),
        ("sensor_faults: {position_jump_m: [0, 0, 0], position_jump_s: [[1, 2]]}", "position_jump_s"),
        ('failures: ["5"]', "failures"),
        ('failures: ["7:limp@3"]', "failures"),
        ('healings: ["5:limp@3"]', "healings"),
    ],
)
def test_a_world_whose_values_contradict_is_refused(text: str, named: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=named):
        load_world(_written(text, tmp_path))


def test_a_name_may_have_a_time_step() -> None:
    for name in ("slope", "real:7", "transfer:500"):
        assert load_world(f"{name}@0.5ms") == load_world(name).model_copy(update={"time_step_s": 0.0005})
    assert with_step("real:7", 0.0005) == with_step("real:7@0.5ms", 0.002) == "real:7@0.5ms"
    assert without_step("real:7@0.5ms") == without_step("real:7") == "real:7"
    for name, words in (("flat@3ms", "time_step_s: got 0.003"), ("flt@1ms", "did you mean 'flat'")):
        with pytest.raises(InputError, match=words):
            load_world(name)


def test_an_unknown_world_lists_the_known_ones() -> None:
    with pytest.raises(InputError, match=r"'mars'; allowed: flat, .*slope, stand, .*failing:N, .*transfer:N"):
        load_world("mars")


@cache
def _stood(world: World, *, seconds: float = 1.0) -> FloatArray:
    """Let a robot stand in a world and return its base position in m."""
    with SimServos(shipped(), world=world) as servos:
        move(servos, servos.robot.stance_angles_rad, ticks=round(50 * seconds))
        position = servos.read().base_position_world
        assert position is not None
        return position


def _model(world: World) -> Any:
    """The compiled model of a robot in a world."""
    return make_simulation(shipped(), world).physics.model


@pytest.mark.slow
@pytest.mark.parametrize("uphill_deg", [0.0, 120.0])
def test_feet_slide_down_a_slope_that_is_steeper_than_their_friction(uphill_deg: float) -> None:
    # tan 20 deg = 0.364
    held, slid = (
        World(friction=friction, slope_deg=20, slope_direction_deg=uphill_deg) for friction in (0.8, 0.2)
    )
    assert np.linalg.norm(_stood(held) - _stood(held, seconds=0.4)) < 0.02
    way = _stood(slid) - _stood(slid, seconds=0.4)
    downhill = -np.array([np.cos(np.radians(uphill_deg)), np.sin(np.radians(uphill_deg))])
    assert way[:2] @ downhill > 0.5
    assert way[2] < -0.2


@pytest.mark.parametrize(
    ("world", "mass_kg"),
    [
        (World(payload_kg=0.7, payload_position_m=(0.03, 0.0, 0.02)), 1.7),
        (World(added_mass_share=0.4, body_mass_shift_m=(0.05, 0.0, 0.0)), 1.4),
    ],
)
def test_a_load_is_in_the_mass_and_on_the_feet(world: World, mass_kg: float) -> None:
    with SimServos(shipped(), world=world) as servos:
        assert servos.compiled.physics.model.body_mass.sum() == pytest.approx(mass_kg)
        move(servos, servos.robot.stance_angles_rad, ticks=60)
        forces = servos.compiled.physics.data.sensordata[TOUCH]
        assert forces.sum() == pytest.approx(9.81 * mass_kg, rel=0.01)
        assert forces[0] > forces[3], "it sits in front"


@pytest.mark.slow
def test_a_trunk_with_its_mass_elsewhere_has_its_shape_where_it_was() -> None:
    plain, loaded = (_model(world) for world in (World(), World(body_mass_shift_m=(0.1, 0.0, -0.1))))
    shapes = [
        {
            model.id2name(geom, "geom"): (*model.geom_pos[geom], *model.geom_size[geom])
            for geom in np.flatnonzero(model.geom_conaffinity)
        }
        for model in (plain, loaded)
    ]
    assert shapes[0] == shapes[1]


@pytest.mark.parametrize("share", [-0.1001, -0.5])
def test_more_mass_than_the_trunk_has_cannot_be_taken_away(share: float) -> None:
    with pytest.raises(InputError, match="added_mass_share: "):
        SimServos(shipped(), world=World(added_mass_share=share)).connect()


def test_the_floor_gives_way_as_slowly_as_the_world_says() -> None:
    import mujoco

    model = _model(World(contact_time_s=0.035, roughness_m=0.004, friction_cone="pyramidal"))
    assert model.opt.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL
    for name in ("floor", "bumps"):
        assert model.geom_solref[model.name2id(name, "geom")].tolist() == [0.035, 1.0]


@pytest.mark.parametrize("time_step_s", [0.0005, 0.005])
def test_a_tick_is_twenty_milliseconds_whatever_the_step_of_the_physics(time_step_s: float) -> None:
    with SimServos(shipped(), world=World(time_step_s=time_step_s)) as servos:
        for index in range(1, 4):
            servos.clock.tick()
            assert servos.compiled.physics.data.time == pytest.approx(0.02 * index)
        assert servos.compiled.physics.model.opt.timestep == time_step_s


@pytest.mark.slow
@pytest.mark.parametrize("strength", [0.3, 2.0])
def test_servo_strength_scales_the_greatest_torque(strength: float) -> None:
    with SimServos(shipped(), world=World(servo_strength=strength)) as servos:
        servos.write(JointTargets(np.full(18, 3.0), 0.0))
        servos.compiled.physics.data.qpos[FIRST_JOINT:] = 3.0 - 2.0
        servos.compiled.physics.step()
        force = np.abs(servos.compiled.physics.data.actuator_force)
    np.testing.assert_allclose(force, strength * 2.5)


def test_given_joint_offsets_are_between_what_a_joint_is_and_what_it_believes() -> None:
    offsets = [0.0] * 18
    offsets[4], offsets[9] = 3.0, -5.0
    with SimServos(shipped(), world=World(joint_offset_deg=tuple(offsets))) as servos:
        move(servos, servos.robot.stance_angles_rad, ticks=100)
        true = servos.compiled.physics.data.qpos[FIRST_JOINT:]
        believed = servos.read().joint_positions_rad
        np.testing.assert_allclose(np.degrees(true - believed), offsets, atol=1e-9)
        np.testing.assert_allclose(believed, servos.robot.stance_angles_rad, atol=0.05)


@pytest.mark.slow
def test_drawn_joint_offsets_have_their_deviation_and_follow_the_seed() -> None:
    world = World(joint_offset_deg=2.0)
    drawn = np.array([make_simulation(shipped(), world, seed=seed).joint_offsets_rad for seed in range(8)])
    assert np.degrees(drawn.std()) == pytest.approx(2.0, rel=0.15)
    again = make_simulation(shipped(), world, seed=7).joint_offsets_rad
    np.testing.assert_array_equal(drawn[7], again)
    assert len({tuple(row) for row in drawn.tolist()}) == 8


def _axes(world: World, facing_rad: float) -> FloatArray:
    """The body's axes in the world, as columns, where a robot is put down."""
    with SimServos(shipped(), world=world, facing_rad=facing_rad) as servos:
        quaternion = servos.read().base_quaternion_world
    import mujoco

    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)


@pytest.mark.parametrize("facing_rad", [1.0, -2.5, 4.0])
def test_a_robot_is_put_down_facing_where_it_is_told(facing_rad: float) -> None:
    with SimServos(shipped(), facing_rad=facing_rad) as servos:
        state = servos.read()
    assert state.base_quaternion_world is not None
    assert state.base_position_world is not None
    off_rad = float(yaw_rad(state.base_quaternion_world)) - facing_rad
    assert math.remainder(off_rad, math.tau) == pytest.approx(0, abs=1e-12)
    np.testing.assert_allclose(state.base_position_world[:2], 0, atol=1e-12)


@pytest.mark.parametrize(("facing_rad", "uphill_deg"), [(1.0, 75.0), (-2.5, 0.0)])
def test_on_a_slope_a_robot_turns_about_the_floors_normal(facing_rad: float, uphill_deg: float) -> None:
    world = World(slope_deg=20, slope_direction_deg=uphill_deg)
    straight, turned = _axes(world, 0.0), _axes(world, facing_rad)
    normal = make_simulation(shipped(), world).floor.normal_world
    np.testing.assert_allclose(turned[:, 2], normal, atol=1e-12)
    forward = math.cos(facing_rad) * straight[:, 0] + math.sin(facing_rad) * straight[:, 1]
    np.testing.assert_allclose(turned[:, 0], forward, atol=1e-12)


#: A value of every quantity that is not the flat world's.
CHANGED: dict[str, Any] = {
    "friction": 0.5,
    "friction_ratio": 0.8,
    "slope_deg": 5.0,
    "slope_direction_deg": 90.0,
    "roughness_m": 0.01,
    "roughness_length_m": 0.2,
    "step_height_m": 0.03,
    "pit_depth_m": 0.02,
    "block_m": 0.1,
    "ramp_deg": 10.0,
    "ramp_length_m": 1.0,
    "on_stand": True,
    "payload_kg": 0.5,
    "payload_position_m": (0.05, 0.0, 0.0),
    "added_mass_share": 0.2,
    "body_mass_shift_m": (0.02, 0.0, 0.0),
    "contact_time_s": 0.03,
    "friction_cone": "pyramidal",
    "time_step_s": 0.004,
    "solver_tolerance": 1e-8,
    "servo_delay_s": 0.04,
    "servo_backlash_deg": 1.0,
    "servo_strength": 0.5,
    "servo_stiffness": 0.5,
    "servo_damping": 2.0,
    "rotor_inertia_kg_m2": 0.01,
    "joint_stiffness": 0.5,
    "joint_friction_nm": 0.1,
    "tibia_error": 0.05,
    "joint_offset_deg": 2.0,
    "sensor_noise": SensorNoise(joint_deg=0.5),
    "state_latency_s": 0.01,
    "lost_commands": 0.5,
    "lost_poses": 0.5,
    "sensor_faults": SensorFaults(yaw_drift_deg_per_min=600.0),
    "failures": ("2:limp@0.02",),
    "healings": ("2@0.1",),
}


def measured(world: World, seed: int) -> tuple[RobotState, ...]:
    """States of a robot whose joints move a little in every tick."""
    robot = shipped()
    with SimServos(robot, world=world, seed=seed) as servos:
        states = []
        for tick in range(1, 9):
            time_s = servos.clock.tick().time_s
            states.append(servos.read())
            moved_rad = robot.stance_angles_rad + 0.2 * math.sin(0.3 * tick)
            servos.write(JointTargets(moved_rad, time_s))
    return tuple(states)


def poses(faults: dict[str, Any]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Times, positions and yaws that a robot at rest shows over 1 s."""
    return _poses(World.model_validate({"sensor_faults": faults}))


@cache
def _poses(world: World) -> tuple[FloatArray, FloatArray, FloatArray]:
    with SimServos(shipped(), world=world) as servos:
        rows = []
        for _ in range(50):
            servos.clock.tick()
            state = servos.read()
            assert state.base_position_world is not None
            assert state.base_quaternion_world is not None
            rows.append((state.stamp_s, *state.base_position_world, yaw_rad(state.base_quaternion_world)))
    table = np.array(rows, dtype=float)
    return table[:, 0], table[:, 1:4], table[:, 4]


def test_a_yaw_drifts_and_a_position_jumps_and_comes_back() -> None:
    times_s, positions, yaws = poses({})
    drift = {"yaw_drift_deg_per_min": 600.0, "position_jump_s": [[0.3, 0.5]], "position_jump_m": [0, 1, 2]}
    _, off, drifted = poses(drift)
    np.testing.assert_allclose(np.degrees(drifted - yaws), 10 * times_s, atol=1e-9)
    jumped = (times_s >= 0.3) & (times_s < 0.5)
    np.testing.assert_allclose(off - positions, np.outer(jumped, [0, 1, 2]), atol=1e-12)


@pytest.mark.parametrize(
    ("intervals", "began_s"),
    [
        ([[0.2, 0.4], [0.6, 0.7]], [(0.2, 0.4, 0.2), (0.6, 0.7, 0.6)]),
        ([[0.2, 0.4], [0.4, 0.6]], [(0.2, 0.4, 0.2), (0.4, 0.6, 0.4)]),
        ([[0.2, 0.5], [0.4, 0.6]], [(0.2, 0.4, 0.2), (0.4, 0.6, 0.4)]),
        ([[0.2, 0.6], [0.3, 0.5]], [(0.2, 0.3, 0.2), (0.3, 0.5, 0.3), (0.5, 0.6, 0.2)]),
    ],
    ids=["apart", "adjoining", "overlapping", "one within another"],
)
def test_a_pose_stays_what_it_was_when_its_interval_began(
    intervals: list[list[float]], began_s: list[tuple[float, float, float]]
) -> None:
    times_s, positions, _ = poses({})
    _, seen, _ = poses({"pose_frozen_s": intervals})
    free = np.ones(len(times_s), dtype=bool)
    for begin_s, end_s, frozen_at_s in began_s:
        frozen = (times_s >= begin_s) & (times_s < end_s)
        free &= ~frozen
        assert not (positions[frozen] == positions[frozen][0]).all()
        shown = positions[times_s >= frozen_at_s][0]
        np.testing.assert_array_equal(seen[frozen], np.broadcast_to(shown, seen[frozen].shape))
    np.testing.assert_array_equal(seen[free], positions[free])


def test_a_world_with_sensor_faults_is_read_as_it_was_written() -> None:
    faulty = World(sensor_faults=SensorFaults(pose_frozen_s=((1.0, 2.0),)))
    assert World.model_validate(faulty.model_dump(mode="json")) == faulty != World()


@pytest.mark.long
def test_trials_of_a_world_are_alike_without_noise_and_losses() -> None:
    rough = World(roughness_m=0.02, joint_offset_deg=1.0)
    assert rough.repeats
    for change in ({"sensor_noise": SensorNoise(yaw_deg=0.1)}, {"lost_commands": 0.01}, {"lost_poses": 0.01}):
        assert not rough.model_copy(update=change).repeats


@pytest.mark.slow
def test_a_world_knows_whether_its_simulation_depends_on_the_seed() -> None:
    """The prior listed such quantities by hand; one that was forgotten had the same draw in each world."""
    assert CHANGED.keys() == World.model_fields.keys(), "each quantity needs an example"
    for name, value in CHANGED.items():
        world = World.model_validate({name: value})
        one, other = (measured(world, seed) for seed in (1, 2))
        alike = all(first == second for first, second in zip(one, other, strict=True))
        alike = alike and make_floor(world, 1) == make_floor(world, 2)  # the robot starts on an even place
        assert world.seeded is not alike, name
    assert not World(joint_offset_deg=(2.0,) * 18).seeded


@pytest.mark.parametrize("share", [-0.05, 0.5])
def test_added_mass_is_a_share_of_the_whole_robot_in_its_trunk(share: float) -> None:
    robot = shipped()
    plain, loaded = (_model(world) for world in (World(), World(added_mass_share=share)))
    assert plain.body_mass.sum() == pytest.approx(robot.mass_kg)
    assert loaded.body_mass.sum() == pytest.approx((1 + share) * robot.mass_kg)
    others = np.flatnonzero(loaded.body_mass != plain.body_mass)
    assert [loaded.id2name(body, "body") for body in others] == [f"{robot.name}/trunk"]
