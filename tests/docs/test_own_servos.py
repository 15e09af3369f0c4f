"""The example of docs/how-to/extend.md passes the conformance suite, and gets the options of its page."""

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from hexctl.backends.base import LegServos
from hexctl.backends.registry import BackendOptions, check_options, make_servos
from hexctl.errors import InputError
from hexctl.robot.loader import load_robot_file
from hexctl.testing import LegServosConformance
from tests.backends.fake_time import FakeTime
from tests.docs.pages import ROOT, save_programs

NAME = "mykit:KitServos"


@pytest.fixture(scope="module", autouse=True)
def kit_in_this_folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Save `mykit.py` of the page in a folder of the path."""
    folder = tmp_path_factory.mktemp("kit")
    save_programs(ROOT / "docs" / "how-to" / "extend.md", folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(folder)
        yield
    sys.modules.pop("mykit", None)


def options(**given: object) -> BackendOptions:
    file = load_robot_file("ant")
    return BackendOptions(robot=file.robot, robot_file=file, **given)  # type: ignore[arg-type]


class TestKitServos(LegServosConformance):
    def make(self) -> LegServos:
        servos = make_servos(NAME, options())
        vars(servos)["_clock"] = FakeTime().clock()  # its own one waits
        return servos


def test_the_section_servos_and_the_port_reach_the_kit(tmp_path: Path) -> None:
    port = tmp_path / "port"
    check_options(NAME, connect=str(port))
    with make_servos(NAME, options(connect=str(port))) as servos:
        state = servos.read()
        assert not state.measured
    assert port.read_text() == ""


def test_an_option_that_the_kit_does_not_name_is_refused() -> None:
    with pytest.raises(InputError, match=f"^seed: got 3 with backend {NAME}, whose class takes no `seed`"):
        check_options(NAME, seed=3)
