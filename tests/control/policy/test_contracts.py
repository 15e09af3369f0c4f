"""Contracts: read from each source, refused by name, drafted; and hostile networks, which are refused."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from hexctl.control.policy.contract import ALIASES, WIDTHS
from hexctl.control.policy.contract_file import contract_of
from hexctl.control.policy.contract_sources import from_isaac_lab, from_mjlab, from_unitree
from hexctl.control.policy.description import problems
from hexctl.control.policy.draft import draft_of
from hexctl.control.policy.onnx_network import OnnxFile
from hexctl.control.policy.policy import Policy
from hexctl.errors import InputError
from hexctl.types import JOINT_NAMES, FloatArray
from tests.control.policy import networks
from tests.robots import shipped

onnx: Any = pytest.importorskip("onnx", reason="networks of tests are written with onnx")

PATH = Path("walk.yaml")


def changed(**changes: Any) -> dict[str, Any]:
    content = networks.own_contract() | changes
    return {key: value for key, value in content.items() if value is not None}


def test_a_contract_says_how_actions_become_angles_and_back() -> None:
    contract = contract_of(changed(), PATH, "a test")
    robot = shipped()
    np.testing.assert_allclose(contract.joints_rad(contract.default_rad), robot.stance_angles_rad)
    femur = list(contract.joints).index(JOINT_NAMES.index("leg1_femur"))
    raised = contract.joints_rad(contract.default_rad + 0.1 * (np.arange(18) == femur))
    assert raised[JOINT_NAMES.index("leg1_femur")] == pytest.approx(robot.stance_angles_rad[1] - 0.1)
    assert contract.observation_size == len(contract.observation_names) == networks.OWN.size


def test_a_zero_shifts_an_angle() -> None:
    zeros = {"-leg1_femur": 0.5}
    default = networks.own_contract()["default_rad"]
    contract = contract_of(changed(zeros_rad=zeros, default_rad=default), PATH, "a test")
    robot = shipped()
    pose = contract.joints_rad(contract.default_rad)
    assert pose[1] == pytest.approx(robot.stance_angles_rad[1] + 0.5)
    assert problems(Policy(contract, lambda seen: seen[:18]), robot), "one foot is off the floor"


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"control_hz": None}, "control_hz"),
        ({"control_hz": 100}, "control_hz"),
        ({"control_hz": "?"}, "control_hz"),
        ({"joints": None}, "joints"),
        ({"joints": networks.own_contract()["joints"][:12]}, "joints"),
        ({"joints": [*networks.own_contract()["joints"][:17], "leg1_coxa"]}, "leg1_coxa twice"),
        ({"joints": [*networks.own_contract()["joints"][:17], "lf_hip"]}, "lf_hip"),
        ({"joint_map": {"leg1_coxa": "leg9_coxa"}}, "leg9_coxa"),
        ({"default_rad": None}, "default_rad"),
        ({"default_rad": [0.0] * 17}, "default_rad"),
        ({"default_rad": [30.0] * 18}, "rad, not in degrees"),
        ({"action": None}, "action"),
        ({"action": {"offset_rad": "default"}}, "scale"),
        ({"action": {"scale": [0.25] * 12, "offset_rad": "default"}}, "action.scale"),
        ({"action": {"scale": 0.25}}, "offset_rad"),
        ({"action": {"scale": 0.25, "offset_rad": "default", "clip": [1, -1]}}, "clip"),
        ({"action": {"scale": 0.25, "offset_rad": "default", "clip": [[-1, 1]]}}, "clip"),
        ({"observations": None}, "observations"),
        ({"observations": [{"name": "height_scan"}]}, "height_scan"),
        ({"observations": [{"name": "joint_pos"}]}, "joint_pos_rel"),
        ({"observations": [{"name": "gait_phase"}]}, "period_s"),
        ({"observations": [{"name": "command", "scale": [2, 2]}]}, "command: scale"),
        ({"observations": [{"name": "command"}], "command": None}, "command"),
        ({"observations": [{"name": "command"}, {"name": "command"}]}, "command twice"),
        ({"observations": [{"name": "actions", "history": 0}]}, "history"),
        (
            {
                "observations": [{"name": "actions", "history": 2}, {"name": "command"}],
                "history_order": "by_time",
            },
            "history_order",
        ),
        ({"normaliser": None}, "normaliser"),
        ({"normaliser": {"mean": [0.0], "std": [1.0]}}, "normaliser.mean"),
        ({"normaliser": {"mean": [0.0] * 65, "std": [0.0] * 65}}, "std"),
        ({"command": {"forward_m_s": [1, -1], "left_m_s": [0, 0], "turn_rad_s": [0, 0]}}, "forward_m_s"),
        ({"stand_in": {"other": [0.0]}}, "other"),
        ({"stand_in": {"base_ang_vel": "commanded"}}, "base_ang_vel"),
        ({"stand_in": {"base_ang_vel": [0.0]}}, "base_ang_vel"),
        ({"speed": 3}, "speed"),
    ],
)
def test_what_a_contract_lacks_or_has_wrong_is_refused_by_name(changes: dict[str, Any], named: str) -> None:
    with pytest.raises(InputError, match=named):
        contract_of(changed(**changes), PATH, "a test")


def test_other_names_of_terms_stand_for_known_kinds() -> None:
    assert set(ALIASES.values()) == set(WIDTHS)


def test_keys_that_the_program_writes_and_a_file_lacks_are_refused_by_name(tmp_path: Path) -> None:
    networks.isaac_lab(tmp_path)
    networks.unitree(tmp_path)
    descriptor = yaml.safe_load((tmp_path / "IO_descriptors.yaml").read_text())
    deploy = yaml.safe_load((tmp_path / "deploy.yaml").read_text())
    for path in ("actions", "articulations.robot.joint_names", "scene.dt", "observations.policy"):
        with pytest.raises(InputError, match=path.rpartition(".")[2]):
            from_isaac_lab(_without(descriptor, path), "IO_descriptors.yaml")
    for path in ("joint_ids_map", "step_dt", "default_joint_pos", "actions.JointPositionAction.offset"):
        with pytest.raises(InputError, match=path.rpartition(".")[2]):
            from_unitree(_without(deploy, path), "deploy.yaml", JOINT_NAMES)
    with pytest.raises(InputError, match="motors"):
        from_unitree(deploy, "deploy.yaml", None)
    for key in ("joint_names", "default_joint_pos", "observation_names", "action_scale"):
        metadata = {
            "joint_names": "a",
            "default_joint_pos": "0",
            "observation_names": "a",
            "action_scale": "1",
        }
        with pytest.raises(InputError, match=key):
            from_mjlab({name: text for name, text in metadata.items() if name != key}, "walk.onnx")


def _without(content: dict[str, Any], path: str) -> dict[str, Any]:
    first, _, rest = path.partition(".")
    inner = {key: value for key, value in content.items() if rest or key != first}
    return inner | {first: _without(content[first], rest)} if rest else inner


def test_a_target_is_clipped_after_its_scale_and_a_raw_action_before(tmp_path: Path) -> None:
    networks.unitree(tmp_path)
    deploy = yaml.safe_load((tmp_path / "deploy.yaml").read_text())
    content = from_unitree(deploy, "deploy.yaml", JOINT_NAMES)
    assert content["action"]["target_clip_rad"] == [[-3.0, 3.0]] * 18
    assert "clip" not in content["action"]
    assert content["history_order"] == "by_time"
    plain = from_unitree({**deploy, "observations": {"last_action": {"history_length": 3}}}, "x", JOINT_NAMES)
    assert plain["history_order"] == "by_term"


def test_terms_are_clipped_and_scaled_in_the_order_of_the_file() -> None:
    from hexctl.control.policy.contract import Term
    from hexctl.control.policy.observation import scaled

    term = Term(name="a", kind="command", scale=np.full(3, 2.0), clip=np.array([-1.0, 1.0]))
    values = np.array([0.75, 3.0, -3.0])
    assert scaled(term, values).tolist() == [1.5, 2.0, -2.0]
    from dataclasses import replace

    assert scaled(replace(term, scale_first=True), values).tolist() == [1.0, 1.0, -1.0]


def test_a_network_without_a_contract_is_refused_with_the_next_step_and_its_draft_names_what_to_fill(
    tmp_path: Path,
) -> None:
    path = networks.own(tmp_path)
    (tmp_path / "own.yaml").unlink()
    with pytest.raises(InputError, match="hexctl policy new"):
        Policy.load(path)
    draft = draft_of(OnnxFile.read(path))
    (tmp_path / "own.yaml").write_text(draft)
    assert set(yaml.safe_load(draft)) >= {"control_hz", "joints", "default_rad", "action", "normaliser"}
    with pytest.raises(InputError, match="control_hz"):
        Policy.load(path)


def test_a_bare_file_of_mjlab_lacks_only_rate_command_and_period(tmp_path: Path) -> None:
    path = networks.mjlab(tmp_path)
    filled = yaml.safe_load((tmp_path / "mjlab.yaml").read_text())
    (tmp_path / "mjlab.yaml").unlink()
    draft = yaml.safe_load(draft_of(OnnxFile.read(path)))
    assert set(draft) == set(filled)
    with pytest.raises(InputError, match="control_hz"):
        Policy.load(path)


def test_files_of_other_programs_are_found_beside_the_network_and_may_have_the_missing_keys(
    tmp_path: Path,
) -> None:
    path = networks.unitree(tmp_path)
    added = yaml.safe_load((tmp_path / "unitree.yaml").read_text())
    (tmp_path / "unitree.yaml").unlink()
    with pytest.raises(InputError, match="motors"):
        Policy.load(path)
    deploy = yaml.safe_load((tmp_path / "deploy.yaml").read_text())
    networks.write_yaml(tmp_path / "deploy.yaml", deploy | {"motors": added["motors"]})
    assert Policy.load(path).contract.history_by_time


def test_a_normaliser_outside_the_network_equals_one_inside(tmp_path: Path) -> None:
    random = np.random.default_rng(2)
    size = networks.OWN.size
    mean, std = random.normal(size=size), random.uniform(0.5, 2, size)
    inside = networks.write_onnx(tmp_path / "in.onnx", networks.gaiter(), networks.OWN, mean=mean, std=std)
    networks.write_yaml(tmp_path / "in.yaml", networks.own_contract() | {"normaliser": "in_graph"})
    # The same weights, with what the graph does before them done by hexctl.
    model = onnx.load(inside)
    del model.graph.node[:2]
    for node in model.graph.node:
        node.input[:] = ["obs" if name == "normal" else name for name in node.input]
    onnx.save(model, tmp_path / "out.onnx")
    normaliser = {"mean": mean.tolist(), "std": std.tolist()}
    networks.write_yaml(tmp_path / "out.yaml", networks.own_contract() | {"normaliser": normaliser})
    seen = random.normal(size=size)
    actions: list[FloatArray] = [Policy.load(tmp_path / f"{name}.onnx")(seen) for name in ("in", "out")]
    np.testing.assert_allclose(actions[0], actions[1], atol=1e-4)


def test_sizes_that_differ_are_refused_with_those_of_the_terms(tmp_path: Path) -> None:
    path = networks.own(tmp_path)
    contract = networks.own_contract()
    networks.write_yaml(tmp_path / "own.yaml", contract | {"observations": contract["observations"][1:]})
    with pytest.raises(InputError, match="joint_pos_rel 18"):
        Policy.load(path)


# ---- hostile files


def model_of(path: Path) -> Any:
    return onnx.load(networks.own(path))


def _huge(model: Any) -> None:
    tensor = model.graph.initializer[0]
    tensor.dims[:] = [1 << 40, 1 << 20]


def _filled(model: Any) -> None:
    """A constant of a terabyte that the library would compute before the first inference."""
    shape = onnx.numpy_helper.from_array(np.array([1 << 19, 1 << 19], dtype=np.int64), "shape")
    model.graph.initializer.append(shape)
    model.graph.node.insert(0, onnx.helper.make_node("ConstantOfShape", ["shape"], ["filled"]))
    model.graph.node.insert(1, onnx.helper.make_node("ReduceSum", ["filled"], ["sum"], keepdims=0))
    model.graph.node[-1].output[0] = "before"
    model.graph.node.append(onnx.helper.make_node("Add", ["before", "sum"], ["actions"]))


def _external(model: Any) -> None:
    tensor = model.graph.initializer[0]
    tensor.ClearField("raw_data")
    tensor.data_location = onnx.TensorProto.EXTERNAL
    for key, value in (("location", "/etc/passwd"), ("length", "100")):
        entry = tensor.external_data.add()
        entry.key, entry.value = key, value


def _custom(model: Any) -> None:
    model.graph.node[0].op_type, model.graph.node[0].domain = "Mine", "mine"
    model.opset_import.append(onnx.helper.make_opsetid("mine", 1))


def _two_inputs(model: Any) -> None:
    extra = onnx.helper.make_tensor_value_info("h_in", onnx.TensorProto.FLOAT, [1, 64])
    model.graph.input.append(extra)


def _twelve(model: Any) -> None:
    for name, axis in (("w1", 1), ("b1", 0), ("w2", 1)):
        (tensor,) = [one for one in model.graph.initializer if one.name == name]
        array = onnx.numpy_helper.to_array(tensor).take(range(12), axis=axis)
        tensor.CopyFrom(onnx.numpy_helper.from_array(array, name))
    model.graph.output[0].type.tensor_type.shape.dim[1].dim_value = 12


@pytest.mark.parametrize(
    "spoil", [_huge, _filled, _external, _custom, _two_inputs, _twelve], ids=lambda spoil: str(spoil.__name__)
)
def test_a_hostile_network_is_refused_with_one_line(spoil: Callable[[Any], None], tmp_path: Path) -> None:
    model = model_of(tmp_path)
    spoil(model)
    (tmp_path / "own.onnx").write_bytes(model.SerializeToString())
    with pytest.raises(InputError) as refused:
        Policy.load(tmp_path / "own.onnx")
    assert "\n" not in str(refused.value)
    assert "own.onnx" in str(refused.value)


@pytest.mark.parametrize("content", ["random", "half", "empty", "text", "large"])
def test_a_file_that_is_no_network_is_refused(content: str, tmp_path: Path) -> None:
    path = networks.own(tmp_path)
    whole = path.read_bytes()
    spoiled = {
        "random": np.random.default_rng(1).bytes(5000),
        "half": whole[: len(whole) // 2],
        "empty": b"",
        "text": b"#!/bin/sh\n",
    }
    if content == "large":
        os.truncate(path, 65_000_000)
    else:
        path.write_bytes(spoiled[content])
    with pytest.raises(InputError, match=r"own\.onnx"):
        Policy.load(path)


def test_a_file_that_is_missing_or_a_folder_or_a_pipe_is_refused(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.onnx")
    for name in ("missing.onnx", "pipe.onnx", "."):
        with pytest.raises(InputError, match="policy"):
            Policy.load(tmp_path / name)
