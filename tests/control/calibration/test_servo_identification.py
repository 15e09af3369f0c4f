"""Which servo moves which joint: an operator who sees what moves is asked, and the answers are kept."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from hexctl.backends.mock import MockServos
from hexctl.control.calibration import EndedError
from hexctl.control.calibration.servo_identification import Identification, identify_servos, joint_named
from hexctl.errors import InputError
from hexctl.robot.schema import ServosSection
from hexctl.robot.servos.bus_map import bus_map_of
from hexctl.types import JOINT_NAMES, JointTargets
from tests.backends.bus.boards import a_map, bus_board
from tests.robots import shipped

pytestmark = [pytest.mark.long, pytest.mark.realtime]


class SeenServos(MockServos):
    """Joints that an operator watches."""

    def connect(self) -> None:
        self.farthest = np.zeros(18)
        super().connect()

    def write(self, targets: JointTargets) -> JointTargets:
        away = np.abs(targets.joint_positions_rad - self.robot.stance_angles_rad)
        self.farthest = np.maximum(self.farthest, away)
        return super().write(targets)


class Watcher:
    """An operator who says which joint moved, after some other answers."""

    def __init__(self, robot: SeenServos, *first: str, ends_after: int = 99) -> None:
        self._robot, self._first, self._left = robot, list(first), ends_after
        self.asked: list[str] = []
        self.told: list[str] = []
        self._answer: str | None = None

    def tell(self, text: str) -> None:
        self.told.append(text)

    def prompt(self, text: str) -> None:
        self.asked.append(text)
        if "Enter moves it" in text:
            if not self._left:
                raise EndedError
            self._left -= 1
            self._robot.farthest = np.zeros(18)
            self._answer = ""
        elif self._first:
            self._answer = self._first.pop(0)
        else:
            self._answer = JOINT_NAMES[int(np.argmax(self._robot.farthest))]

    def poll(self) -> str | None:
        return self._answer


def test_every_joint_is_found_and_written_to_a_new_file(tmp_path: Path) -> None:
    ids = np.random.default_rng(0).permutation(np.arange(31, 49))
    joints = {name: {"id": int(servo_id)} for name, servo_id in zip(JOINT_NAMES, ids, strict=True)}
    bus_map = bus_map_of(ServosSection.model_validate({"model": "sts3215", **joints}), "feetech")
    moved, output = SeenServos(shipped("phantomx")), tmp_path / "servos.yaml"
    with bus_board(bus_map, servos=moved) as board:
        known = Identification(driver="feetech", port=board.path, baud=1_000_000, output=output)
        known.resume()
        identify_servos(known, [31, 32, 33], Watcher(moved, "again", "the knee", ends_after=2))
        assert sorted(known.ids.values()) == [31, 32]
        assert not known.finish()
        assert not output.exists()
        # On another day.
        known = Identification(driver="feetech", port=board.path, baud=1_000_000, output=output)
        known.resume()
        watcher = Watcher(moved)
        identify_servos(known, sorted(ids.tolist()), watcher)
        assert sum("Enter moves it" in each for each in watcher.asked) == 16
        assert known.finish()
        assert not any(servo.holds for servo in board._servos)
    section = ServosSection.model_validate(yaml.safe_load(output.read_text())["servos"])
    assert bus_map_of(section, "feetech").ids.tolist() == ids.tolist()
    assert (section.driver, section.baud, section.model) == ("feetech", 1_000_000, "sts3215")
    assert [path.name for path in tmp_path.iterdir()] == ["servos.yaml"]


def test_a_joint_has_one_servo_and_a_servo_may_belong_to_none() -> None:
    moved = SeenServos(shipped("phantomx"))
    with bus_board(a_map(), "mute:1:tibia", servos=moved) as board:
        known = Identification(driver="feetech", port=board.path, baud=1_000_000)
        watcher = Watcher(moved, "1 coxa", "1c", "none")
        identify_servos(known, [1, 2, 3], watcher)
    assert known.ids == {"leg1_coxa": 1}
    assert any(each.startswith("leg1_coxa has id 1 already") for each in watcher.asked)
    assert watcher.told[-1].startswith("id 3: no servo with id 3 answers")
    assert known.section().splitlines()[-1] == "  leg1_coxa: {id: 1}"


def test_a_servo_moves_by_a_yes_and_is_left_out_by_a_skip_alone() -> None:
    class Hesitant(Watcher):
        """Answers the question before a servo moves in words."""

        words: tuple[str, ...] = ("n", "y", "S", "jes", "yes")

        def prompt(self, text: str) -> None:
            super().prompt(text)
            if "Enter" in text:
                self._answer, self.words = self.words[0], self.words[1:]

    moved = SeenServos(shipped("phantomx"))
    with bus_board(a_map(), servos=moved) as board:
        known = Identification(driver="feetech", port=board.path, baud=1_000_000)
        watcher = Hesitant(moved)
        identify_servos(known, [1, 5, 9], watcher)
    assert known.ids == {"leg1_coxa": 1, "leg3_tibia": 9}
    assert [each for each in watcher.asked if each.startswith("got")] == [
        "got 'n'; allowed: Enter or yes, which moves id 1 (sts3215), 1 of 3; skip, quit:",
        "got 'jes'; allowed: Enter or yes, which moves id 9 (sts3215), 3 of 3; skip, quit:",
    ]
    assert "id 5 (sts3215), 2 of 3: skipped" in watcher.told


def test_with_consent_nothing_is_asked_before_a_servo_moves() -> None:
    moved = SeenServos(shipped("phantomx"))
    with bus_board(a_map(), servos=moved) as board:
        known = Identification(driver="feetech", port=board.path, baud=1_000_000)
        watcher = Watcher(moved)
        identify_servos(known, [5], watcher, consent=True)
    assert known.ids == {"leg2_femur": 5}
    assert len(watcher.asked) == 1


def test_a_file_that_there_is_is_never_written(tmp_path: Path) -> None:
    output = tmp_path / "servos.yaml"
    output.write_text("mine\n")
    known = Identification(driver="feetech", port="/dev/nothing", baud=1_000_000, output=output)
    with pytest.raises(InputError, match=r"output: got .*servos.yaml, which there is already"):
        known.resume()
    output.unlink()
    for draft, message in (("mine", "got no section"), ("servos: {driver: lx16a}", "got driver lx16a")):
        (tmp_path / "servos.yaml.part").write_text(draft)
        with pytest.raises(InputError, match=message):
            known.resume()


@pytest.mark.parametrize(
    ("said", "joint"),
    [
        ("leg3_femur", "leg3_femur"),
        ("3 Femur", "leg3_femur"),
        ("6t", "leg6_tibia"),
        ("7c", None),
        ("knee", None),
        ("", None),
    ],
)
def test_joints_are_named_in_short_words(said: str, joint: str | None) -> None:
    assert joint_named(said) == joint
