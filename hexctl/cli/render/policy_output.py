"""The contract of a policy, and its check, as text and tables."""

import shlex
from pathlib import Path
from typing import Any

from rich.console import RenderableType

from hexctl.cli.render.tables import label_table, row_table
from hexctl.runs.policy_check import PolicyCheck


def contract_parts(found: dict[str, Any]) -> list[RenderableType]:
    """Contract of a policy (`hexctl policy show --json`) as tables, then its problems."""
    command = found["command"]
    ranges = (
        "none"
        if command is None
        else ", ".join(f"{name} {low:g} to {high:g}" for name, (low, high) in command.items())
    )
    rows = [
        ("policy", f"{found['policy']}, with the contract of {found['contract']}"),
        ("rate", f"{found['rate_hz']:g} Hz"),
        ("command", ranges),
        ("observes", f"{found['observation_size']} numbers, joined {found['history_order']}"),
        ("normaliser", found["normaliser"]),
    ]
    return [
        label_table(rows),
        "",
        row_table(found["joints"]),
        "",
        row_table(found["terms"]),
        "",
        *(_problems(found["problems"]) or [f"it fits {found['robot']}; next: hexctl policy check FILE"]),
    ]


def check_parts(found: PolicyCheck, file: Path) -> list[RenderableType]:
    """Findings of a check, and the next command."""
    name, outcome = shlex.quote(str(file)), found.outcome
    parts: list[RenderableType] = []
    if outcome is not None:
        walked = (
            outcome["true_distance_m"] if outcome["true_distance_m"] is not None else outcome["distance_m"]
        )
        way = "" if walked is None else f", {walked:.2f} m"
        parts = [f"{outcome['robot']} walked {outcome['duration_s']:g} s{way}: {outcome['status']}"]
    if found.findings:
        return [*parts, *_problems(list(found.findings)), f"next: hexctl policy show {name}"]
    return [*parts, "nothing looks wrong", f"next: hexctl run --policy {name}"]


def _problems(texts: list[str]) -> list[RenderableType]:
    return [label_table([("wrong", text) for text in texts])] if texts else []
