"""MJCF of robots: the kinematics and the masses of hexctl's own simulation, in MuJoCo itself."""

from typing import Any

import mujoco
import numpy as np
import pytest

from hexctl.backends.sim.servos import SimServos
from hexctl.ik.legs import foot_positions_body
from hexctl.palette import BACKGROUND
from hexctl.robot.formats.link_frames import FOOT_LINKS
from hexctl.robot.formats.mjcf import CAMERAS, mjcf_of
from hexctl.types import JOINT_NAMES, N_JOINTS
from tests.robots import ROBOT_NAMES, shipped


@pytest.fixture(params=ROBOT_NAMES)
def name(request: Any) -> str:
    return str(request.param)


def test_the_feet_are_where_our_kinematics_have_them(name: str) -> None:
    robot = shipped(name)
    model = mujoco.MjModel.from_xml_string(mjcf_of(robot))
    data = mujoco.MjData(model)
    assert [model.joint(index + 1).name for index in range(N_JOINTS)] == list(JOINT_NAMES)
    feet = [model.site(foot).id for foot in FOOT_LINKS]
    shares = np.random.default_rng(17).uniform(size=(100, N_JOINTS))
    for share in shares:
        pose_rad = robot.joint_lower_rad + share * (robot.joint_upper_rad - robot.joint_lower_rad)
        data.qpos[:7], data.qpos[7:] = [0, 0, 0, 1, 0, 0, 0], pose_rad
        mujoco.mj_kinematics(model, data)
        assert np.abs(data.site_xpos[feet] - foot_positions_body(robot, pose_rad)).max() < 1e-9


def test_masses_servos_and_friction_are_those_of_the_simulation(name: str) -> None:
    robot = shipped(name)
    model = mujoco.MjModel.from_xml_string(mjcf_of(robot))
    with SimServos(robot) as servos:
        ours = servos.compiled.physics.model
        order = ours.body_mass > 0  # without the frames by which legs are attached
        assert model.body_mass[1:] == pytest.approx(ours.body_mass[order], rel=1e-9)
        assert np.sort(model.body_inertia[1:]) == pytest.approx(np.sort(ours.body_inertia[order]), rel=1e-9)
        for field in ("dof_armature", "dof_damping", "dof_frictionloss", "dof_solimp"):
            assert getattr(model, field) == pytest.approx(getattr(ours, field)), field
        for field in ("actuator_gainprm", "actuator_biasprm", "actuator_forcerange"):
            assert getattr(model, field) == pytest.approx(getattr(ours, field)), field


def test_it_stands_in_its_stance_and_the_cameras_go_with_it(name: str) -> None:
    robot = shipped(name)
    model = mujoco.MjModel.from_xml_string(mjcf_of(robot))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("stance").id)
    mujoco.mj_step(model, data, 1000)
    assert data.qpos[2] == pytest.approx(robot.standing_height_m, abs=0.01)
    mujoco.mj_forward(model, data)
    assert data.ncon >= 3
    before_m = data.cam_xpos.copy()
    assert [model.camera(index).name for index in range(model.ncam)] == list(CAMERAS)
    data.qpos[0] += 1
    mujoco.mj_forward(model, data)
    assert data.cam_xpos - before_m == pytest.approx(np.tile([1.0, 0.0, 0.0], (3, 1)), abs=1e-6)


def test_the_floor_ends_in_the_background_without_a_bright_line() -> None:
    model = mujoco.MjModel.from_xml_string(mjcf_of(shipped()))
    assert 255 * model.vis.rgba.haze[:3] == pytest.approx(BACKGROUND, abs=1)
