"""Each program under examples/ runs, in simulation, and prints what its first line promises."""

import json
import os
import re
import runpy
import shutil
import struct
import subprocess
import sys
import threading
import time
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hexctl.cli.main import exit_code
from tests.identify.test_bench import TRUTH, bench_run, write_run

pytestmark = pytest.mark.slow
EXAMPLES = Path(__file__).parents[1] / "examples"

#: What each program prints.
PRINTED = {
    "walk.py": r"line: TrialResult\(ok.*\nnone: TrialResult\(ok",
    "joint_angles.py": r"(?:\d\.\d\d s: coxa .*, tibia -\d.* degrees\n){4}",
    "own_controller.py": r"TrialResult\(tripod: ok",
    "own_recovery.py": r"walk-on: .*\nglide: .*\nto wave: .*ok",
    "own_optimizer.py": r"gait \d+ ends [\d.]+ cm off its line",
    "export_walk.py": r"\d+ rows in walk\.csv; columns stamp_ns, time_s.*\n0\.\d\d m walked",
    "sweep.py": r"slope\t0 deg.*\ntripod\t.* cm\nripple\t.* cm\nwave\t",
    "gamepad.py": r"walked \d\.\d\d m forward",
    "identify_servos.py": r"stiffness_nm_per_rad: [\d.]+ N m/rad",
    "ros_velocity.py": r"",
    "policy_of_gait.py": r"walk\.onnx and walk\.yaml: a tripod of ant",
}


Printed = Callable[..., str]


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    return tmp_path


@pytest.fixture
def printed(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Printed:
    """What a program prints, called with some words."""

    def of(name: str, *words: str) -> str:
        monkeypatch.setattr(sys, "argv", [name, *words])
        runpy.run_path(str(EXAMPLES / name), run_name="__main__")
        out = capsys.readouterr().out
        assert re.search(PRINTED[name], out), out
        return out

    return of


def test_every_program_is_run_by_a_test() -> None:
    others = {"drive_gym.py", "square.py"}
    assert {path.name for path in EXAMPLES.glob("*.py")} == PRINTED.keys() | others


@pytest.mark.parametrize("name", list(PRINTED)[:7])
def test_a_program_runs(name: str, folder: Path, printed: Printed, monkeypatch: pytest.MonkeyPatch) -> None:
    if name == "own_recovery.py":
        monkeypatch.syspath_prepend(EXAMPLES)
    printed(name)
    assert name != "walk.py" or (folder / "walk.png").stat().st_size > 10_000


def test_servos_are_identified_from_the_log_of_a_bench(folder: Path, printed: Printed) -> None:
    log = write_run(folder / "bench.json", bench_run(1))
    out = printed("identify_servos.py", str(log))
    (dead_time_s,) = re.findall(r"dead_time_s: ([\d.]+) s", out)
    assert float(dead_time_s) == pytest.approx(TRUTH.dead_time_s, abs=0.004)


@pytest.mark.realtime
def test_a_family_of_another_package_conforms_on_its_simulated_bus(folder: Path) -> None:
    source = shutil.copytree(EXAMPLES / "hiwonder", folder / "source")
    pip = ("-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation", "--target", "site")
    subprocess.run([sys.executable, *pip, str(source)], check=True, timeout=120)
    path = os.pathsep.join([str(folder / "site"), str(EXAMPLES.parent)])
    test = (sys.executable, "-m", "pytest", "-q", "-n", "0", "-p", "no:cacheprovider", str(source))
    subprocess.run(test, check=True, timeout=300, env={**os.environ, "PYTHONPATH": path})


def test_a_gamepad_drives_forward(folder: Path, printed: Printed) -> None:
    pad = folder / "event5"
    os.mkfifo(pad)

    def play() -> None:
        with pad.open("wb", buffering=0) as file:
            for kind, code, value in ((1, 310, 1), (3, 1, -32768)):  # shoulder button, stick forward
                file.write(struct.pack("llHHi", 0, 0, kind, code, value))
            time.sleep(5)
            file.write(struct.pack("llHHi", 0, 0, 1, 315, 1))  # start
            time.sleep(0.5)

    player = threading.Thread(target=play)
    player.start()
    out = printed("gamepad.py", str(pad))
    player.join()
    assert float(re.findall(r"walked ([\d.]+)", out)[0]) > 0.05


def test_ros_velocities_end_with_zero(printed: Printed, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whether the robot follows such messages, tests/server/ros/test_bridge.py shows with a peer of ROS."""
    sent: dict[str, list[float]] = {}

    class Twist:
        def __init__(self) -> None:
            self.linear, self.angular = (types.SimpleNamespace(x=0.0, y=0.0, z=0.0) for _ in range(2))

    def create_publisher(_kind: type, topic: str, _depth: int) -> Any:
        speeds = sent.setdefault(topic, [])
        return types.SimpleNamespace(publish=lambda message: speeds.append(message.linear.x))

    node = types.SimpleNamespace(create_publisher=create_publisher, destroy_node=lambda: None)
    rclpy = types.SimpleNamespace(init=lambda: None, create_node=lambda _: node, shutdown=lambda: None)
    monkeypatch.setitem(sys.modules, "rclpy", rclpy)
    monkeypatch.setitem(sys.modules, "geometry_msgs", types.ModuleType("geometry_msgs"))
    monkeypatch.setitem(sys.modules, "geometry_msgs.msg", types.SimpleNamespace(Twist=Twist))
    printed("ros_velocity.py")
    *speeds, last = sent["cmd_vel"]
    assert len(speeds) >= 24
    assert last == 0.0
    assert set(speeds) == {0.1}


def test_a_policy_that_goes_straight_reaches_the_goal_and_again_after_a_reset() -> None:
    example = runpy.run_path(str(EXAMPLES / "drive_gym.py"))
    steps, away_m = example["walk_to_goal"]()
    assert away_m < example["REACHED_M"]
    assert steps < 100
    env = example["GoalEnv"]()
    first, _ = env.reset()
    env.step([1.0, 0.0, 0.0])
    again, _ = env.reset()
    assert (first == again).all()
    env.close()


NOTEBOOKS = sorted(EXAMPLES.glob("*.ipynb"))


@pytest.mark.long
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.name)
def test_a_notebook_runs(path: Path, tmp_path: Path) -> None:
    nbclient: Any = pytest.importorskip("nbclient", reason="notebooks need the dev extra")
    nbformat: Any = pytest.importorskip("nbformat")
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    nbclient.NotebookClient(notebook, timeout=120, resources={"metadata": {"path": str(tmp_path)}}).execute()


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.name)
def test_a_notebook_is_kept_with_its_outputs(path: Path) -> None:
    """Readers see tables and figures without running it; it was run from top to bottom."""
    cells = [cell for cell in json.loads(path.read_text(encoding="utf-8"))["cells"] if "outputs" in cell]
    assert [cell["execution_count"] for cell in cells] == [*range(1, len(cells) + 1)]
    assert all(cell["outputs"] for cell in cells)
    kinds = {output["output_type"] for cell in cells for output in cell["outputs"]}
    assert "error" not in kinds
    assert path.stat().st_size < 300_000


def test_a_distilled_gait_is_a_right_policy(printed: Printed) -> None:
    pytest.importorskip("onnxruntime", reason="only with the extra `policy`")
    pytest.importorskip("onnx", reason="the example needs it")
    printed("policy_of_gait.py")
    assert exit_code(["policy", "check", "walk.onnx"]) == 0
