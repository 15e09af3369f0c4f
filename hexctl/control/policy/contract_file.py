"""hexctl's own contract file: its schema, and the contract that it makes."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, field_validator

from hexctl.control.policy.contract import ALIASES, COMMANDED, WITH_COMMANDED, PolicyContract, Term
from hexctl.errors import InputError
from hexctl.robot.configs import Number, Positive, Section, Whole, validate
from hexctl.typed_names import nearest
from hexctl.types import JOINT_NAMES, N_JOINTS, FloatArray

#: Stands for a value that a draft leaves to be filled in.
UNFILLED = "?"

#: Control rate of hexctl.
CONTROL_HZ = 50.0

#: Longest history: two seconds.
MOST_HISTORY = 100

Finite = Annotated[Number, Field(allow_inf_nan=False)]
Bounds = tuple[Number, Number]
Several = Finite | tuple[Finite, ...]


def _ascending(bounds: tuple[float, float] | None) -> tuple[float, float] | None:
    if bounds is not None and not bounds[0] < bounds[1]:
        raise ValueError(f"got {bounds[0]:g} and {bounds[1]:g}; allowed: a lower and a higher bound")
    return bounds


class TermSection(Section):
    """A term of the observation.

    Attributes:
        name: in the training program.
        kind: what it is, if the name does not say so.
        scale: factor, one or one per number.
        clip: lowest and highest value.
        scale_first: whether it is scaled before it is clipped.
        history: number of values, with the newest.
        joints: of a joint term, in its order; those of the contract unless given.
        offsets_rad: subtracted from relative angles; the default pose unless given.
        period_s: of a gait phase, which is its sine and cosine.
    """

    name: Annotated[str, Field(min_length=1, max_length=80)]
    kind: str | None = None
    scale: Several = 1.0
    clip: Bounds | None = None
    scale_first: bool = False
    history: Annotated[Whole, Field(ge=1, le=MOST_HISTORY)] = 1
    joints: tuple[str, ...] | None = None
    offsets_rad: tuple[Finite, ...] | None = None
    period_s: Positive | None = None

    _clip = field_validator("clip")(_ascending)


class ActionSection(Section):
    """How an action becomes the target of a joint: scale * action + offset.

    Attributes:
        scale: rad per action, one or one per joint.
        offset_rad: target of the action 0: `default` for the default pose, one or one per joint.
        clip: lowest and highest raw action; the clipped one is observed as the last action.
        target_clip_rad: lowest and highest target, one pair or one per joint.
        joints: order of the actions; that of the contract unless given.
    """

    scale: Several
    offset_rad: Several | Literal["default"]
    clip: Bounds | None = None
    target_clip_rad: Bounds | tuple[Bounds, ...] | None = None
    joints: tuple[str, ...] | None = None

    _clip = field_validator("clip")(_ascending)


class CommandSection(Section):
    """Velocities that the policy was trained with, lowest and highest.

    Attributes:
        forward_m_s: forward.
        left_m_s: to the left.
        turn_rad_s: counter-clockwise.
    """

    forward_m_s: tuple[Finite, Finite]
    left_m_s: tuple[Finite, Finite]
    turn_rad_s: tuple[Finite, Finite]

    @field_validator("*")
    @classmethod
    def _in_order(cls, bounds: tuple[float, float]) -> tuple[float, float]:
        if bounds[0] > bounds[1]:
            raise ValueError(f"got {bounds[0]:g} and {bounds[1]:g}; allowed: the lower bound first")
        return bounds


class NormaliserSection(Section):
    """Normaliser outside the network: (observation - mean) / std.

    Attributes:
        mean: one per number of the observation.
        std: one per number of the observation.
    """

    mean: tuple[Finite, ...]
    std: tuple[Positive, ...]


class ContractFile(Section):
    """A contract file, FILE.yaml for a network FILE.onnx.

    Attributes:
        source: another file with the rest: Isaac Lab's IO descriptor, or a deploy.yaml of Unitree.
        control_hz: actions per second.
        joints: names of the joints in the order of the default pose and of terms. A minus before a name of
            hexctl: the joint turns the other way.
        joint_map: hexctl's joints of other names, such as `{lf_hip: leg1_coxa, lf_knee: -leg1_tibia}`.
        motors: hexctl's joints in the order of the motors that Unitree's `joint_ids_map` counts.
        zeros_rad: hexctl's angle at the policy's angle 0, by the name of the joint; 0 unless given.
        default_rad: default pose, in the order of `joints`, as the policy counts angles.
        action: from actions to targets.
        observations: terms in their order.
        terms: keys of terms to add to another program's, by name, such as `{gait_phase: {period_s: 0.8}}`.
        history_order: `by_term` or `by_time`.
        normaliser: `in_graph`, `none`, or mean and std.
        command: ranges; without it a policy gets no command.
        stand_in: what to put in place of a term that the robot does not measure: numbers, or `commanded`.
        input: name of the network's input, if it has several.
        output: name of the network's output, if it has several.
    """

    source: Annotated[str | None, Field(alias="from")] = None
    control_hz: Positive
    joints: tuple[str, ...]
    joint_map: dict[str, str] = Field(default_factory=dict)
    motors: tuple[str, ...] | None = None
    zeros_rad: dict[str, Finite] = Field(default_factory=dict)
    default_rad: tuple[Finite, ...]
    action: ActionSection
    observations: Annotated[tuple[TermSection, ...], Field(min_length=1, max_length=64)]
    terms: dict[str, dict[str, Any]] = Field(default_factory=dict)
    history_order: Literal["by_term", "by_time"] = "by_term"
    normaliser: Literal["in_graph", "none"] | NormaliserSection
    command: CommandSection | None = None
    stand_in: dict[str, tuple[Finite, ...] | Literal["commanded"]] = Field(default_factory=dict)
    input: str | None = None
    output: str | None = None


#: Keys without which there is no contract, with what they say.
REQUIRED = {
    "control_hz": "actions per second, such as 50",
    "joints": "the 18 joints in the policy's order, such as leg1_coxa, or -leg1_coxa if it turns the "
    "other way",
    "default_rad": "the default pose in rad, in the order of joints",
    "action": "scale and offset_rad, such as {scale: 0.25, offset_rad: default}",
    "observations": "the terms in their order, such as [{name: joint_pos}, {name: actions}]",
    "normaliser": "in_graph, none, or {mean: [...], std: [...]}",
}

COMMAND_HINT = (
    "ranges of training, such as {forward_m_s: [-0.1, 0.2], left_m_s: [0, 0], turn_rad_s: [-0.5, 0.5]}"
)


def contract_of(content: Mapping[str, Any], path: Path, origin: str) -> PolicyContract:
    """Contract of the content of files; `path` is the contract file to write missing keys to.

    Raises InputError for the first key that is missing, unfilled or wrong.
    """
    _check_filled(content, path, origin)
    return _Maker(validate(ContractFile, dict(content), path), path).contract(origin)


def unfilled_keys(content: Mapping[str, Any]) -> dict[str, str]:
    """Keys that are missing or unfilled, with what they say."""
    hints = dict(REQUIRED)
    if _commands(content):
        hints["command"] = COMMAND_HINT
    return {key: hint for key, hint in hints.items() if content.get(key, UNFILLED) in (UNFILLED, None)}


def _commands(content: Mapping[str, Any]) -> bool:
    terms = content.get("observations")
    names = [term.get("kind") or term.get("name") for term in terms or () if isinstance(term, Mapping)]
    return any(ALIASES.get(str(name)) == "command" for name in names)


def _check_filled(content: Mapping[str, Any], path: Path, origin: str) -> None:
    for key, hint in unfilled_keys(content).items():
        raise InputError(
            f"policy: {key} is not in {origin}; write it into {path.name}: {hint}; "
            f"hexctl policy new {path.with_suffix('.onnx').name} drafts that file"
        )


class _Maker:
    def __init__(self, file: ContractFile, path: Path) -> None:
        self._file, self._path = file, path

    def contract(self, origin: str) -> PolicyContract:
        file = self._file
        if file.control_hz != CONTROL_HZ:
            raise self._wrong("control_hz", file.control_hz, f"{CONTROL_HZ:g}, the control rate of hexctl")
        base = self._joints(file.joints, "joints")
        default = self._numbers(file.default_rad, N_JOINTS, "default_rad")
        self._check_angles(default, "default_rad")
        own = file.joints if file.action.joints is None else file.action.joints
        joints = base if file.action.joints is None else self._joints(own, "action.joints")
        order = [base.index(joint) for joint in joints]
        offset = file.action.offset_rad
        terms = tuple(self._term(section, default) for section in file.observations)
        self._check_names(terms)
        self._check_history(terms)
        mean, std = self._normaliser(sum(term.width * term.history for term in terms))
        command = file.command
        return PolicyContract(
            joints=joints,
            directions=self._directions(own),
            zeros_rad=self._zeros(own),
            default_rad=default[order],
            action_scale=self._numbers(file.action.scale, N_JOINTS, "action.scale"),
            action_offset_rad=(
                default[order]
                if offset == "default"
                else self._numbers(offset, N_JOINTS, "action.offset_rad")
            ),
            action_clip=self._bounds(file.action.clip, "action.clip"),
            target_clip_rad=self._bounds(file.action.target_clip_rad, "action.target_clip_rad"),
            terms=terms,
            history_by_time=file.history_order == "by_time",
            mean=mean,
            std=std,
            control_hz=file.control_hz,
            command_ranges=(
                None
                if command is None
                else np.array([command.forward_m_s, command.left_m_s, command.turn_rad_s])
            ),
            input=file.input,
            output=file.output,
            origin=origin,
        )

    def _wrong(self, key: str, got: object, allowed: str) -> InputError:
        return InputError(f"{self._path.name}: {key}: got {got}; allowed: {allowed}")

    def _signed(self, name: str, key: str) -> str:
        """Joint of hexctl, with a minus if it turns the other way, of a name in the file."""
        if name in self._file.joint_map:
            signed, key = self._file.joint_map[name], f"joint_map.{name}"
        else:
            signed = name
        if signed.removeprefix("-") not in JOINT_NAMES:
            near = nearest(signed.removeprefix("-"), JOINT_NAMES)
            raise self._wrong(key, signed, f"{', '.join(JOINT_NAMES[:4])} ..., or a name in joint_map{near}")
        return signed

    def _joints(self, names: Sequence[str], key: str) -> tuple[int, ...]:
        if len(names) != N_JOINTS:
            raise self._wrong(key, f"{len(names)} joints", f"{N_JOINTS}, each joint of the robot once")
        joints = tuple(JOINT_NAMES.index(self._signed(name, key).removeprefix("-")) for name in names)
        for place, joint in enumerate(joints):
            if joint in joints[:place]:
                raise self._wrong(key, f"{JOINT_NAMES[joint]} twice", "each joint of the robot once")
        return joints

    def _directions(self, names: Sequence[str]) -> FloatArray:
        return np.array([-1.0 if self._signed(name, "joints").startswith("-") else 1.0 for name in names])

    def _zeros(self, names: Sequence[str]) -> FloatArray:
        zeros = self._file.zeros_rad
        for name in zeros:
            if name not in self._file.joints:
                raise self._wrong("zeros_rad", name, "names of joints, as in joints")
        values = np.array([zeros.get(name, 0.0) for name in names])
        self._check_angles(values, "zeros_rad")
        return values

    def _check_angles(self, angles_rad: FloatArray, key: str) -> None:
        if (most := float(np.abs(angles_rad).max())) > math.tau:
            raise self._wrong(key, f"{most:g}", "angles in rad, not in degrees")

    def _numbers(self, given: float | Sequence[float], count: int, key: str) -> FloatArray:
        values = np.array(given, dtype=float)
        if values.ndim == 1 and len(values) != count:
            raise self._wrong(key, f"{len(values)} numbers", f"{count}")
        return np.broadcast_to(values, (count,)).copy()

    def _bounds(self, given: Any, key: str) -> FloatArray | None:
        if given is None:
            return None
        bounds = np.array(given, dtype=float)
        if bounds.ndim == 2 and len(bounds) != N_JOINTS:
            raise self._wrong(key, f"{len(bounds)} pairs", f"one, or {N_JOINTS}")
        if not (bounds[..., 0] < bounds[..., 1]).all():
            raise self._wrong(key, given, "lower bounds below higher ones")
        return np.broadcast_to(bounds, (N_JOINTS, 2)).copy()

    def _term(self, section: TermSection, default_rad: FloatArray) -> Term:
        key = f"observations: {section.name}"
        kind = ALIASES.get(section.kind or section.name)
        if kind is None:
            raise self._wrong(key, *self._unknown(section.kind or section.name))
        if kind == "gait_phase" and section.period_s is None:
            raise self._wrong(key, "no period_s", "the period of the gait phase in s")
        names = self._file.joints if section.joints is None else section.joints
        if kind == "last_action":
            if section.joints is not None:
                raise self._wrong(f"{key}: joints", "some", "none: actions keep their order")
            names = ()
        about_joints = kind in ("joint_pos_rel", "joint_pos_abs", "joint_vel")
        joints = self._joints(names, f"{key}: joints") if about_joints else ()
        base = self._joints(self._file.joints, "joints")
        offsets = default_rad[[base.index(joint) for joint in joints]]
        term = Term(
            name=section.name,
            kind=kind,
            scale=np.array(1.0),
            history=section.history,
            clip=None if section.clip is None else np.array(section.clip),
            scale_first=section.scale_first,
            joints=joints,
            directions=self._directions(names) if joints else np.empty(0),
            zeros_rad=self._zeros(names) if joints else np.empty(0),
            period_s=section.period_s,
        )
        if section.offsets_rad is not None:
            offsets = self._numbers(section.offsets_rad, term.width, f"{key}: offsets_rad")
        scale = self._numbers(section.scale, term.width, f"{key}: scale")
        return replace(term, scale=scale, offsets_rad=offsets, stand_in=self._stand_in(term))

    def _unknown(self, name: str) -> tuple[str, str]:
        """Why a term is not known, and what is allowed."""
        if name == "joint_pos":
            return name, "kind: joint_pos_rel, less the default pose, or kind: joint_pos_abs"
        kinds = ", ".join(sorted(set(ALIASES.values())))
        return f"{name}, which hexctl does not know", f"another policy, or its kind, one of {kinds}"

    def _stand_in(self, term: Term) -> FloatArray | str | None:
        given = self._file.stand_in.get(term.name)
        key = f"stand_in: {term.name}"
        if isinstance(given, str):
            if term.kind not in WITH_COMMANDED:
                raise self._wrong(key, given, f"{term.width} numbers")
            return COMMANDED
        return None if given is None else self._numbers(given, term.width, key)

    def _check_names(self, terms: Sequence[Term]) -> None:
        names = [term.name for term in terms]
        for name in self._file.stand_in:
            if name not in names:
                raise self._wrong("stand_in", name, f"terms of the observation: {', '.join(names)}")
        for place, name in enumerate(names):
            if name in names[:place]:
                raise self._wrong("observations", f"{name} twice", "each term once")

    def _check_history(self, terms: Sequence[Term]) -> None:
        lengths = sorted({term.history for term in terms})
        if self._file.history_order == "by_time" and len(lengths) > 1:
            raise self._wrong(
                "history_order",
                "by_time with histories of " + ", ".join(map(str, lengths)),
                "one length for all terms, or by_term",
            )

    def _normaliser(self, size: int) -> tuple[FloatArray | None, FloatArray | None]:
        given = self._file.normaliser
        if isinstance(given, str):
            return None, None
        return self._numbers(given.mean, size, "normaliser.mean"), self._numbers(
            given.std, size, "normaliser.std"
        )
