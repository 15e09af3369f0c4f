"""Networks of tests: hexctl's own tripod distilled into a small network, as files of each exporter."""

import runpy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from hexctl.robot.model import Robot
from hexctl.types import JOINT_NAMES, N_JOINTS, FloatArray
from tests.robots import shipped

pytest.importorskip("onnxruntime", reason="only with the extra `policy`")
pytest.importorskip("onnx", reason="networks of tests are written with onnx")

#: The example that distils hexctl's tripod.
EXAMPLE: Any = runpy.run_path(str(Path(__file__).parents[3] / "examples" / "policy_of_gait.py"))

#: Order of joints of training programs: joint by joint, not leg by leg.
BY_KIND = tuple(f"leg{leg}_{kind}" for kind in ("coxa", "femur", "tibia") for leg in range(1, 7))


@cache
def gaiter(name: str = "ant") -> Any:
    """The tripod of a shipped robot, distilled by the example."""
    return EXAMPLE["distil"](shipped(name))


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """What a network observes and how its actions count.

    Attributes:
        terms: widths by name, in order.
        joints: names in the order of actions.
        scales: of terms by name, which the weights undo.
        histories: of terms by name.
        by_time: whether histories are joined time by time.
        signs: of the joints' directions by hexctl's name, -1 for those that turn the other way.
        action_scale: rad per action.
        feedback: rad of targets per unit of a term before its scale, by its name: of the same joint for terms
            of joints, of femurs for others, and for gravity per deviation from the vertical.
    """

    terms: Mapping[str, int]
    joints: Sequence[str] = BY_KIND
    scales: Mapping[str, float] = field(default_factory=dict)
    histories: Mapping[str, int] = field(default_factory=dict)
    by_time: bool = False
    signs: Mapping[str, float] = field(default_factory=dict)
    action_scale: float = 0.25
    feedback: Mapping[str, float] = field(default_factory=dict)

    @property
    def size(self) -> int:
        return sum(width * self.histories.get(name, 1) for name, width in self.terms.items())

    def newest(self, name: str) -> slice:
        """Place of a term's newest value in the observation."""
        start = 0
        if self.by_time:
            start = self.size - sum(self.terms.values())
        for other, width in self.terms.items():
            length = 1 if self.by_time else self.histories.get(other, 1)
            if other == name:
                return slice(start + (length - 1) * width, start + length * width)
            start += length * width
        raise KeyError(name)

    @property
    def sign(self) -> FloatArray:
        """Directions in the order of actions, (18,)."""
        return np.array([self.signs.get(name, 1.0) for name in self.joints])

    @property
    def order(self) -> list[int]:
        return [JOINT_NAMES.index(name) for name in self.joints]

    def default_rad(self, robot: Robot) -> list[float]:
        """The stance as the policy counts angles."""
        return [float(one) for one in self.sign * robot.stance_angles_rad[self.order]]


PHASE, COMMAND = ("gait_phase",), ("command", "velocity_commands", "twist")


def layers(walk: Any, layout: Layout) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Weights and biases of a walk for a layout: hidden (size, hidden), and output (hidden, 18)."""
    weights = np.zeros((layout.size, len(walk.biases)))
    for name in layout.terms:
        scale = layout.scales.get(name, 1.0)
        if name in PHASE:
            weights[layout.newest(name)] = walk.weights[:2] / scale
        elif name in COMMAND:
            weights[layout.newest(name)] = walk.weights[2:] / scale
    own = layout.sign / layout.action_scale
    return weights, walk.biases, walk.out[:, layout.order] * own, walk.out_biases[layout.order] * own


def feedback_of(layout: Layout) -> tuple[FloatArray, FloatArray]:
    """Weights (size, 18) from the observation to actions, and their actions at rest, (18,)."""
    weights, rest = np.zeros((layout.size, N_JOINTS)), np.zeros(layout.size)
    femurs = np.array([name.endswith("femur") for name in layout.joints])
    for name, gain in layout.feedback.items():
        own = gain / layout.action_scale / layout.scales.get(name, 1.0)
        place = layout.newest(name)
        weights[place] = (
            own * np.eye(N_JOINTS) if layout.terms[name] == N_JOINTS else own * femurs * layout.sign
        )
        if name == "projected_gravity":
            rest[place] = [0.0, 0.0, -layout.scales.get(name, 1.0)]
    return weights, rest @ weights


def write_onnx(
    path: Path,
    walk: Any,
    layout: Layout,
    metadata: Mapping[str, str] | None = None,
    *,
    input_name: str = "obs",
    output_name: str = "actions",
    mean: FloatArray | None = None,
    std: FloatArray | None = None,
) -> Path:
    """Write a network with a normaliser in its graph, if one is given."""
    import onnx
    from onnx import TensorProto, helper, numpy_helper

    weights, biases, out, out_biases = layers(walk, layout)
    if mean is not None and std is not None:
        weights, biases = weights * std[:, np.newaxis], biases + mean @ weights
    feedback, at_rest = feedback_of(layout)
    if mean is not None and std is not None:
        at_rest = at_rest - mean @ feedback
        feedback = feedback * std[:, np.newaxis]
    arrays = {"w0": weights, "b0": biases, "w1": out, "b1": out_biases - at_rest, "w2": feedback}
    if mean is not None and std is not None:
        arrays |= {"mean": mean[np.newaxis], "std": std[np.newaxis]}
    nodes, source = [], input_name
    if mean is not None:
        nodes = [
            helper.make_node("Sub", [source, "mean"], ["centred"]),
            helper.make_node("Div", ["centred", "std"], ["normal"]),
        ]
        source = "normal"
    nodes += [
        helper.make_node("Gemm", [source, "w0", "b0"], ["hidden"]),
        helper.make_node("Tanh", ["hidden"], ["active"]),
        helper.make_node("Gemm", ["active", "w1", "b1"], ["walk"]),
        helper.make_node("Gemm", [source, "w2", "walk"], [output_name]),
    ]
    graph = helper.make_graph(
        nodes,
        "policy",
        [helper.make_tensor_value_info(input_name, TensorProto.FLOAT, [1, layout.size])],
        [helper.make_tensor_value_info(output_name, TensorProto.FLOAT, [1, N_JOINTS])],
        [numpy_helper.from_array(array.astype(np.float32), name) for name, array in arrays.items()],
    )
    model = helper.make_model(graph, ir_version=8, opset_imports=[helper.make_opsetid("", 17)])
    for key, value in (metadata or {}).items():
        entry = model.metadata_props.add()
        entry.key, entry.value = key, value
    onnx.save(model, path)
    return path


def mjlab_text(values: Sequence[Any]) -> str:
    """A list as mjlab's exporter writes it (`list_to_csv_str`): commas, three decimals, semicolons within."""

    def one(value: Any) -> str:
        return f"{value:.3f}" if isinstance(value, int | float) else str(value)

    return ",".join(";".join(map(one, value)) if isinstance(value, list) else one(value) for value in values)


def write_yaml(path: Path, content: Mapping[str, Any]) -> Path:
    path.write_text(yaml.safe_dump(dict(content), sort_keys=False))
    return path


def ranges_of(walk: Any) -> dict[str, list[float]]:
    """Ranges of a command in the words of hexctl's contract."""
    command: dict[str, list[float]] = EXAMPLE["contract"](shipped(), walk)["command"]
    return command


# ---- files of each exporter; each returns the network


def mjlab(folder: Path, name: str = "ant") -> Path:
    """A network with mjlab's metadata, and the two keys that those lack."""
    robot, walk = shipped(name), gaiter(name)
    terms = {
        "projected_gravity": 3,
        "joint_pos": 18,
        "joint_vel": 18,
        "actions": 18,
        "command": 3,
        "gait_phase": 2,
    }
    layout = Layout(terms, scales={"joint_vel": 0.05}, histories={"joint_pos": 3})
    metadata = {
        "run_path": "local",
        "joint_names": mjlab_text(list(BY_KIND)),
        "joint_stiffness": mjlab_text([20.0] * N_JOINTS),
        "joint_damping": mjlab_text([1.0] * N_JOINTS),
        "default_joint_pos": mjlab_text(layout.default_rad(robot)),
        "command_names": "twist",
        "observation_names": mjlab_text([*terms]),
        "observation_terms_scale": mjlab_text([layout.scales.get(term, 1.0) for term in terms]),
        "observation_terms_flatten_history_dim": mjlab_text([True] * len(terms)),
        "observation_terms_history_length": mjlab_text([layout.histories.get(term, 0) for term in terms]),
        "observation_terms_clip": mjlab_text([[-float("inf"), float("inf")]] * len(terms)),
        "action_scale": mjlab_text([layout.action_scale] * N_JOINTS),
    }
    random = np.random.default_rng(1)
    mean, std = random.normal(size=layout.size), random.uniform(0.5, 2.0, layout.size)
    path = write_onnx(folder / "mjlab.onnx", walk, layout, metadata, mean=mean, std=std)
    added = {
        "control_hz": 50,
        "command": ranges_of(walk),
        "terms": {"gait_phase": {"period_s": walk.period_s}},
    }
    write_yaml(folder / "mjlab.yaml", added)
    return path


def isaac_lab(folder: Path, name: str = "ant") -> Path:
    """A network with Isaac Lab's IO descriptor."""
    robot, walk = shipped(name), gaiter(name)
    terms = {
        "base_ang_vel": 3,
        "projected_gravity": 3,
        "generated_commands": 3,
        "joint_pos_rel": 18,
        "joint_vel_rel": 18,
        "last_action": 18,
        "gait_phase": 2,
    }
    layout = Layout(terms, scales={"base_ang_vel": 0.25, "joint_vel_rel": 0.05}, histories={"last_action": 2})
    walk_layout = Layout(
        {("command" if term == "generated_commands" else term): width for term, width in terms.items()},
        scales=layout.scales,
        histories=layout.histories,
    )
    defaults = layout.default_rad(robot)

    def described(term: str) -> dict[str, Any]:
        overloads = {
            "clip": [-100.0, 100.0],
            "scale": layout.scales.get(term),
            "history_length": layout.histories.get(term, 0),
            "flatten_history_dim": True,
        }
        found: dict[str, Any] = {"name": term, "overloads": overloads, "shape": [terms[term]]}
        if term.startswith("joint_"):
            found["joint_names"] = list(BY_KIND)
        if term == "joint_pos_rel":
            found["joint_pos_offsets"] = defaults
        return found

    descriptor = {
        "actions": [
            {
                "action_type": "JointPositionAction",
                "joint_names": list(BY_KIND),
                "scale": layout.action_scale,
                "offset": defaults,
                "clip": None,
            }
        ],
        "articulations": {"robot": {"joint_names": list(BY_KIND), "default_joint_pos": defaults}},
        "observations": {"policy": [described(term) for term in terms]},
        "scene": {"decimation": 4, "dt": 0.02, "physics_dt": 0.005},
    }
    write_yaml(folder / "IO_descriptors.yaml", descriptor)
    added = {"command": ranges_of(walk), "terms": {"gait_phase": {"period_s": walk.period_s}}}
    write_yaml(folder / "isaac.yaml", {"from": "IO_descriptors.yaml", **added})
    return write_onnx(folder / "isaac.onnx", walk, walk_layout)


def unitree(folder: Path, name: str = "ant") -> Path:
    """A network with a deploy.yaml of Unitree, whose joints are numbers of motors, and histories by time."""
    robot, walk = shipped(name), gaiter(name)
    motors = [f"leg{leg}_{kind}" for leg in (6, 5, 4, 3, 2, 1) for kind in ("coxa", "femur", "tibia")]
    terms = {
        "base_ang_vel": 3,
        "projected_gravity": 3,
        "velocity_commands": 3,
        "joint_pos_rel": 18,
        "joint_vel_rel": 18,
        "last_action": 18,
        "gait_phase": 2,
    }
    scales, histories = {"base_ang_vel": 0.2, "joint_vel_rel": 0.05}, dict.fromkeys(terms, 4)
    signs = {f"leg{leg}_coxa": -1.0 for leg in (4, 5, 6)}
    layout = Layout(terms, scales=scales, histories=histories, by_time=True, signs=signs)
    defaults = layout.default_rad(robot)
    keys = ("lin_vel_x", "lin_vel_y", "ang_vel_z")
    deploy = {
        "joint_ids_map": [motors.index(joint) for joint in BY_KIND],
        "step_dt": 0.02,
        "stiffness": [20.0] * N_JOINTS,
        "damping": [1.0] * N_JOINTS,
        "default_joint_pos": defaults,
        "commands": {"base_velocity": {"ranges": dict(zip(keys, ranges_of(walk).values(), strict=True))}},
        "actions": {
            "JointPositionAction": {
                "clip": [[-3.0, 3.0]] * N_JOINTS,
                "joint_names": [".*"],
                "scale": [layout.action_scale] * N_JOINTS,
                "offset": defaults,
                "joint_ids": None,
            }
        },
        "observations": {
            "use_gym_history": True,
            **{
                term: {
                    "params": {"period": walk.period_s} if term == "gait_phase" else {},
                    "clip": [-100.0, 100.0],
                    "scale": [scales.get(term, 1.0)] * width,
                    "history_length": histories[term],
                }
                for term, width in terms.items()
            },
        },
    }
    write_yaml(folder / "deploy.yaml", deploy)
    write_yaml(
        folder / "unitree.yaml",
        {"from": "deploy.yaml", "motors": [("-" if motor in signs else "") + motor for motor in motors]},
    )
    return write_onnx(folder / "unitree.onnx", walk, layout)


def own_contract(name: str = "ant", layout: "Layout | None" = None) -> dict[str, Any]:
    """hexctl's own contract of a distilled walk."""
    robot, walk = shipped(name), gaiter(name)
    layout = layout or OWN
    joints = [("-" if layout.signs.get(joint, 1) < 0 else "") + joint for joint in layout.joints]
    terms: list[dict[str, Any]] = [
        {
            "name": term,
            "scale": layout.scales.get(term, 1.0),
            "history": layout.histories.get(term, 1),
            **({"period_s": walk.period_s} if term == "gait_phase" else {}),
        }
        for term in layout.terms
    ]
    return {
        "control_hz": 50,
        "joints": joints,
        "default_rad": layout.default_rad(robot),
        "action": {"scale": layout.action_scale, "offset_rad": "default"},
        "observations": terms,
        "normaliser": "none",
        "command": ranges_of(walk),
    }


OWN = Layout(
    {
        "base_ang_vel": 3,
        "projected_gravity": 3,
        "joint_pos_rel": 18,
        "joint_vel": 18,
        "actions": 18,
        "command": 3,
        "gait_phase": 2,
    },
    scales={"base_ang_vel": 0.25, "joint_vel": 0.05, "command": 2.0},
    signs={"leg1_femur": -1.0, "leg4_tibia": -1.0},
)


def own(folder: Path, name: str = "ant", layout: Layout = OWN, **changes: Any) -> Path:
    """A network with hexctl's own contract, with some keys changed."""
    write_yaml(folder / "own.yaml", own_contract(name, layout) | changes)
    return write_onnx(folder / "own.onnx", gaiter(name), layout)


MAKERS = {"mjlab": mjlab, "isaac": isaac_lab, "unitree": unitree, "own": own}


def without_imu(path: Path) -> Path:
    """The same network for a robot without an IMU: its contract says what to put in place of it."""
    contract = path.with_suffix(".yaml")
    content = yaml.safe_load(contract.read_text())
    stand_in = {"projected_gravity": [0, 0, -1]}
    if path.stem != "mjlab":
        stand_in |= {"base_ang_vel": [0, 0, 0]}
    write_yaml(contract, content | {"stand_in": stand_in})
    return path
