"""Distil hexctl's tripod into a small network, and write it as a trained policy: walk.onnx and walk.yaml.

The network is a right policy without days of training: it observes a gait phase and a commanded velocity, and
gives joint targets as default pose + 0.25 * action. Needs `pip install onnx`.

    python policy_of_gait.py
    hexctl policy check walk.onnx
    hexctl run --policy walk.onnx
"""

import sys
from typing import NamedTuple

import numpy as np
import onnx
import yaml
from onnx import TensorProto, helper, numpy_helper

import hexctl
from hexctl.control.controllers import joints_of_feet
from hexctl.gait.foot_trajectory import RAMP_DURATION_S, gait_feet_body
from hexctl.gait.gait import Motion, ideal_speed_m_s
from hexctl.types import JOINT_NAMES

#: Hidden units, samples of the gait, rad per action, and the range of turns in rad/s.
HIDDEN, SAMPLES, SCALE, TURN = 160, 3000, 0.25, 0.2


class Distilled(NamedTuple):
    """Weights and biases of two layers, from sine and cosine of the phase and the command to joint angles."""

    weights: np.ndarray
    biases: np.ndarray
    out: np.ndarray
    out_biases: np.ndarray
    period_s: float
    full_m_s: float


def distil(robot):
    """Fit the output layer by least squares; the hidden one is drawn."""
    gait, random = hexctl.make_gait(robot, "tripod"), np.random.default_rng(5)
    full_m_s, period_s = ideal_speed_m_s(robot, gait, Motion()), 1 / gait.pace_hz
    inputs, targets = [], []
    for share, phase, turn in random.uniform((0, 0, -TURN), (1, 1, TURN), (SAMPLES, 3)):
        motion = Motion(heading_rad=0.0, travel=float(share), turn_rate_rad_s=float(turn))
        time_s = RAMP_DURATION_S + phase * period_s
        feet = gait_feet_body(robot, gait, motion, np.array([time_s]))[0]
        targets.append(joints_of_feet(robot, feet) - robot.stance_angles_rad)
        angle = 2 * np.pi * time_s / period_s
        inputs.append([np.sin(angle), np.cos(angle), share * full_m_s, 0.0, turn])
    scale = np.array([[1], [1], [1 / full_m_s], [0], [1 / TURN]])
    weights, biases = 1.5 * random.normal(size=(5, HIDDEN)) * scale, random.uniform(-2, 2, HIDDEN)
    hidden = np.hstack([np.tanh(np.array(inputs) @ weights + biases), np.ones((SAMPLES, 1))])
    solved = np.linalg.lstsq(hidden, np.array(targets), rcond=1e-9)[0]
    return Distilled(weights, biases, solved[:-1], solved[-1], period_s, full_m_s)


def network(found):
    """The ONNX network: input `obs`, (1, 5), output `actions`, (1, 18)."""
    arrays = {
        "w0": found.weights,
        "b0": found.biases,
        "w1": found.out / SCALE,
        "b1": found.out_biases / SCALE,
    }
    nodes = [
        helper.make_node("Gemm", ["obs", "w0", "b0"], ["hidden"]),
        helper.make_node("Tanh", ["hidden"], ["active"]),
        helper.make_node("Gemm", ["active", "w1", "b1"], ["actions"]),
    ]
    ends = [
        [helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, size])]
        for name, size in (("obs", 5), ("actions", 18))
    ]
    weights = [numpy_helper.from_array(array.astype(np.float32), name) for name, array in arrays.items()]
    graph = helper.make_graph(nodes, "tripod", *ends, weights)
    return helper.make_model(graph, ir_version=8, opset_imports=[helper.make_opsetid("", 17)])


def contract(robot, found):
    """What hexctl must know to run the network."""
    return {
        "control_hz": 50,
        "joints": list(JOINT_NAMES),
        "default_rad": robot.stance_angles_rad.tolist(),
        "action": {"scale": SCALE, "offset_rad": "default"},
        "observations": [{"name": "gait_phase", "period_s": found.period_s}, {"name": "command"}],
        "normaliser": "none",
        "command": {
            "forward_m_s": [0.0, float(found.full_m_s)],
            "left_m_s": [0.0, 0.0],
            "turn_rad_s": [-TURN, TURN],
        },
    }


if __name__ == "__main__":
    robot = hexctl.load_robot(sys.argv[1] if len(sys.argv) > 1 else "ant")
    found = distil(robot)
    onnx.save(network(found), "walk.onnx")
    with open("walk.yaml", "w") as file:
        yaml.safe_dump(contract(robot, found), file, sort_keys=False)
    print(f"walk.onnx and walk.yaml: a tripod of {robot.name}, up to {found.full_m_s:.2f} m/s")
