"""`hexctl calibrate` with a board that is wired and mounted otherwise than the file says.

The person beside the robot is played by a program that sees the true angles, as the board has them, and
answers the questions that are asked on stderr.
"""

import os
import re
import select
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Self

import numpy as np
import pytest

from hexctl.cli.main import exit_code
from hexctl.robot.loader import load_robot_file
from hexctl.robot.servos.servo_map import ServoMap
from hexctl.types import JOINT_NAMES, FloatArray
from tests.backends.mavlink.boards import PATIENCE_S, BoardProcess, board, fitting_file
from tests.backends.mavlink.clients import Client
from tests.robots import edited_file, put

pytestmark = pytest.mark.realtime

#: How the robot is really wired: one servo turned round and mounted off, one only mounted off.
TRUE_WIRING = {
    "leg1_coxa": {"sign": -1, "offset_deg": 12},
    "leg2_tibia": {"sign": -1, "offset_deg": -84},
}


class Person:
    """Sits beside the robot, sees its legs, and types.

    Attributes:
        screen: everything that was asked and said.
        seen_deg: the true joint angles that were seen at each prompt, each (18,).
    """

    def __init__(self, running: BoardProcess, wiring: ServoMap, file: Path, *options: str) -> None:
        self._eyes = Client(running.port, system=254)
        self._wiring = wiring
        self.screen = ""
        self.seen_deg: list[FloatArray] = []
        self.process = subprocess.Popen(
            [sys.executable, "-m", "hexctl", "calibrate", str(file), "--connect", running.port, *options],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env={**os.environ, "MUJOCO_GL": "disable"},
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._eyes.__exit__(None, None, None)
        if self.process.poll() is None:
            self.process.kill()
        self.process.communicate()

    def look(self) -> FloatArray:
        """The true joint angles in degrees, (18,)."""
        self._eyes.hail()
        self.seen_deg.append(np.degrees(self._wiring.to_rad(self._eyes.outputs().pulses_us)))
        return self.seen_deg[-1]

    def reads(self, pattern: str) -> str:
        """Wait for a prompt on the screen and return what is new on it up to there."""
        assert self.process.stderr is not None
        until_s, begin = time.monotonic() + PATIENCE_S, len(self.screen)
        while not re.search(pattern, self.screen[begin:]):
            assert time.monotonic() < until_s, self.screen
            if select.select([self.process.stderr], [], [], 0.1)[0]:
                data = os.read(self.process.stderr.fileno(), 4096).decode()
                assert data, self.screen
                self.screen += data
        # The last step of a movement is on its way when its prompt is read.
        time.sleep(0.2)
        return self.screen[begin:]

    def types(self, answer: str) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(f"{answer}\n".encode())
        self.process.stdin.flush()

    def ends(self) -> str:
        """Wait for the end and return what was said last."""
        _, err = self.process.communicate(timeout=PATIENCE_S)
        self.screen += err.decode()
        return self.screen.splitlines()[-1]

    def begins(self) -> None:
        """Hold the robot up."""
        self.reads(r"to their places: ")
        self.types("")

    def judges_sign(self, joint: int) -> None:
        """Watch the joint, and answer whether it moved as asked."""
        self.reads(r"move it, skip: ")
        before_deg = self.look()[joint]
        self.types("")
        asked = self.reads(r"again, skip: ")
        rose = self.look()[joint] > before_deg
        wants_rise = " counter-clockwise" in asked or " up" in asked
        self.types("yes" if rose == wants_rise else "no")

    def trims(self, joint: int) -> None:
        """Turn the joint to the angle that is asked for."""
        asked = self.reads(r"measured, ok, skip: ")
        found = re.search(r"turn it to (-?\d+) deg", asked)
        assert found
        for _ in range(10):
            missing_deg = float(found[1]) - self.look()[joint]
            if abs(missing_deg) < 0.2:
                break
            self.types(f"{np.clip(missing_deg, -40, 40):.2f}")
            self.reads(r"measured, ok, skip: ")
        self.types("ok")

    def limits(self, *answers: str) -> None:
        """Answer for both ends of the travel."""
        for answer in answers:
            self.reads(r"end of its travel .*ok, skip: ")
            self.types(answer)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = fitting_file(tmp_path)
    path.write_text("# my robot\n" + path.read_text())
    return path


@pytest.fixture
def wiring(tmp_path: Path) -> ServoMap:
    return load_robot_file(wired_file(tmp_path)).servo_map


def wired_file(tmp_path: Path) -> Path:
    (tmp_path / "wired").mkdir(exist_ok=True)
    return fitting_file(tmp_path / "wired", TRUE_WIRING)


@pytest.fixture
def running(tmp_path: Path) -> Iterator[BoardProcess]:
    with board("--backend", "mock", "--robot", str(wired_file(tmp_path))) as made:
        yield made


def test_a_robot_wired_otherwise_is_found_out(running: BoardProcess, wiring: ServoMap, file: Path) -> None:
    coxa, tibia = JOINT_NAMES.index("leg1_coxa"), JOINT_NAMES.index("leg2_tibia")
    with Person(running, wiring, file, "--joints", "leg2_tibia,leg1_coxa") as person:
        person.begins()
        for joint in (coxa, tibia):
            person.judges_sign(joint)
            person.trims(joint)
            person.limits("skip", "skip")
        last = person.ends()
    assert person.process.returncode == 0
    assert "leg1_coxa, leg2_tibia" in last
    found = load_robot_file(file).servo_map
    np.testing.assert_array_equal(found.signs, wiring.signs)
    np.testing.assert_allclose(found.offsets_deg, wiring.offsets_deg, atol=0.5)
    assert file.read_text().startswith("# my robot\n")
    assert "servos" in (file.parent / "robot.yaml.bak").read_text()
    others = [joint for joint in range(18) if joint not in (coxa, tibia)]
    for seen_deg in person.seen_deg:
        np.testing.assert_allclose(seen_deg[others], person.seen_deg[0][others], atol=0.2)
    assert running.end()["refused"] == 0


def test_driver_and_port_come_from_the_robot_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = edited_file(
        tmp_path, put("servos", {"driver": "feetech", "port": "/dev/nothing"}), base="phantomx"
    )
    before = file.read_text()
    assert exit_code(["calibrate", str(file)]) == 3
    assert "/dev/nothing" in capsys.readouterr().err
    assert exit_code(["calibrate", str(file), "--connect", "/dev/nowhere"]) == 3
    assert "/dev/nowhere" in capsys.readouterr().err
    assert exit_code(["calibrate", str(file), "--backend", "dynamixel"]) == 2
    assert "--backend" in capsys.readouterr().err
    assert file.read_text() == before
