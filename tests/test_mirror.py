"""The tests mirror the package: a module's tests lie where it lies, and are called after it."""

from pathlib import Path

TESTS = Path(__file__).parent
PACKAGE = TESTS.parent / "hexctl"

#: Folders of tests that look at something else than the package.
OTHER_FOLDERS = {"benchmarks", "data", "docs", "examples", "faults", "fuzz", "golden", "viewer"}

#: Tests of what several modules do together.
TOGETHER = {
    "test_changed.py",
    "test_compatibility.py",
    "test_mirror.py",
    "test_public_api.py",
    "test_rooms.py",
    "test_schedule.py",
    "adapt/test_docs_example.py",
    "adapt/test_kill.py",
    "backends/bus/test_lx16a_servos.py",
    "cli/test_files_for_folders.py",
    "cli/test_foreign_code.py",
    "cli/test_foreign_text.py",
    "cli/test_hangup.py",
    "cli/test_meshes.py",
    "cli/test_options.py",
    "server/test_failing_link.py",
    "server/test_frozen_viewers.py",
    "server/test_hostile_input.py",
    "server/test_link_faults.py",
    "server/test_lockout.py",
    "server/test_soak.py",
    "server/test_standstill.py",
    "server/test_steered_link.py",
}


def mirrors(test: Path) -> bool:
    """Whether a test file is called after a module or package, with or without more words."""
    place = PACKAGE / test.relative_to(TESTS).parent
    words = test.stem.removeprefix("test_").split("_")
    names = ["_".join(words[:count]) for count in range(1, len(words) + 1)]
    return any((place / f"{name}.py").is_file() or (place / name).is_dir() for name in names)


def test_every_test_file_is_called_after_what_it_tests() -> None:
    strays = []
    for path in sorted(TESTS.rglob("test_*.py")):
        name = path.relative_to(TESTS).as_posix()
        if name.split("/")[0] not in OTHER_FOLDERS and name not in TOGETHER and not mirrors(path):
            strays.append(name)
    assert not strays, f"rename them after a module, or list them as tests of several: {strays}"


def test_the_list_of_tests_of_several_modules_is_of_today() -> None:
    assert {name for name in TOGETHER if not (TESTS / name).is_file()} == set()
