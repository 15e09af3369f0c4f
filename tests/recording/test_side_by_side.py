"""Recordings that are opened together: one scene with all walks, and copies that list the recordings."""

from pathlib import Path

import numpy as np
import pytest

from hexctl.errors import InputError
from hexctl.recording import paths
from hexctl.recording.recorded_trial import read_trial
from hexctl.recording.rrd_reader import check_viewable, rerun_chunks
from hexctl.recording.side_by_side import names_of, write_together
from hexctl.runs.run import run
from tests.recording.conftest import ReadBack, messages
from tests.recording.made_up import arrow_stream, recording_of


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("walks")
    made = [folder / "a walk.rrd", folder / "b.rrd"]
    for path, policy in zip(made, ("walk-on", "glide"), strict=True):
        run(
            gait="tripod",
            failure="5:locked@1",
            policy=policy,
            duration_s=1.5,
            record=path,
        )
    return made


@pytest.fixture(scope="module")
def written(recordings: list[Path], tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    return write_together(recordings, tmp_path_factory.mktemp("together") / "new")


@pytest.mark.slow
def test_all_walks_are_in_one_scene_each_in_a_lane(written: list[Path], recordings: list[Path]) -> None:
    scene = ReadBack(written[0])
    left_m, names = [], []
    for number, recording in enumerate(recordings, start=1):
        trial = read_trial(recording)
        ((place,),) = scene.values(f"/lane{number}", "Transform3D:translation")
        left_m.append(place[1])
        moved = scene.values(f"/lane{number}/{paths.ROBOT}", "Transform3D:translation")
        np.testing.assert_allclose(moved[-1][0][:2], trial.base_position_world[-1, :2], atol=1e-3)
        assert scene.values(f"/lane{number}/{paths.DEVIATION}", "Scalars:scalars")
        (name,) = [one for (one,) in scene.values(f"/lane{number}/{paths.BODY}/name", "Points3D:labels")]
        names.append(name)
    assert len(set(names)) == 2
    assert len(set(names_of([read_trial(recordings[0])] * 2))) == 2
    assert abs(left_m[0] - left_m[1]) > 2 * read_trial(recordings[0]).robot.stance_radius_m
    grounds = [entity for entity in scene.entities if entity.endswith(paths.GROUND)]
    assert grounds == [f"/lane1/{paths.GROUND}"], "two floors in one place would flicker"


def test_the_scene_leads_to_a_copy_of_each_walk(written: list[Path], recordings: list[Path]) -> None:
    scene = ReadBack(written[0])
    for number, (recording, copy) in enumerate(zip(recordings, written[1:], strict=True), start=1):
        ((text,),) = scene.values(f"/lane{number}/{paths.SUMMARY}", "TextDocument:text")
        assert copy.as_uri() in text
        before, after = read_trial(recording), read_trial(copy)
        np.testing.assert_array_equal(before.measured_rad, after.measured_rad)
        assert before.properties == after.properties
        assert before.floor_quaternion.tolist() == after.floor_quaternion.tolist()


@pytest.mark.parametrize("kind", [0, 1, 3])
def test_damage_outside_of_chunks_does_not_end_the_scene(
    kind: int, recordings: list[Path], tmp_path: Path
) -> None:
    """Messages of these kinds hold the index, the store and the layout that is shown."""
    content, damaged = bytearray(recordings[1].read_bytes()), tmp_path / "damaged.rrd"
    start, stop = next(messages(bytes(content), kind))
    content[start:stop] = b"\xff" * (stop - start)
    damaged.write_bytes(content)
    check_viewable(damaged)
    *_, copy = write_together([recordings[0], damaged], tmp_path / "new")
    np.testing.assert_array_equal(read_trial(copy).measured_rad, read_trial(recordings[1]).measured_rad)


def test_a_chunk_that_rerun_refuses_names_the_file(tmp_path: Path) -> None:
    path = tmp_path / "without-rows.rrd"
    path.write_bytes(recording_of(arrow_stream()))
    check_viewable(path)
    with pytest.raises(InputError) as refused:
        list(rerun_chunks(path))
    assert str(path) in str(refused.value)
