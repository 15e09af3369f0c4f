"""The exported MJCF in plain MuJoCo moves as hexctl's simulation does under the same targets."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

import hexctl
from hexctl.robot.formats.mjcf import mjcf_of
from hexctl.robot.model import Robot
from hexctl.robot.sensors import SENSORS
from hexctl.types import FloatArray
from tests.robots import shipped


def plain_mujoco(robot: Robot, commanded_rad: FloatArray) -> FloatArray:
    """Joint angles before each tick, (T, 18), under targets of 50 Hz, with MuJoCo's own loop only."""
    model = mujoco.MjModel.from_xml_string(mjcf_of(robot))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    pose = data.qpos.copy()
    ticks = round(0.02 / model.opt.timestep)
    for _ in range(2 * ticks):  # delayed actuators remember commands: those of the stance, not zeros
        mujoco.mj_step(model, data)
    data.qpos[:], data.qvel[:] = pose, 0.0
    angles_rad = []
    for targets_rad in commanded_rad:
        angles_rad.append(data.qpos[7:].copy())
        data.ctrl[:] = targets_rad
        for _ in range(ticks):
            mujoco.mj_step(model, data)
    return np.array(angles_rad)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["ant", "pexod", "phantomx", "phantomx-ax", "makeyourpet", "freenove-big", "jethexa", "lukas"]
)
def test_joint_angles_of_ten_seconds_are_within_a_tenth_of_a_degree(name: str) -> None:
    """Play of gears, and friction that grows with load, are left out: MJCF has no place for them."""
    own = shipped(name)
    servo = replace(own.servo, load_friction=0.0)
    robot = replace(own, servo=servo, joint_play_rad=None, sensors=SENSORS)
    log = hexctl.run(robot=robot, gait="tripod", duration_s=7, record=False).log
    assert len(log) > 500
    off_rad = plain_mujoco(robot, log["commanded_rad"]) - log["measured_rad"]
    assert np.degrees(np.sqrt((off_rad**2).mean())) < 0.1
    moved = np.ptp(log["measured_rad"], axis=0)
    assert moved.max() > 0.2, "it walked"
