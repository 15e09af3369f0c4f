"""Tracks of failures: broken legs, suspected and detected ones, and their appearance."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from hexctl.control.log import LegChange
from hexctl.palette import FAILED_COLORS, LINK_COLORS, TEXT_COLOR
from hexctl.recording import paths, style
from hexctl.recording.rrd import load_rerun
from hexctl.recording.series import SUSPICION
from hexctl.recording.tracks.block import Block
from hexctl.robot.failure import Failure, in_words, in_words_with_share
from hexctl.robot.meshes import PartMesh
from hexctl.types import JOINT_KINDS

#: Radius of the mark at a leg with a detected failure, in radii of its coxa.
MARK_SIZE = 1.8


def send_suspicion(block: Block) -> None:
    """Send the evidence against each leg and the alarm level at some ticks, and at every tick above it."""
    ratio = block.column("leg_suspicion")  # (rows, 6)
    due = (ratio > 1.0).any(axis=-1)
    due[block.sparse()] = True
    rows = np.flatnonzero(due & np.isfinite(ratio).any(axis=-1))
    block.plot(SUSPICION, rows, np.column_stack([ratio[rows], np.ones(rows.size)]))


def send_lanes(block: Block) -> None:
    """Send broken legs, if known, and legs that the walk considers broken."""
    for by, path, state in (
        ("world", paths.BROKEN, style.broken_state),
        ("belief", paths.NOTICED, style.noticed_state),
    ):
        changes = [change for change in block.leg_changes() if change.by == by]
        if changes:
            states = [state(_short(change.failures)) for change in changes]
            _send_states(block, path, [_since(change) for change in changes], states)


def _send_states(block: Block, path: str, log_rows: Sequence[int], states: Sequence[str]) -> None:
    block.send_at(path, log_rows, load_rerun().StateChange.columns(state=list(states)))


def _since(change: LegChange) -> int:
    """The world changes a leg before the tick that shows it."""
    return max(0, change.row - 1) if change.by == "world" else change.row


def _short(failures: Sequence[Failure]) -> str:
    """Failed legs in a few words: `leg 5 limp`, `legs 2, 5`, or nothing."""
    if len(failures) == 1:
        return f"leg {failures[0].leg} {in_words(failures[0])}"
    return f"legs {', '.join(str(one.leg) for one in failures)}" if failures else ""


def failure_lines(block: Block) -> Iterator[tuple[int, str]]:
    """Rows of the log at which the world let legs fail or heal, with a line each."""
    for change in block.leg_changes():
        if change.by == "world":
            # An announced failure is not reported when it begins.
            told = [one for one in block.subject.plan.failures if one.leg in _by_leg(change.failures)]
            before = told if change.row == 0 else change.before
            for text in _differences(_by_leg(before), _by_leg(change.failures)):
                yield _since(change), f"world: {text}"


def _differences(before: Mapping[int, Failure], now: Mapping[int, Failure]) -> Iterator[str]:
    for leg in sorted({*before, *now}):
        if leg not in now:
            yield f"leg {leg} whole again"
        elif now[leg] != before.get(leg):
            yield f"leg {leg} {in_words_with_share(now[leg])}"


def send_looks(block: Block, leg: int) -> None:
    """Send the colours of a leg, red from its failure on, and the mark at its hip after a detection."""
    told = _by_leg(block.subject.plan.failures).get(leg)
    if block.start == 0:
        beginning = [change for change in block.leg_changes() if _from_the_beginning(change)]
        _send_look(block, 0, leg, _by_leg(beginning[0].failures).get(leg, told) if beginning else told)
    for change in block.leg_changes():
        now = _by_leg(change.failures).get(leg)
        if _by_leg(change.before).get(leg) == now or _from_the_beginning(change):
            continue
        if change.by == "belief":
            _send_mark(block, change.row, leg, None if now == told else now)
        else:
            _send_look(block, _since(change), leg, now)


def _from_the_beginning(change: LegChange) -> bool:
    return change.by == "world" and change.row == 0


def _by_leg(failures: Sequence[Failure]) -> dict[int, Failure]:
    return {one.leg: one for one in failures}


def _send_look(block: Block, row: int, leg: int, failure: Failure | None) -> None:
    for kind in JOINT_KINDS:
        columns = _link_columns(failure, kind, block.subject.mesh_of(leg, kind))
        block.send_at(paths.link_path(leg, kind), [row], columns)
    labels = [] if failure is None else [f"leg {leg} {failure if row == 0 else in_words(failure)}"]
    if labels or row:
        columns = load_rerun().Points3D.columns(labels=labels).partition([len(labels)])
        for path in (paths.foot_path(leg), paths.label_path(paths.foot_path(leg))):
            block.send_at(path, [row], columns)


def _link_columns(failure: Failure | None, kind: str, mesh: PartMesh | None) -> Any:
    """Colour of a link; a solid of a missing leg is an outline, which a mesh lacks."""
    rr = load_rerun()
    color = style.packed((FAILED_COLORS if failure else LINK_COLORS)[kind])
    missing = failure is not None and failure.kind == "missing"
    if mesh is not None:
        # White leaves the colours of the file as they are.
        own = mesh.coloured and failure is None
        return rr.Asset3D.columns(albedo_factor=[style.packed(style.WHITE) if own else color])
    return rr.Capsules3D.columns(colors=[color], fill_mode=["majorwireframe" if missing else "solid"])


def _send_mark(block: Block, row: int, leg: int, failure: Failure | None) -> None:
    labels = [] if failure is None else [f"noticed: {in_words(failure)}"]
    coxa_m = block.subject.robot.link_radii_m[0]
    for path, radius, color, shown in (
        (paths.noticed_path(leg), MARK_SIZE * coxa_m, style.NOTICED_COLOR, False),
        (paths.label_path(paths.noticed_path(leg)), 0.0, TEXT_COLOR, True),
    ):
        count = len(labels)
        columns = load_rerun().Points3D.columns(
            positions=np.zeros((count, 3)),
            labels=labels,
            radii=count * [radius],
            colors=count * [style.packed(color)],
            show_labels=count * [shown],
        )
        block.send_at(path, [row], columns.partition([count]))
