"""`hexctl policy`, and `--policy` of `run` and `drive`, as a user calls them."""

import json
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from hexctl.cli.main import exit_code
from tests.backends.mavlink.boards import board
from tests.cli.conftest import Call
from tests.control.policy import networks
from tests.robots import edited_file


@pytest.fixture
def network(tmp_path: Path) -> str:
    return str(networks.own(tmp_path))


def test_a_policy_walks_and_its_result_has_command_inferences_and_limits(network: str, call: Call) -> None:
    found = call("run --duration 3 --no-record --speed 0.1 --json --policy", network).quiet_json
    assert found["status"] == "ok"
    assert found["policy"]["velocity_body"] == [0.1, 0.0, 0.0]
    assert set(found["policy"]["inference_us"]) == {"p50", "p99", "max"}
    assert found["policy"]["inference_us"]["p50"] > 0
    assert found["options"]["policy"] == network
    text = call("run --duration 3 --no-record --policy", network).out
    assert "own.onnx" in text
    assert "inference" in text


@pytest.mark.slow
def test_a_walk_in_real_time_says_how_long_inferences_took(network: str, call: Call) -> None:
    found = call("run --duration 3 --realtime --no-record --json --policy", network).json
    assert found["policy"]["inferences"] > 80


def test_a_contract_is_shown_against_a_robot_with_what_does_not_match(network: str, call: Call) -> None:
    shown = call("policy show", network, "--json").quiet_json
    assert shown["problems"] == []
    assert [one["term"] for one in shown["terms"]] == [*networks.OWN.terms]
    assert "leg1_femur" in call("policy show", network).out
    other = call("policy show", network, "--robot", "lukas", "--json", code=2).quiet_json
    assert any("base_ang_vel" in problem for problem in other["problems"])
    assert {one["from"] for one in other["terms"] if one["term"] == "joint_vel"} == {
        "differences of angles, 10 ms late"
    }


def test_a_draft_is_written_once_and_filled_in(network: str, call: Call, tmp_path: Path) -> None:
    contract = yaml.safe_load((tmp_path / "own.yaml").read_text())
    assert "exists" in call("policy new", network, code=2).refusal
    (tmp_path / "own.yaml").unlink()
    call("policy new", network)
    refusal = call("policy show", network, code=2).refusal
    assert "control_hz" in refusal
    draft = yaml.safe_load((tmp_path / "own.yaml").read_text())
    filled = {key: contract.get(key) for key in draft}
    networks.write_yaml(tmp_path / "own.yaml", filled)
    call("policy show", network)


def test_a_missing_file_and_gait_options_are_refused_with_the_flag(call: Call, network: str) -> None:
    assert "--policy" in call("run --policy none.onnx", code=2).refusal
    assert "--gait" in call("run --gait wave --policy", network, code=2).refusal
    assert "--policy" in call("run --speed 0.1", code=2).refusal
    assert (
        "--body-raise" in call("drive --body-raise 0.1 --page 127.0.0.1:0 --policy", network, code=2).refusal
    )


def test_a_missing_extra_is_named(call: Call, network: str, monkeypatch: pytest.MonkeyPatch) -> None:
    find = "hexctl.control.policy.onnx_network.find_spec"
    monkeypatch.setattr(find, lambda _name: None)
    assert '"policy" extra' in call("run --policy", network, code=2).refusal


@pytest.mark.slow
def test_help_does_not_load_the_runtime() -> None:
    code = (
        "import sys; sys.argv = ['hexctl', 'policy', '--help']\n"
        "from hexctl.cli.main import exit_code\nexit_code()\n"
        "print([name for name in ('onnxruntime', 'mujoco', 'rerun') if name in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True
    )
    assert done.stdout.splitlines()[-1] == "[]"


@pytest.mark.realtime
@pytest.mark.parametrize("maker", networks.MAKERS.values(), ids=list(networks.MAKERS))
def test_a_network_of_each_exporter_walks_lukas_on_a_simulated_bus(
    maker: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = networks.without_imu(maker(tmp_path, "lukas"))
    for _ in range(3):  # a machine that is too busy for 0.2 s stops a walk
        with board("--bus", "feetech", "--backend", "sim", "--robot", "lukas") as running:
            words = [
                "run --backend feetech --robot lukas --duration 4 --json --no-record --port",
                running.port,
            ]
            exit_code([*words[0].split(), *words[1:], "--policy", str(path)])
            found = json.loads(capsys.readouterr().out)
            running.end()
        if found["status"] == "ok":
            break
    assert found["status"] == "ok"
    assert found["policy"]["inferences"] > 100


@pytest.mark.realtime
def test_a_driven_policy_is_recorded_and_ends_at_a_stand(network: str, tmp_path: Path) -> None:
    words = ["drive", "--page", "127.0.0.1:0", "--no-keyboard", "--policy", network, "--record", "walk.rrd"]
    process = subprocess.Popen(
        [sys.executable, "-m", "hexctl", *words], cwd=tmp_path, stderr=subprocess.PIPE, text=True
    )
    try:
        assert process.stderr is not None
        while "drive on" not in process.stderr.readline():
            assert process.poll() is None
        time.sleep(5)
        process.send_signal(2)
        _, err = process.communicate(timeout=30)
    finally:
        process.kill()
    assert process.returncode == 130, err
    assert "the robot stands" in err


def test_a_check_says_what_looks_wrong_and_nothing_of_a_right_policy(
    network: str, call: Call, tmp_path: Path
) -> None:
    assert call("policy check", network, "--json").quiet_json["findings"] == []
    contract = yaml.safe_load((tmp_path / "own.yaml").read_text())
    networks.write_yaml(tmp_path / "own.yaml", contract | {"action": {"scale": 2.5, "offset_rad": "default"}})
    found = call("policy check", network, code=2).out
    assert "wrong" in found
    assert "scale" in found


def test_a_robot_file_with_an_imu_takes_a_policy_that_needs_one(tmp_path: Path, call: Call) -> None:
    path = networks.own(tmp_path, "lukas")

    def with_imu(content: dict[str, Any]) -> None:
        content["sensors"] = ["joint_positions", "joint_loads", "imu"]

    robot = edited_file(tmp_path, with_imu, base="lukas")
    assert json.loads(call("policy show", str(path), "--robot", str(robot), "--json").out)["problems"] == []
