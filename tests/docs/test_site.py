"""The pages as a site: every link leads somewhere, and what they say of the code is so."""

import ast
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from hexctl.gait.encoding import slots_from_code
from tests.docs.pages import PAGES, ROOT

DOCS = ROOT / "docs"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", page.read_text(encoding="utf-8")):
        assert "://" in target or (page.parent / target).exists(), target


def test_the_site_builds_without_a_warning_and_needs_no_network(tmp_path: Path) -> None:
    pytest.importorskip("mkdocs", reason="the site needs the docs extra: pip install '.[docs]'")
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path / "site")],
        cwd=ROOT,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    pages = list((tmp_path / "site").glob("*.html"))
    assert len(pages) >= len(PAGES) - 1
    assert (tmp_path / "site" / "configs" / "worlds" / "randomised.yaml").is_file()
    assert not list((tmp_path / "site").rglob("*.py"))
    loaded = r"<(?:script|img|iframe)[^>]+src=[\"']?https?://|<link[^>]+rel=[\"']?stylesheet[^>]+https?://"
    for page in pages:
        assert not re.search(loaded, page.read_text(encoding="utf-8")), page.name


def test_every_page_is_in_the_navigation() -> None:
    navigation = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    for page in DOCS.glob("*.md"):
        assert f": {page.name}\n" in navigation, page.name


def test_the_figures_are_what_their_script_makes(tmp_path: Path) -> None:
    script = DOCS / "make_gait_figures.py"
    subprocess.run([sys.executable, str(script), str(tmp_path)], cwd=ROOT, check=True, timeout=120)
    made = sorted(path.name for path in tmp_path.iterdir())
    assert made == ["foot.svg", "frames.svg", "gaits.svg", "leg.svg"]
    for name in made:
        drawn = (tmp_path / name).read_text(encoding="utf-8")
        kept = (DOCS / "images" / name).read_text(encoding="utf-8")
        # Other versions of matplotlib draw the same with other bytes; the number of shapes tells.
        assert abs(drawn.count("<path") - kept.count("<path")) <= 0.1 * kept.count("<path"), name


def imports() -> dict[str, set[str]]:
    """Which parts of hexctl each part imports; the modules beside the parts are for all of them."""
    found: dict[str, set[str]] = {}
    for path in (ROOT / "hexctl").glob("*/**/*.py"):
        part = path.relative_to(ROOT / "hexctl").parts[0]
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("hexctl."):
                found.setdefault(part, set()).add(str(node.module).split(".")[1])
    common = {path.stem for path in (ROOT / "hexctl").glob("*.py")}
    return {part: used - {part} - common for part, used in found.items()}


def test_the_layout_page_tells_who_imports_whom() -> None:
    rows = re.findall(
        r"^\| `(\w+)` \|([a-z, ]*)\|$", (DOCS / "layout.md").read_text(encoding="utf-8"), re.MULTILINE
    )
    told = {part: set(names.replace(",", " ").split()) for part, names in rows}
    assert told == imports()
    seen: set[str] = set()
    for part, _names in rows:  # each row imports rows above it only
        assert told[part] <= seen, part
        seen.add(part)


def test_the_codes_of_the_gait_page() -> None:
    rows = re.findall(
        r"^\| (\d+) \| ([\d,]+) \| ([\d,]*) ?\|$",
        (DOCS / "gait.md").read_text(encoding="utf-8"),
        re.MULTILINE,
    )
    assert len(rows) >= 5
    for code, intact, failed in rows:
        assert ",".join(map(str, slots_from_code(int(code)))) == intact
        if failed:
            assert ",".join(map(str, slots_from_code(int(code), (5,)))) == failed
