"""One call for every export: formats, names, and what is refused."""

import json
import re
from pathlib import Path
from typing import Any

import mujoco
import pytest

import hexctl
from hexctl.adapt.adaptation import adapt
from hexctl.errors import HexctlError, InputError
from hexctl.export.export import ENDINGS, SUFFIXES, export
from hexctl.export.export_options import FORMATS, Format
from hexctl.robot.formats.urdf import urdf_of
from tests.recording.conftest import damage
from tests.robots import edited_file, put, shipped


def test_robots_by_name_by_file_and_from_a_recording(
    recording: Path, tmp_path: Path, monkeypatch: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    assert export("ant", to="urdf") == Path("ant.urdf")
    assert Path("ant.urdf").read_text() == urdf_of(shipped())
    mine = edited_file(tmp_path, put("name", "mine"))
    assert export(mine, output="x.xml") == Path("x.xml")
    mujoco.MjModel.from_xml_path("x.xml")
    export(shipped("pexod"), output="p.urdf", ros2_control=True)
    assert "<ros2_control" in Path("p.urdf").read_text()
    export(recording, output="r.urdf")
    assert Path("r.urdf").read_text() == urdf_of(shipped("phantomx"))


def test_the_name_of_an_output_is_that_of_the_recording(recording: Path, tmp_path: Path) -> None:
    for kind in ("csv", "mcap"):
        path = export(recording, to=kind)
        assert path == recording.with_name(f"walk{ENDINGS.get(kind, f'.{kind}')}")
        assert path.exists()
    path = export(recording, output=tmp_path / "new" / "a.mcap")
    assert path.is_file()
    assert [one.name for one in path.parent.iterdir()] == ["a.mcap"]


def test_several_recordings_make_a_folder_or_a_dataset(recording: Path, tmp_path: Path) -> None:
    told: list[tuple[int, int]] = []
    other = tmp_path / "other.rrd"
    other.write_bytes(recording.read_bytes())
    note = lambda done, total: told.append((done, total))  # noqa: E731
    folder = export(recording, other, to="csv", output=tmp_path / "tables", on_progress=note)
    assert sorted(path.name for path in folder.iterdir()) == ["other.csv", "walk.csv"]
    assert told == [(1, 2), (2, 2)]
    dataset = export(recording, other, to="lerobot", output=tmp_path / "data")
    assert (dataset / "meta/info.json").is_file()
    with pytest.raises(InputError, match="for 2 recordings; allowed: the name of a folder"):
        export(recording, other, output=tmp_path / "x.csv")


@pytest.mark.slow
def test_sessions(tmp_path: Path) -> None:
    result = adapt(robot="ant", failed_leg=5, budget=2, duration_s=1.0, optimizer="random", folder=tmp_path)
    name = result.session.name
    table = export(name, output=tmp_path / "s.csv", folder=tmp_path)
    assert len(table.read_text().splitlines()) == 3
    bags = export(name, to="mcap", output=tmp_path / "bags", folder=tmp_path)
    assert len(list(bags.rglob("*.mcap"))) == len(list(bags.iterdir())) == 2


@pytest.fixture(scope="module")
def session(tmp_path_factory: Any) -> tuple[str, Path]:
    """A session of four trials in a folder: the first recording is damaged, the third missing."""
    folder = tmp_path_factory.mktemp("runs")
    done = adapt(robot="ant", failed_leg=5, budget=4, duration_s=1.0, optimizer="random", folder=folder)
    first, _, third, _ = (Path(str(trial.recording)) for trial in done.session.trials)
    damage(first).replace(first)
    third.unlink()
    return done.session.name, folder


@pytest.mark.parametrize("kind", ["mcap", "lerobot"])
def test_a_session_is_exported_without_what_it_has_lost(
    kind: Format, session: tuple[str, Path], tmp_path: Path
) -> None:
    name, folder = session
    told: list[InputError] = []
    path = export(name, to=kind, output=tmp_path / "out", folder=folder, on_damage=told.append)
    assert [one.split("/")[-1].split(",")[0].split(";")[0] for one in map(str, told)] == [
        "trial-001.rrd is damaged",
        "trial-003.rrd is not there",
    ]
    if kind == "mcap":
        assert sorted(one.name for one in path.iterdir()) == ["trial-002", "trial-004"]
    else:
        assert json.loads((path / "meta/info.json").read_text())["total_episodes"] == 2
    assert list(tmp_path.iterdir()) == [path]


def test_what_a_session_has_lost_is_logged_where_nobody_asks(
    session: tuple[str, Path], tmp_path: Path, caplog: Any
) -> None:
    name, folder = session
    export(name, to="mcap", output=tmp_path / "bags", folder=folder)
    assert [record.levelname for record in caplog.records] == ["WARNING", "WARNING"]
    assert "trial-001.rrd is damaged" in caplog.text


def test_a_recording_that_is_given_itself_is_never_left_out(
    recording: Path, session: tuple[str, Path], tmp_path: Path
) -> None:
    name, folder = session
    told: list[InputError] = []
    with pytest.raises(InputError, match=r"missing\.rrd is not there"):
        export(
            name,
            "missing.rrd",
            recording,
            to="mcap",
            output=tmp_path / "bags",
            folder=folder,
            on_damage=told.append,
        )
    assert not list(tmp_path.iterdir())


def test_a_session_that_has_lost_everything_is_refused(tmp_path: Path) -> None:
    runs, told = tmp_path / "runs", list[InputError]()
    done = adapt(robot="ant", failed_leg=5, budget=2, duration_s=1.0, optimizer="random", folder=runs)
    for trial in done.session.trials:
        Path(str(trial.recording)).write_bytes(b"RRF2")
    for kind in ("mcap", "lerobot", "gif"):
        with pytest.raises(InputError, match="none of 2 recordings can be read"):
            export(done.session.name, to=kind, output=tmp_path / kind, folder=runs, on_damage=told.append)
    assert len(told) == 6
    assert list(tmp_path.iterdir()) == [runs]


def test_what_is_refused_is_told_in_one_line_and_leaves_nothing(
    recording: Path, tmp_path: Path, monkeypatch: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "there.csv").write_text("mine")
    (tmp_path / "file").write_text("mine")
    cases: list[tuple[tuple[Any, ...], dict[str, Any], str]] = [
        ((), {"to": "csv"}, "got nothing"),
        ((recording,), {}, "to: got none"),
        ((recording,), {"to": "xlsx"}, "to: got xlsx; allowed: urdf"),
        ((recording,), {"to": "gif", "output": "a.csv"}, "output: got a.csv for gif"),
        ((recording,), {"output": "there.csv"}, "there.csv exists"),
        ((recording,), {"output": "file/a.csv"}, "cannot be written"),
        ((recording,), {"to": "csv", "output": "a.csv", "camera": "top"}, "camera: got it for csv"),
        ((recording,), {"output": "a.csv", "ros2_control": True}, "ros2_control: got it for csv"),
        (("ant",), {"to": "urdf", "robot": shipped("pexod")}, "robot: got it for urdf; allowed: for"),
        (
            ("s",),
            {"output": "s.csv", "robot": shipped("pexod")},
            "robot: got it for csv; allowed: for",
        ),
        (("ant",), {"to": "csv"}, "got the robot ant for csv; allowed: urdf, mjcf"),
        (("robot.yaml",), {"to": "gif"}, "got the robot robot.yaml for gif"),
        (("ant", "pexod"), {"to": "urdf"}, "got 2 robots"),
        (("nothing",), {"to": "csv"}, "session: got 'nothing'"),
        (("missing.rrd",), {"to": "csv"}, "missing.rrd is not there"),
        (("missing.rrd",), {"to": "gif"}, "missing.rrd is not there"),
    ]
    for sources, options, told in cases:
        with pytest.raises(InputError, match=re.escape(told)) as refused:
            export(*sources, **options)
        assert "\n" not in str(refused.value)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "there.csv"]
    assert (tmp_path / "there.csv").read_text() == "mine"


def test_an_export_that_fails_leaves_no_part(recording: Path, tmp_path: Path, monkeypatch: Any) -> None:
    def full(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("hexctl.export.mcap._write_bag", full)
    with pytest.raises(HexctlError, match="No space left on device"):
        export(recording, output=tmp_path / "a.mcap")
    assert not list(tmp_path.iterdir())


def test_every_format_is_known_by_its_ending_or_is_a_folder() -> None:
    assert set(SUFFIXES.values()) | {"lerobot"} == set(FORMATS)


def test_it_is_public(recording: Path, tmp_path: Path) -> None:
    assert hexctl.export(recording, output=tmp_path / "a.csv").is_file()
