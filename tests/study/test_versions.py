from pathlib import Path

import pytest

from hexctl.study.versions import ROOT, code_versions, simulating_sources, source_digest


def relative(files: list[Path]) -> set[str]:
    return {file.relative_to(ROOT / "hexctl").as_posix() for file in files}


def test_the_sources_are_those_that_decide_how_a_gait_walks() -> None:
    names = relative(simulating_sources())
    assert {"control/batch.py", "control/guard.py", "gait/gait.py", "ik/legs.py", "robot/model.py"} <= names
    assert {"study/landscape.py", "types.py", "adapt/space.py"} <= names
    parts = {name.rpartition("/")[0] for name in names}
    assert "backends/sim" in parts


def test_an_edit_of_the_network_a_servo_board_or_a_recording_keeps_the_landscapes() -> None:
    names = relative(simulating_sources())
    for aside in ("backends/mavlink", "backends/zenoh", "wire", "serve", "record", "cli", "errors.py"):
        assert not [name for name in names if name.startswith(aside)], aside


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A folder with a hexctl of a few modules, `start` being where the imports begin."""
    (tmp_path / "hexctl" / "parts").mkdir(parents=True)
    sources = {
        "parts/__init__": "from hexctl import inner\n",
        "start": "from hexctl import parts\nimport numpy\n\ndef f():\n    from hexctl.late import x\n",
        "inner": "import hexctl.start\n",
        "late": "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from hexctl.other import y\n",
        "other": "y = 1\n",
    }
    for name, source in sources.items():
        (tmp_path / "hexctl" / f"{name}.py").write_text(source)
    return tmp_path


def test_imports_are_followed_through_packages_functions_and_circles(root: Path) -> None:
    files = simulating_sources("hexctl.start", root)
    names = {file.relative_to(root / "hexctl").as_posix() for file in files}
    assert names == {"start.py", "parts/__init__.py", "inner.py", "late.py"}


def test_the_digest_changes_with_these_sources_alone(root: Path) -> None:
    before = source_digest("hexctl.start", root)
    (root / "hexctl" / "other.py").write_text("y = 2\n")
    assert source_digest("hexctl.start", root) == before
    (root / "hexctl" / "late.py").write_text("x = 2\n")
    assert source_digest("hexctl.start", root) != before


def test_the_digest_is_among_the_versions() -> None:
    assert code_versions()["source"] == source_digest()
