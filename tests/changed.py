"""Run the quick tests of what changed: `python -m tests.changed`, `make check`.

Changed is what differs from main, committed or not; on main itself, from the last commit. A module's tests
are those of its name, else of its folder; a page's are `tests/docs`; the golden data goes with any module.
"""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

QUICK = "not soak and not slow and not realtime and not long"
COMPATIBILITY = Path("tests/test_compatibility.py")


def changed_paths() -> list[Path]:
    """Files that differ from main or are new, relative to the root."""
    base = _git("merge-base", "HEAD", "main") or _git("merge-base", "HEAD", "origin/main") or ["HEAD"]
    since = base[0] if base != _git("rev-parse", "HEAD") else "HEAD"
    tracked = _git("diff", "--name-only", since)
    return [
        Path(name) for name in dict.fromkeys([*tracked, *_git("ls-files", "--others", "--exclude-standard")])
    ]


def mirrored(path: Path, root: Path = ROOT) -> list[Path]:
    """Test files and folders that look at a file, relative to the root."""
    parts = path.parts
    if path.suffix == ".py" and parts[0] == "hexctl":
        return [*_mirrors(Path("tests", *parts[1:-1]), path.stem, root), COMPATIBILITY]
    if path.suffix == ".py" and parts[0] == "tests":
        if path.name.startswith("test_"):
            return [path] if (root / path).is_file() else []
        return [path.parent] if len(parts) > 2 else []
    if path.suffix == ".md":
        return [Path("tests/docs")]
    if parts[0] == "configs":
        return [Path("tests/robot/test_configs.py"), COMPATIBILITY]
    return []


def _mirrors(folder: Path, stem: str, root: Path) -> list[Path]:
    """The tests of a module: of its name, with or without more words; else those of its folder."""
    while not (root / folder).is_dir():
        folder, stem = folder.parent, folder.name
    named = [
        found.relative_to(root)
        for found in sorted((root / folder).glob(f"test_{stem}*.py"))
        if found.stem == f"test_{stem}" or found.stem.startswith(f"test_{stem}_")
    ]
    return named or ([folder] if folder != Path("tests") else [])


def _git(*arguments: str) -> list[str]:
    done = subprocess.run(
        ["git", *arguments],  # noqa: S607  whichever git is installed
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    return done.stdout.splitlines() if done.returncode == 0 else []


def main() -> int:
    """Run the tests and return pytest's exit code."""
    paths = sorted({test for path in changed_paths() for test in mirrored(path)})
    paths = [path for path in paths if not set(path.parents) & set(paths)]
    if not paths:
        print("nothing changed since main that has quick tests; make test runs all")  # noqa: T201
        return 0
    workers = str(max(2, os.cpu_count() or 2))
    command = [sys.executable, "-m", "pytest", "-n", workers, "-m", QUICK, *map(str, paths)]
    code = subprocess.run(command, cwd=ROOT, check=False).returncode
    return 0 if code == 5 else code  # 5: they are all slow or in real time


if __name__ == "__main__":
    sys.exit(main())
