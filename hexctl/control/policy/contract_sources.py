"""Contracts of other programs, in the words of hexctl's contract file.

Each function takes what a program wrote and returns keys of `ContractFile`; what a program does not write is
left out, and its absence is refused by name.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from hexctl.errors import InputError

#: Entries of mjlab's metadata of an ONNX file.
MJLAB_KEYS = ("joint_names", "default_joint_pos", "observation_names", "action_scale")


class _Source:
    """Looks up keys, and refuses what is missing by name."""

    def __init__(self, content: Mapping[str, Any], name: str) -> None:
        self._content, self.name = content, name

    def __call__(self, path: str) -> Any:
        found: Any = self._content
        for part in path.split("."):
            if not isinstance(found, Mapping) or part not in found:
                raise InputError(f"{self.name}: {path} is missing; allowed: a file as its program writes it")
            found = found[part]
        return found

    def get(self, path: str) -> Any:
        try:
            return self(path)
        except InputError:
            return None


def is_of_mjlab(metadata: Mapping[str, str]) -> bool:
    """Whether metadata of an ONNX file are those of mjlab."""
    return any(key in metadata for key in MJLAB_KEYS)


def from_mjlab(metadata: Mapping[str, str], name: str) -> dict[str, Any]:
    """Keys of the metadata that mjlab's exporter writes: lists are texts with commas, their parts semicolons.

    Joint angles are relative, the offset of actions is the default pose, values are clipped before they are
    scaled, and the normaliser is in the graph. The metadata have no control rate and no ranges of commands,
    unless `control_hz` or `command_ranges` are added: six numbers, lowest and highest velocity forward, left
    and of the turn.
    """
    source = _Source(metadata, name)
    names = _texts(source("observation_names"))
    scales = _each(source.get("observation_terms_scale"), len(names), name, "observation_terms_scale")
    clips = _each(source.get("observation_terms_clip"), len(names), name, "observation_terms_clip")
    lengths = _each(
        source.get("observation_terms_history_length"), len(names), name, "observation_terms_history_length"
    )
    flat = _texts(source.get("observation_terms_flatten_history_dim") or "")
    if "False" in flat and any(length and length[0] > 1 for length in lengths):
        raise InputError(f"{name}: observation_terms_flatten_history_dim: got False; allowed: True")
    content: dict[str, Any] = {
        "joints": _texts(source("joint_names")),
        "default_rad": _numbers(source("default_joint_pos"), name, "default_joint_pos"),
        "action": {
            "scale": _one(_numbers(source("action_scale"), name, "action_scale")),
            "offset_rad": "default",
        },
        "normaliser": "in_graph",
        "observations": [
            _term(
                term,
                kind="joint_pos_rel" if term == "joint_pos" else None,
                scale=_one(scale),
                clip=clip,
                history=max(1, int(length[0])) if length else 1,
            )
            for term, scale, clip, length in zip(names, scales, clips, lengths, strict=True)
        ],
    }
    if "control_hz" in metadata:
        content["control_hz"] = _one(_numbers(metadata["control_hz"], name, "control_hz"))
    if "command_ranges" in metadata:
        ranges = _numbers(metadata["command_ranges"], name, "command_ranges")
        if len(ranges) != 6:
            raise InputError(f"{name}: command_ranges: got {len(ranges)} numbers; allowed: 6")
        content["command"] = _command(*(ranges[place : place + 2] for place in (0, 2, 4)))
    return content


def is_of_isaac_lab(content: Mapping[str, Any]) -> bool:
    """Whether a file is an IO descriptor of Isaac Lab."""
    return isinstance(content.get("articulations"), Mapping) and "observations" in content


def from_isaac_lab(content: Mapping[str, Any], name: str) -> dict[str, Any]:
    """Keys of Isaac Lab's IO descriptor: values are clipped before they are scaled, targets after that."""
    source = _Source(content, name)
    actions, terms = source("actions"), source("observations.policy")
    if not isinstance(actions, list) or len(actions) != 1 or not isinstance(actions[0], Mapping):
        got = len(actions) if isinstance(actions, list) else actions
        raise InputError(f"{name}: actions: got {got}; allowed: one, of joint positions")
    action = _Source(actions[0], f"{name}: actions")
    if (kind := str(action.get("action_type") or action.get("name") or "")) and "ositionAction" not in kind:
        raise InputError(f"{name}: actions: got {kind}; allowed: JointPositionAction")
    found: dict[str, Any] = {
        "control_hz": round(1 / float(source("scene.dt")), 6),
        "joints": source("articulations.robot.joint_names"),
        "default_rad": source("articulations.robot.default_joint_pos"),
        "action": {
            "joints": action("joint_names"),
            "scale": action("scale"),
            "offset_rad": action("offset"),
            "target_clip_rad": action.get("clip"),
        },
        "normaliser": "in_graph",
    }
    if not isinstance(terms, list):
        raise InputError(f"{name}: observations.policy: got {terms!r}; allowed: a list of terms")
    found["observations"] = [_isaac_term(term, name) for term in terms]
    return found


def _isaac_term(term: Any, name: str) -> dict[str, Any]:
    source = _Source(term if isinstance(term, Mapping) else {}, f"{name}: observations.policy")
    called, length = str(source("name")), source.get("overloads.history_length") or 1
    if length > 1 and source.get("overloads.flatten_history_dim") is False:
        raise InputError(f"{name}: {called}: flatten_history_dim: got False; allowed: True")
    offsets = source.get("joint_pos_offsets")
    kind = None
    if called in ("joint_pos", "joint_pos_rel"):
        kind = "joint_pos_abs" if offsets is None else "joint_pos_rel"
    about_joints = called.startswith("joint_")
    scale = source.get("overloads.scale")
    return _term(
        called,
        kind=kind,
        scale=1.0 if scale is None else scale,
        clip=source.get("overloads.clip"),
        history=length,
        joints=source.get("joint_names") if about_joints else None,
        offsets_rad=offsets if kind == "joint_pos_rel" else None,
    )


def is_of_unitree(content: Mapping[str, Any]) -> bool:
    """Whether a file is a deploy.yaml of Unitree."""
    return "joint_ids_map" in content


def from_unitree(content: Mapping[str, Any], name: str, motors: Sequence[str] | None) -> dict[str, Any]:
    """Keys of Unitree's deploy.yaml, whose joints are numbers of `motors` of hexctl's file."""
    source = _Source(content, name)
    numbers = source("joint_ids_map")
    if motors is None:
        raise InputError(
            f"{name}: it has no names of joints; write those of the motors that joint_ids_map counts into "
            "hexctl's contract file, in their order: motors: [leg1_coxa, ...]"
        )
    if not isinstance(numbers, list) or sorted(map(str, numbers)) != sorted(map(str, range(len(motors)))):
        raise InputError(
            f"{name}: joint_ids_map: got {numbers}; allowed: each number of {len(motors)} motors once"
        )
    joints = [motors[int(number)] for number in numbers]
    action = _Source(source("actions.JointPositionAction"), f"{name}: actions.JointPositionAction")
    own = action.get("joint_ids")
    terms = dict(source("observations"))
    by_time = terms.pop("use_gym_history", content.get("use_gym_history", False))
    found: dict[str, Any] = {
        "control_hz": round(1 / float(source("step_dt")), 6),
        "joints": joints,
        "default_rad": source("default_joint_pos"),
        "action": {
            "joints": None if own is None else [joints[int(number)] for number in own],
            "scale": action("scale"),
            "offset_rad": action("offset"),
            "target_clip_rad": action.get("clip"),
        },
        "normaliser": "in_graph",
        "history_order": "by_time" if by_time else "by_term",
        "observations": [_unitree_term(called, term, name) for called, term in terms.items()],
    }
    if (ranges := source.get("commands.base_velocity.ranges")) is not None:
        keys = ("lin_vel_x", "lin_vel_y", "ang_vel_z")
        found["command"] = _command(*(_Source(ranges, f"{name}: ranges")(key) for key in keys))
    return found


def _unitree_term(called: str, term: Any, name: str) -> dict[str, Any]:
    source = _Source(term if isinstance(term, Mapping) else {}, f"{name}: observations.{called}")
    scale = source.get("scale")
    return _term(
        called,
        scale=1.0 if scale is None else scale,
        clip=source.get("clip"),
        scale_first=bool(source.get("scale_first")),
        history=source.get("history_length") or 1,
        period_s=source.get("params.period"),
    )


def _term(name: str, **values: Any) -> dict[str, Any]:
    """A term with the values that are given; bounds without an end are none."""
    clip = values.get("clip")
    if isinstance(clip, Sequence) and len(clip) == 2 and list(clip) == [-float("inf"), float("inf")]:
        values["clip"] = None
    return {"name": name} | {key: value for key, value in values.items() if value is not None}


def _command(forward: Any, left: Any, turn: Any) -> dict[str, Any]:
    return {"forward_m_s": forward, "left_m_s": left, "turn_rad_s": turn}


def _texts(text: str) -> list[str]:
    return [part.strip() for part in text.split(",") if part.strip()]


def _numbers(text: str, name: str, key: str, separator: str = ",") -> list[float]:
    try:
        return [float(part) for part in text.split(separator)]
    except ValueError:
        raise InputError(f"{name}: {key}: got {text!r}; allowed: numbers with commas") from None


def _one(numbers: list[float] | None) -> Any:
    """The number of a list with one; 1 without a list."""
    return 1.0 if numbers is None else numbers[0] if len(numbers) == 1 else numbers


def _each(text: str | None, count: int, name: str, key: str) -> list[list[float] | None]:
    """Numbers of each of some terms; None for each without the entry."""
    if text is None:
        return [None] * count
    parts = _texts(text)
    if len(parts) != count:
        raise InputError(f"{name}: {key}: got {len(parts)} entries; allowed: {count}, one per term")
    return [_numbers(part, name, key, ";") for part in parts]
