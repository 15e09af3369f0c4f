"""Drafts of contract files: what a network and its files say, and a question mark for what they do not."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hexctl.control.policy.contract_file import COMMAND_HINT, UNFILLED, unfilled_keys
from hexctl.control.policy.onnx_network import OnnxFile
from hexctl.control.policy.policy import contract_content, contract_file
from hexctl.errors import InputError


def draft_of(file: OnnxFile) -> str:
    """Text of a contract file for a network, to be filled in; keys that its other files have are left out."""
    beside = contract_file(file.path)
    own = file.path.with_suffix(".yaml")
    lines = [f"# Contract of {file.path.name}: fill in each {UNFILLED}, then hexctl policy show {file.path}"]
    lines += [f"# input {name}: {kind} {shape}" for name, (kind, shape) in file.inputs.items()]
    lines += [f"# output {name}: {kind} {shape}" for name, (kind, shape) in file.outputs.items()]
    content: Mapping[str, Any] = {}
    if beside is not None and beside != own:
        lines.append(f"from: {beside.name}")
    try:
        content = contract_content(file)[0]
    except InputError as error:
        lines.append(f"# {error}")
        if "motors" in str(error):
            lines += _line("motors", "the joints in the order of the motors, such as [leg1_coxa, ...]")
            return "\n".join(lines) + "\n"
    if beside is not None and beside == own:
        raise InputError(f"policy: {own} exists; allowed: a network without a file of its name")
    for key, hint in unfilled_keys(content).items():
        lines += _line(key, hint)
    if not content:
        lines += _line("command", f"{COMMAND_HINT}; leave it out without a command")
        lines.append("# stand_in: {}  # what to put in place of a term that the robot does not measure")
    terms = [term for term in content.get("observations", ()) if isinstance(term, Mapping)]
    if phases := [term["name"] for term in terms if "phase" in str(term["name"]) and "period_s" not in term]:
        lines.append(
            f"terms: {{{phases[0]}: {{period_s: {json.dumps(UNFILLED)}}}}}  # period of the phase in s"
        )
    return "\n".join(lines) + "\n"


def _line(key: str, hint: str) -> list[str]:
    return [f"# {key}: {hint}", f"{key}: {json.dumps(UNFILLED)}"]


def draft_path(path: Path) -> Path:
    """File of the draft for a network."""
    return path.with_suffix(".yaml")
