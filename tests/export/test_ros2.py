"""Launch file and layouts: they name topics, frames and options that exist."""

import importlib.util
import json
import re
import sys
from pathlib import Path
from types import ModuleType
from typing import Any
from unittest.mock import MagicMock

import pytest
import yaml

from hexctl.errors import InputError
from hexctl.export.export import export
from hexctl.options import options_of
from hexctl.robot.configs import find_config
from hexctl.server.ros.topics import TOPICS
from hexctl.server.serve_options import ServeOptions

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


GIVEN = {"robot": "ant", "backend": "sim", "connect": "", "drive": "false", "namespace": ""}


@pytest.mark.parametrize(
    ("given", "environment", "words"),
    [
        ({}, {}, "sim --ros"),
        ({"drive": "true", "namespace": "lab/ant"}, {}, "sim --ros --ros-drive --ros-namespace lab/ant"),
        ({}, {"ROS_DOMAIN_ID": "7", "ROS_DISTRO": "humble"}, "sim --ros --ros-domain 7 --ros-humble"),
        ({"connect": "/dev/ttyUSB0", "backend": "feetech"}, {}, "feetech --ros --connect /dev/ttyUSB0"),
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
