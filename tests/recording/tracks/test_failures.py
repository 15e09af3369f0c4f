"""What a recording shows of failures: when a leg breaks, when the walk notices, and how it looks."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexctl.palette import TEXT_COLOR
from hexctl.recording import paths, style
from hexctl.recording.recording import Recording
from hexctl.runs.run import Run, RunResult, run
from hexctl.runs.run_spec import spec_of
from tests.recording.conftest import ReadBack, Trial, write

BROKEN_S, HEALED_S = 3.0, 6.0


@pytest.fixture(scope="module")
def walked(tmp_path_factory: pytest.TempPathFactory) -> RunResult:
    """A leg goes limp in mid-walk and heals, and the walk recovers both times."""
    failing: dict[str, Any] = {"failure": f"2:limp@{BROKEN_S}", "heal": [f"2@{HEALED_S}"]}
    path = tmp_path_factory.mktemp("failing") / "a.rrd"
    return run(gait="tripod", duration_s=13.0, policy="glide", record=str(path), **failing)


@pytest.fixture(scope="module")
def read(walked: RunResult) -> ReadBack:
    assert walked.recording is not None
    return ReadBack(walked.recording)


def timed(read: ReadBack, path: str, component: str) -> Any:
    """Values with their times in the walk."""
    times = read.times_s(f"/{path}", component, paths.WALK_TIMELINE)
    return list(zip(times.tolist(), read.values(f"/{path}", component), strict=True))


def test_events_have_the_times_of_the_summary(walked: RunResult, read: ReadBack) -> None:
    noticed, healed = walked.trial.noticed
    said = {value[0]: time for time, value in timed(read, paths.EVENTS, "TextLog:text")}
    assert said["world: leg 2 limp"] == pytest.approx(BROKEN_S)
    assert said["world: leg 2 whole again"] == pytest.approx(HEALED_S)
    assert said["noticed: leg 2 limp, by following"] == pytest.approx(noticed.at_s)
    assert said["noticed: leg 2 follows again"] == pytest.approx(healed.at_s)
    assert said[f"policy: {healed.did}"] == pytest.approx(healed.at_s)
    assert said["walk begins"] == 0
    assert all(len(text) < 46 for text in said), "a line of the panel"


def test_the_walk_has_a_time_of_its_own_and_the_trial_keeps_its(read: ReadBack, walked: RunResult) -> None:
    path, component = "/world/robot", "Transform3D:translation"
    trial_s = read.times_s(path, component)
    walk_s = read.times_s(path, component, paths.WALK_TIMELINE)
    began_s = trial_s[walked.log.rows_of("walk").start]
    np.testing.assert_allclose(walk_s, np.maximum(0, trial_s - began_s), atol=1e-9)


def test_lanes_tell_what_is_broken_and_what_was_noticed(walked: RunResult, read: ReadBack) -> None:
    noticed, healed = (one.at_s for one in walked.trial.noticed)
    broken = [(pytest.approx(time), [state]) for time, state in (
        (0, style.WHOLE), (BROKEN_S, "broken: leg 2 limp"), (HEALED_S, style.WHOLE)
    )]  # fmt: skip
    believed = [(pytest.approx(time), [state]) for time, state in (
        (0, style.WATCHING), (noticed, "noticed: leg 2 limp"), (healed, style.WATCHING)
    )]  # fmt: skip
    assert timed(read, paths.BROKEN, "StateChange:state") == broken
    assert timed(read, paths.NOTICED, "StateChange:state") == believed
    states = [state for _, (state,) in (*broken, *believed)]
    assert {*states} <= {*style.LANE_COLORS}, "each has a colour"
    assert style.label_of("broken: leg 2 limp") == "leg 2 limp"


def test_a_leg_is_red_while_it_is_broken_and_marked_while_it_is_noticed(
    walked: RunResult, read: ReadBack
) -> None:
    noticed, healed = (one.at_s for one in walked.trial.noticed)
    whole, failed = (style.packed(colors["tibia"]) for colors in (style.LINK_COLORS, style.FAILED_COLORS))
    colors = timed(read, paths.link_path(2, "tibia"), "Capsules3D:colors")
    assert [(round(time, 6), *color) for time, color in colors] == [
        (0, whole), (BROKEN_S, failed), (HEALED_S, whole)
    ]  # fmt: skip
    assert len(timed(read, paths.link_path(3, "tibia"), "Capsules3D:colors")) == 1
    labels = timed(read, paths.foot_path(2), "Points3D:labels")
    assert [(round(time, 6), label) for time, label in labels] == [(BROKEN_S, ["leg 2 limp"]), (HEALED_S, [])]
    marks = timed(read, paths.noticed_path(2), "Points3D:labels")
    shown = [
        timed(read, paths.label_path(path(2)), "Points3D:labels")
        for path in (paths.foot_path, paths.noticed_path)
    ]
    assert shown == [labels, marks], "labels are those of foot and mark, in the colour of texts"
    texts = read.values(f"/{paths.label_path(paths.noticed_path(2))}", "Points3D:colors")
    assert texts == [[style.packed(TEXT_COLOR)], []]
    assert [(round(time, 6), label) for time, label in marks] == [
        (round(noticed, 6), ["noticed: limp"]), (round(healed, 6), [])
    ]  # fmt: skip


def test_the_evidence_rises_to_an_alarm_when_the_leg_is_noticed(walked: RunResult, read: ReadBack) -> None:
    noticed = walked.trial.noticed[0].at_s
    times, drawn = zip(*timed(read, paths.SUSPICION, "Scalars:scalars"), strict=True)
    evidence, at = np.array(drawn), np.array(times)
    assert evidence.shape[1] == 7
    assert (evidence[:, 6] == 1).all()
    alarm = evidence[np.isclose(at, noticed)]
    assert alarm.size
    assert alarm[0, 1] > 1
    assert evidence[at < BROKEN_S, :6].max() < 1


def test_blocks_give_the_same_tracks_of_failures(walked: RunResult, read: ReadBack, tmp_path: Path) -> None:
    connected = Run(spec_of({"gait": "tripod", "duration_s": 13.0}))
    with Recording(tmp_path / "b.rrd", connected.robot, connected.plan, title="blocks") as recording:
        for start in range(0, len(walked.log), 60):
            recording.write_block(walked.log, start, min(start + 60, len(walked.log)))
    blocks = ReadBack(tmp_path / "b.rrd")
    whole, parts = read.temporal(), blocks.temporal()
    for name in whole:
        if (
            "failures" in name[0]
            or "noticed" in name[0]
            or name[1] in ("Capsules3D:colors", "Points3D:labels")
        ):
            assert parts[name] == whole[name], name


def test_a_walk_that_watches_no_legs_has_no_lane_of_what_it_noticed(trial: Trial, tmp_path: Path) -> None:
    read = ReadBack(write(tmp_path / "a.rrd", trial))
    assert timed(read, paths.BROKEN, "StateChange:state") == [(0, ["broken: leg 5 locked"])]
    assert not timed(read, paths.NOTICED, "StateChange:state")
    assert not timed(read, paths.SUSPICION, "Scalars:scalars")
