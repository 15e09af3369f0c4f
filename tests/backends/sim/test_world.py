"""Worlds: what a file may say, and that each key does what it says."""

from pathlib import Path

import numpy as np
import pytest

from hexctl.backends.sim.physics import FIRST_JOINT, make_simulation
from hexctl.backends.sim.servos import SimServos
from hexctl.backends.sim.world import SensorNoise, World, load_world
from hexctl.errors import InputError
from hexctl.robot.messages import FloatArray, JointTargets
from tests.backends.conformance import move
from tests.robots import shipped


def test_a_world_may_set_one_key_only(tmp_path: Path) -> None:
    path = tmp_path / "world.yaml"
    path.write_text("friction: 0.6\n", encoding="utf-8")
    assert load_world(path) == load_world("flat").model_copy(update={"friction": 0.6})


def test_an_empty_world_is_the_flat_one(tmp_path: Path) -> None:
    path = tmp_path / "world.yaml"
    path.write_text("# nothing\n", encoding="utf-8")
    assert load_world(path) == load_world("flat") == World()


def test_all_keys_are_read(tmp_path: Path) -> None:
    path = tmp_path / "world.yaml"
    offsets = ", ".join(str(index) for index in range(18))
    path.write_text(
        "payload_kg: 1.5\npayload_position_m: [0.01, 0, 0.03]\nservo_strength: 0.5\n"
        f"joint_offset_deg: [{offsets}]\nsensor_noise: {{joint_deg: 0.1}}\n",
        encoding="utf-8",
    )
    world = load_world(path)
    assert world.payload_position_m == (0.01, 0, 0.03)
    assert world.joint_offset_deg == tuple(range(18))
    assert world.sensor_noise == SensorNoise(joint_deg=0.1)


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("fricton: 1", ["unknown key fricton", "friction"]),
        ("sensor_noise: {joint: 1}", ["unknown key sensor_noise.joint", "joint_deg, position_m, yaw_deg"]),
        ("sensor_noise: 1", ["sensor_noise", "got 1", "mapping"]),
        ("sensor_noise: {yaw_deg: -1}", ["sensor_noise.yaw_deg", "got -1", "0 or more"]),
        ("friction: 0", ["friction", "got 0", "above 0"]),
        ("friction: -1", ["friction", "got -1", "above 0"]),
        ("friction: .nan", ["friction", "nan", "finite"]),
        ("friction: .inf", ["friction", "inf", "finite"]),
        ("friction: grippy", ["friction", "'grippy'", "a number"]),
        ("friction: yes", ["friction", "True", "a number"]),
        ("slope_deg: 90", ["slope_deg", "90", "40 or less"]),
        ("roughness_m: -0.1", ["roughness_m", "-0.1", "0 or more"]),
        ("payload_kg: -1", ["payload_kg", "-1", "0 or more"]),
        ("payload_position_m: [0, 0]", ["payload_position_m", "[0, 0]", "longer list"]),
        ("payload_position_m: [0, 0, 5]", ["payload_position_m[2]", "5", "1 or less"]),
        ("servo_strength: 0", ["servo_strength", "got 0", "above 0"]),
        ("joint_offset_deg: 90", ["joint_offset_deg", "90", "0 to 45"]),
        ("joint_offset_deg: -1", ["joint_offset_deg", "-1", "0 to 45"]),
        ("joint_offset_deg: .nan", ["joint_offset_deg", "nan", "0 to 45"]),
        ("joint_offset_deg: lots", ["joint_offset_deg", "'lots'", "a list of 18"]),
        ("joint_offset_deg: yes", ["joint_offset_deg", "True", "0 to 45"]),
        ("joint_offset_deg: [1, 2]", ["joint_offset_deg", "[1, 2]", "a list of 18, each -45 to 45"]),
        (f"joint_offset_deg: {[0] * 17 + [99]}", ["joint_offset_deg", "99", "each -45 to 45"]),
        ("- 1", ["[1]", "mapping"]),
    ],
)
def test_a_bad_world_is_refused_in_one_line(text: str, parts: list[str], tmp_path: Path) -> None:
    path = tmp_path / "world.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as refused:
        load_world(path)
    message = str(refused.value)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    for part in parts:
        assert part in message.removeprefix(str(path))


def test_an_unknown_world_lists_the_known_ones() -> None:
    with pytest.raises(InputError, match="unknown world 'mars'; allowed: flat, rough, slippery, slope"):
        load_world("mars")


def _stood(world: World, *, seconds: float = 2.0, name: str = "ant") -> FloatArray:
    """Let a robot stand in a world and return its base position in m."""
    with SimServos(shipped(name), world=world) as servos:
        move(servos, servos.robot.stance_angles_rad, ticks=round(50 * seconds))
        position = servos.read().base_position_world
        assert position is not None
        return position


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


def test_a_payload_is_in_the_mass_and_on_the_feet() -> None:
    world = World(payload_kg=0.7, payload_position_m=(0.03, 0.0, 0.02))
    with SimServos(shipped(), world=world) as servos:
        assert servos.simulation.physics.model.body_mass.sum() == pytest.approx(1.7)
        move(servos, servos.robot.stance_angles_rad, ticks=100)
        forces = servos.simulation.physics.data.sensordata
        assert forces.sum() == pytest.approx(9.81 * 1.7, rel=0.01)
        assert forces[0] > forces[3], "it sits in front"


@pytest.mark.parametrize("name", ["ant", "phantomx", "pexod"])
def test_the_compiled_robot_weighs_what_its_file_says(name: str) -> None:
    model = make_simulation(shipped(name), World()).physics.model
    assert model.body_mass.sum() == pytest.approx(shipped(name).mass_kg)


@pytest.mark.parametrize("strength", [0.3, 2.0])
def test_servo_strength_scales_the_greatest_torque(strength: float) -> None:
    with SimServos(shipped(), world=World(servo_strength=strength)) as servos:
        servos.write(JointTargets(np.full(18, 3.0), 0.0))
        servos.simulation.physics.data.qpos[FIRST_JOINT:] = 3.0 - 2.0
        servos.simulation.physics.step()
        force = np.abs(servos.simulation.physics.data.actuator_force)
    np.testing.assert_allclose(force, strength * 2.5)


def test_servos_without_strength_let_the_robot_down() -> None:
    weak, whole = (_stood(World(servo_strength=share), name="phantomx") for share in (0.02, 1.0))
    assert weak[2] < whole[2] - 0.05


def test_soft_servos_give_way_more() -> None:
    stiff, plain, soft = (_stood(World(servo_stiffness=share))[2] for share in (4.0, 1.0, 0.5))
    assert stiff > plain > soft


def test_given_joint_offsets_are_between_what_a_joint_is_and_what_it_believes() -> None:
    offsets = [0.0] * 18
    offsets[4], offsets[9] = 3.0, -5.0
    with SimServos(shipped(), world=World(joint_offset_deg=tuple(offsets))) as servos:
        move(servos, servos.robot.stance_angles_rad, ticks=100)
        true = servos.simulation.physics.data.qpos[FIRST_JOINT:]
        believed = servos.read().joint_positions_rad
        np.testing.assert_allclose(np.degrees(true - believed), offsets, atol=1e-9)
        np.testing.assert_allclose(believed, servos.robot.stance_angles_rad, atol=0.05)


def test_drawn_joint_offsets_have_their_deviation_and_follow_the_seed() -> None:
    world = World(joint_offset_deg=2.0)
    drawn = np.array([make_simulation(shipped(), world, seed=seed).joint_offsets_rad for seed in range(12)])
    assert np.degrees(drawn.std()) == pytest.approx(2.0, rel=0.15)
    again = make_simulation(shipped(), world, seed=7).joint_offsets_rad
    np.testing.assert_array_equal(drawn[7], again)
    assert len({tuple(row) for row in drawn.tolist()}) == 12
