"""One call for every export: formats, names, sessions, and what is refused."""

import importlib.util
import json
import re
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any
from unittest.mock import MagicMock

import pyarrow.parquet as pq
import pytest
import yaml

import hexctl
from hexctl.errors import HexctlError, InputError
from hexctl.export.export import ENDINGS, export
from hexctl.export.export_options import Format
from hexctl.export.recordings import title_of
from hexctl.options import options_of
from hexctl.recording.recorded_trial import RecordedTrial
from hexctl.robot.configs import find_config
from hexctl.robot.formats.urdf import urdf_of
from hexctl.server.ros.topics import TOPICS
from hexctl.server.serve_options import ServeOptions
from tests.export.conftest import session_in
from tests.recording.made_up import damaged_recordings
from tests.robots import edited_file, put, shipped


def test_robots_by_name_by_file_and_from_a_recording(
    recording: Path, tmp_path: Path, monkeypatch: Any
) -> None:
    import mujoco

    monkeypatch.chdir(tmp_path)
    assert export("ant", to="urdf") == Path("ant.urdf")
    assert Path("ant.urdf").read_text() == urdf_of(shipped())
    mine = edited_file(tmp_path, put("name", "mine"))
    assert export(mine, output="x.xml") == Path("x.xml")
    mujoco.MjModel.from_xml_path("x.xml")
    export(shipped("pexod"), output="p.urdf", ros2_control=True)
    assert "<ros2_control" in Path("p.urdf").read_text()
    hexctl.export(recording, output="r.urdf")
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
    twice = export(recording, other, other, to="csv", output=tmp_path / "twice")
    assert sorted(path.name for path in twice.iterdir()) == ["other-2.csv", "other.csv", "walk.csv"]
    dataset = export(recording, other, to="lerobot", output=tmp_path / "data")
    assert (dataset / "meta/info.json").is_file()
    with pytest.raises(InputError, match=r"x\.csv"):
        export(recording, other, output=tmp_path / "x.csv")


def test_an_export_that_fails_leaves_no_part(recording: Path, tmp_path: Path, monkeypatch: Any) -> None:
    def full(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("hexctl.export.mcap._write_bag", full)
    with pytest.raises(HexctlError, match="No space left on device"):
        export(recording, output=tmp_path / "a.mcap")
    assert not list(tmp_path.iterdir())


def test_a_title_names_all_legs_that_the_walk_was_told_of(walk: RecordedTrial) -> None:
    told = walk.properties | {"further_failures": json.dumps({"2": "limp", "4": "missing"})}
    assert (
        title_of(replace(walk, properties=told)) == "phantomx tripod, leg 5 locked, leg 2 limp, leg 4 missing"
    )
    assert title_of(replace(walk, properties={"title": "phantomx tripod"})) == "phantomx tripod"
    assert title_of(replace(walk, properties={})) == "phantomx"


@pytest.fixture
def damaged(recording: Path, tmp_path: Path) -> tuple[str, Path]:
    """A session of four trials: the first recording is damaged, the third missing."""
    name, kept = session_in(tmp_path / "runs", recording, (0.1, 0.2, 0.3, 0.4))
    (kept / "trial-001.rrd").unlink()
    (kept / "trial-001.rrd").write_bytes(damaged_recordings()[0])
    (kept / "trial-003.rrd").unlink()
    return name, tmp_path / "runs"


@pytest.mark.parametrize("kind", ["mcap", "lerobot"])
def test_a_session_is_exported_without_what_it_has_lost(
    kind: Format, damaged: tuple[str, Path], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    name, folder = damaged
    lost: list[HexctlError] = []
    path = export(name, to=kind, output=tmp_path / "out", folder=folder, on_damage=lost.append)
    assert [re.findall(r"trial-\d+", str(one))[0] for one in lost] == ["trial-001", "trial-003"]
    if kind == "mcap":
        assert sorted(one.name for one in path.iterdir()) == ["trial-002", "trial-004"]
        export(name, to=kind, output=tmp_path / "logged", folder=folder)
        assert [record.levelname for record in caplog.records] == ["WARNING", "WARNING"]
    else:
        assert json.loads((path / "meta/info.json").read_text())["total_episodes"] == 2


def test_a_session_becomes_a_table_of_its_trials(recording: Path, tmp_path: Path) -> None:
    name, _ = session_in(tmp_path / "runs", recording, (0.1, 0.2))
    table = export(name, output=tmp_path / "s.csv", folder=tmp_path / "runs")
    assert len(table.read_text().splitlines()) == 3


def test_types_of_a_table_of_trials_do_not_depend_on_what_they_lack(recording: Path, tmp_path: Path) -> None:
    name, _ = session_in(tmp_path / "runs", recording, (0.1, 0.2))
    found = pq.read_table(export(name, output=tmp_path / "s.parquet", folder=tmp_path / "runs"))
    kinds = {one.name: str(one.type) for one in found.schema}
    lacking = {one for one in kinds if found[one].null_count == found.num_rows}
    assert {"stopped", "cause", "trim_deg", "expected_chance"} <= lacking
    for one in lacking:
        text = one in ("stopped", "hold", "cause", "recording", "world") or one.endswith("_status")
        assert kinds[one] == ("string" if text else "double"), one


def test_a_recording_that_is_given_itself_is_never_left_out_nor_a_session_that_has_lost_everything(
    recording: Path, damaged: tuple[str, Path], tmp_path: Path
) -> None:
    name, folder = damaged
    with pytest.raises(InputError, match=r"missing\.rrd"):
        export(name, "missing.rrd", recording, to="mcap", output=tmp_path / "bags", folder=folder)
    for path in folder.rglob("*.rrd"):
        path.unlink()
        path.write_bytes(b"RRF2")
    for kind in ("mcap", "lerobot", "gif"):
        with pytest.raises(InputError, match="recordings"):
            export(name, to=kind, output=tmp_path / kind, folder=folder)
    assert list(tmp_path.iterdir()) == [folder]


@pytest.mark.parametrize(
    ("sources", "options", "named"),
    [
        ((), {"to": "csv"}, "^export: got nothing"),
        (("RECORDING",), {}, "^to: got none"),
        (("RECORDING",), {"to": "xlsx"}, "^to: got xlsx"),
        (("RECORDING",), {"to": "gif", "output": "a.csv"}, "^output: got a.csv for gif"),
        (("ant",), {"to": "mjcf", "output": "a.urdf"}, r"such as \.xml$"),
        (("RECORDING",), {"output": "there.csv"}, "^output: there.csv exists"),
        (("RECORDING",), {"output": "file/a.csv"}, "^output: file/a.csv cannot be written"),
        (("RECORDING",), {"to": "csv", "output": "a.csv", "camera": "top"}, "^camera: got the format csv"),
        (("RECORDING",), {"output": "a.csv", "ros2_control": True}, "^ros2_control: got the format csv"),
        (("ant",), {"to": "urdf", "robot": shipped("pexod")}, "^robot: got no recording for urdf"),
        (("s",), {"output": "s.csv", "robot": shipped("pexod")}, "^robot: got no recording for csv"),
        (("ant",), {"to": "csv"}, "^export: got the robot ant for csv"),
        (("robot.yaml",), {"to": "gif"}, "^export: got the robot robot.yaml for gif"),
        (("ant", "pexod"), {"to": "urdf"}, "^export: got 2 robots"),
        (("nothing",), {"to": "csv"}, "session"),
        (("missing.rrd",), {"to": "csv"}, "missing.rrd"),
        (("missing.rrd",), {"to": "gif"}, "missing.rrd"),
    ],
)
def test_what_is_refused_is_told_in_one_line_and_leaves_nothing(
    sources: Sequence[str],
    options: dict[str, Any],
    named: str,
    recording: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("hexctl.export.export.check_new", lambda *_: None)  # as if written meanwhile
    (tmp_path / "there.csv").write_text("mine")
    (tmp_path / "file").write_text("mine")
    given = [recording if source == "RECORDING" else source for source in sources]
    with pytest.raises(InputError, match=named) as refused:
        export(*given, **options)
    assert "\n" not in str(refused.value)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "there.csv"]
    assert (tmp_path / "there.csv").read_text() == "mine"


#: Topics of the bridge, of driving, and of Nav2.
KNOWN = {f"/{name.lstrip('/')}" for name in TOPICS} | {"/cmd_vel", "/goal_pose"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path: Path = export("ant", to="ros2", output=tmp_path_factory.mktemp("ros") / "ant")
    return path


@pytest.fixture
def launch_file(folder: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The launch file as a module; ROS's own packages are not here, and record what they are given."""
    for name in ("launch", "launch.actions", "launch.substitutions", "launch_ros", "launch_ros.actions"):
        monkeypatch.setitem(sys.modules, name, MagicMock())
    spec = importlib.util.spec_from_file_location("launched", folder / "robot.launch.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_folder_has_all_files_and_replaces_nothing(folder: Path) -> None:
    assert {one.name for one in folder.iterdir()} == {
        "robot.launch.py",
        "robot.rviz",
        "foxglove.json",
        "ant.urdf",
    }
    with pytest.raises(InputError, match="exists"):
        export("ant", to="ros2", output=folder)


@pytest.mark.parametrize("name", ["pexod", "my robot.yaml"])
def test_the_launch_file_starts_the_exported_robot(name: str, tmp_path: Path) -> None:
    source: Path | str = name
    if "." in name:
        source = tmp_path / name
        source.write_text(find_config("robots", "lukas").read_text(encoding="utf-8"), encoding="utf-8")
    path = export(source, to="ros2", output=tmp_path / "out")
    text = (Path(path) / "robot.launch.py").read_text(encoding="utf-8")
    assert f'"robot": ("{source}", "name of' in text


def test_rviz_shows_topics_and_frames_that_are_published(folder: Path) -> None:
    layout = yaml.safe_load((folder / "robot.rviz").read_text(encoding="utf-8"))["Visualization Manager"]
    assert layout["Global Options"]["Fixed Frame"] == "odom"
    topics = re.findall(r"Value: (/\S+)", (folder / "robot.rviz").read_text(encoding="utf-8"))
    assert set(topics) <= KNOWN
    (model,) = [one for one in layout["Displays"] if one["Name"] == "RobotModel"]
    assert model["Description Topic"]["Durability Policy"] == "Transient Local", "it is latched"


def test_foxglove_has_a_place_for_every_panel_and_knows_the_topics(folder: Path) -> None:
    layout = json.loads((folder / "foxglove.json").read_text(encoding="utf-8"))

    def panels(node: Any) -> set[str]:
        return {node} if isinstance(node, str) else panels(node["first"]) | panels(node["second"])

    assert panels(layout["layout"]) == set(layout["configById"])
    text = json.dumps(layout)
    topics = {found.partition(".")[0] for found in re.findall(r'"(/[\w./]+)', text)}
    assert topics <= KNOWN
    assert {"/robot_description", "/diagnostics"} <= topics


GIVEN = {"robot": "ant", "backend": "sim", "port": "", "drive": "false", "namespace": ""}


@pytest.mark.parametrize(
    ("given", "environment", "words"),
    [
        ({}, {}, "sim --ros"),
        ({"drive": "true", "namespace": "lab/ant"}, {}, "sim --ros --ros-drive --ros-namespace lab/ant"),
        ({}, {"ROS_DOMAIN_ID": "7", "ROS_DISTRO": "humble"}, "sim --ros --ros-domain 7 --ros-humble"),
        ({"port": "/dev/ttyUSB0", "backend": "feetech"}, {}, "feetech --ros --port /dev/ttyUSB0"),
    ],
)
def test_the_launch_file_starts_a_robot_with_options_that_exist(
    launch_file: ModuleType, given: dict[str, str], environment: dict[str, str], words: str
) -> None:
    command = launch_file.serve_command(GIVEN | given, environment)
    assert command == f"hexctl serve --robot ant --backend {words}".split()
    flags = {f"--{one.flag}" for one in options_of(ServeOptions)}
    assert {word for word in command if word.startswith("--")} <= flags


def test_the_launch_file_starts_what_is_asked_for(
    launch_file: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    nodes, process = launch_file.Node, launch_file.ExecuteProcess
    asked = GIVEN | {"router": "true", "rviz": "true", "foxglove": "true"}
    assert set(launch_file.ARGUMENTS) == set(asked)
    monkeypatch.setattr(
        launch_file, "LaunchConfiguration", lambda name: MagicMock(perform=lambda _: asked[name])
    )
    assert len(launch_file._started(None)) == 4
    packages = [call.kwargs["package"] for call in nodes.call_args_list]
    assert packages == ["rmw_zenoh_cpp", "rviz2", "foxglove_bridge"]
    assert process.call_args.kwargs["cmd"][:2] == ["hexctl", "serve"]
    launch_file.generate_launch_description()
