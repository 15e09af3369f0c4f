"""The pages as a site: every link leads somewhere, and what they say of the code is so."""

import ast
import json
import math
import os
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from pydoc import locate
from typing import get_args

import pytest
import yaml
from PIL import Image, ImageSequence

import hexctl
import hexctl.extension
import hexctl.testing
import hexctl.vision
from hexctl.gait.encoding import slots_from_code
from hexctl.robot.plugins import Door
from hexctl.settings import FILE as SETTINGS_FILE
from pictures.rescue import RACE
from pictures.step_response import SHIFT_M, TURN_RAD, respond
from tests.docs.pages import PAGES, REFERENCE, ROOT, blocks

DOCS = ROOT / "docs"


@pytest.mark.parametrize("page", [*PAGES, *REFERENCE], ids=lambda page: page.name)
def test_links_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", page.read_text(encoding="utf-8")):
        assert "://" in target or (page.parent / target).exists(), target


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The built site."""
    pytest.importorskip("mkdocs", reason="the site needs the docs extra: pip install '.[docs]'")
    folder = tmp_path_factory.mktemp("docs") / "site"
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)],
        cwd=ROOT,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return folder


@pytest.mark.slow
def test_the_site_builds_without_a_warning_and_needs_no_network(site: Path) -> None:
    pages = list(site.rglob("*.html"))
    assert len(pages) >= len(PAGES) - 3  # all but README, CONTRIBUTING and the decisions
    assert (site / "configs" / "worlds" / "randomised.yaml").is_file()
    assert not [path for kind in ("*.py", "*.pyc", "__pycache__") for path in site.rglob(kind)]
    assert (site / "search" / "search_index.js").is_file()  # in a folder no page reads the other
    servos = (site / "how-to" / "which-servos.html").read_text()
    assert '<a class="figure" href="../images/plugs.svg"' in servos
    loaded = r"<(?:script|img|iframe)[^>]+src=[\"']?https?://|<link[^>]+rel=[\"']?stylesheet[^>]+https?://"
    for page in pages:
        assert not re.search(loaded, page.read_text(encoding="utf-8")), page.name


@pytest.mark.slow
def test_the_site_shows_its_version_references_equations_and_short_code(site: Path) -> None:
    version = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    assert f"<title>hexctl {version}</title>" in (site / "index.html").read_text(encoding="utf-8")
    commands = (site / "reference" / "command-line.html").read_text(encoding="utf-8")
    assert '<code class="short">--failed-leg TEXT</code>' in commands
    matrix = (site / "results" / "fault-matrix.html").read_text(encoding="utf-8")
    assert re.search(r"controller killed</td>\s*<td[^>]*>rests<", matrix)
    assert "generated:" not in commands + matrix
    pages = [page.read_text(encoding="utf-8") for page in site.rglob("*.html")]
    assert any("<math " in page for page in pages)
    assert not any('class="arithmatex"' in page for page in pages)


NODE = shutil.which("node")


@pytest.mark.slow
@pytest.mark.skipif(NODE is None, reason="the search of the site is a script: install node")
def test_the_search_answers_the_questions_of_users(site: Path) -> None:
    """The page that answers is first, and else among the first three."""
    table = yaml.safe_load((Path(__file__).parent / "search_questions.yaml").read_text(encoding="utf-8"))
    done = subprocess.run(
        [str(NODE), str(Path(__file__).parent / "site_search.js"), str(site)],
        input=json.dumps([question for questions in table.values() for question in questions]),
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    )
    found = iter(json.loads(done.stdout))
    for kind, first, among_three in (("imagined", 0.95, 1.0), ("threads", 0.75, 0.95)):
        places = {
            question: next((place for place, page in enumerate(next(found)) if page[:-5] in right), 99)
            for question, right in table[kind].items()
        }
        wrong = {question: place for question, place in places.items() if place}
        far = {question: place for question, place in wrong.items() if place > 2}
        assert len(wrong) <= (1 - first) * len(places), wrong
        assert len(far) <= (1 - among_three) * len(places), far


def test_every_keyword_belongs_to_a_page() -> None:
    keywords = yaml.safe_load((DOCS / "keywords.yaml").read_text(encoding="utf-8"))
    assert not [page for page in keywords if not (DOCS / page).is_file()]


def test_every_page_is_in_the_navigation() -> None:
    navigation = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    for page in DOCS.rglob("*.md"):
        name = page.relative_to(DOCS).as_posix()
        assert name.startswith("dev/") or f": {name}\n" in navigation, name


def test_every_public_name_is_in_the_reference() -> None:
    described = described_names()
    assert len(set(described)) == len(described)
    packages = {"adapt": "adapt.adaptation.adapt", "export": "export.export.export"}
    seen = {f"vision.{name}" for name in hexctl.vision.__all__}
    suites = {f"testing.{name}" for name in hexctl.testing.__all__}
    extension = {f"extension.{name}" for name in hexctl.extension.__all__}
    assert {packages.get(name, name) for name in hexctl.__all__} | seen | suites | extension <= set(described)
    overview = (DOCS / "api" / "index.md").read_text(encoding="utf-8")
    listed = [name for line in overview.splitlines() if line[:2] == "| " for name in QUOTED.findall(line)]
    assert sorted(listed) == sorted(hexctl.__all__)  # the page of a package lists its names


QUOTED = re.compile(r"`([\w.]+)`")


def described_names() -> list[str]:
    """Names that the reference describes, without `hexctl.` in front."""
    texts = [page.read_text(encoding="utf-8") for page in REFERENCE]
    return [name for text in texts for name in re.findall(r"^::: hexctl\.(\S+)$", text, re.MULTILINE)]


def imported_names(program: str) -> Iterator[str]:
    """Names that a program imports from hexctl, without `hexctl.` in front."""
    for node in ast.walk(ast.parse(program)):
        if isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] == "hexctl":
            for alias in node.names:
                yield f"{node.module}.{alias.name}".removeprefix("hexctl.")


@pytest.mark.parametrize(
    "page", [page for page in PAGES if page.name != "CONTRIBUTING.md"], ids=lambda page: page.name
)
def test_the_programs_of_a_page_import_what_the_reference_describes(page: Path) -> None:
    """Nothing else is promised to stay; CONTRIBUTING is for those who change hexctl itself."""
    imported = {name for block in blocks(page, "python") for name in imported_names(block.text)}
    assert imported <= {*described_names(), *hexctl.__all__}


#: What a reader of CONTRIBUTING writes.
TO_BE_WRITTEN = ("NAME", "NAME-locked-rear-30s")


@pytest.mark.parametrize("page", [*PAGES, *REFERENCE], ids=lambda page: page.name)
def test_the_names_of_modules_and_files_exist(page: Path) -> None:
    text = re.sub(r"\]\([^)]*\)", "", page.read_text(encoding="utf-8"))
    groups = {f"hexctl.{door}" for door in get_args(Door)}
    for name in set(re.findall(r"\bhexctl(?:\.\w+)+", text)) - {SETTINGS_FILE} - groups:
        assert exists(name) or name.endswith(TO_BE_WRITTEN), name
    for path in re.findall(r"(?<![/:\w])(?:hexctl|tests|benchmarks|configs|examples)/[\w/.-]*\w", text):
        there = any((ROOT / path).parent.glob(f"{Path(path).name}*"))
        assert there or Path(path).stem.endswith(TO_BE_WRITTEN), path


def exists(name: str) -> bool:
    """Whether a dotted name is a module, or an attribute or a field of one or of a class."""
    owner, _, last = name.rpartition(".")
    return locate(name) is not None or last in getattr(locate(owner), "__dataclass_fields__", {})


#: Scripts of figures, and what each makes.
FIGURES = {
    "make_gait_figures.py": ["foot.svg", "frames.svg", "gaits.svg", "leg.svg"],
    "make_plug_figure.py": ["plugs.svg"],
    "make_result_figures.py": ["holds.svg", "search.svg"],
    "make_wiring_figures.py": [
        f"wiring-{name}.svg" for name in ("bus", "maestro", "pca9685", "servo2040", "ssc32")
    ],
}


@pytest.mark.slow
@pytest.mark.parametrize("script", FIGURES)
def test_the_figures_are_what_their_script_makes(tmp_path: Path, script: str) -> None:
    subprocess.run([sys.executable, str(DOCS / script), str(tmp_path)], cwd=ROOT, check=True, timeout=120)
    made = sorted(path.name for path in tmp_path.iterdir())
    assert made == FIGURES[script]
    for name in made:
        drawn = (tmp_path / name).read_text(encoding="utf-8")
        kept = (DOCS / "images" / name).read_text(encoding="utf-8")
        # Other versions of matplotlib draw the same with other bytes; the number of shapes tells.
        assert abs(drawn.count("<path") - kept.count("<path")) <= 0.1 * kept.count("<path"), name


def test_the_citation_is_complete_and_of_this_version() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert {"cff-version", "message", "title", "authors"} <= set(citation)
    assert (citation["version"], citation["license"]) == (project["version"], project["license"])


def test_the_codes_of_the_gait_page() -> None:
    rows = re.findall(
        r"^\| (\d+) \| ([\d,]+) \| ([\d,]*) ?\|$",
        (DOCS / "explanation" / "gaits.md").read_text(encoding="utf-8"),
        re.MULTILINE,
    )
    assert len(rows) >= 5
    for code, intact, failed in rows:
        assert ",".join(map(str, slots_from_code(int(code)))) == intact
        if failed:
            assert ",".join(map(str, slots_from_code(int(code), (5,)))) == failed


@pytest.mark.slow
def test_a_walk_comes_to_a_line_that_moves_as_the_page_says() -> None:
    moved = respond("ant", None, shift_m=SHIFT_M, turn_rad=0.0)
    assert moved.deviation_m[0] < -0.99 * SHIFT_M
    assert moved.reached_at(moved.deviation_m) < 5
    assert moved.deviation_m.max() < 0.06
    assert moved.settled_at(moved.deviation_m, SHIFT_M) < 18


@pytest.mark.slow
def test_a_walk_turns_with_its_line_as_the_page_says() -> None:
    turned = respond("ant", 3, shift_m=0.0, turn_rad=TURN_RAD)
    assert turned.yaw_off_rad[0] < -0.95 * TURN_RAD
    assert turned.reached_at(turned.yaw_off_rad) < 6
    assert turned.yaw_off_rad.max() < math.radians(4.0)
    assert abs(turned.deviation_m).max() < 0.04
    assert abs(turned.deviation_m[-50:]).max() < 0.01


def test_the_picture_is_small_and_on_top_of_the_readme() -> None:
    picture = DOCS / "images" / "rescue.gif"
    assert picture.stat().st_size <= 2_000_000
    with Image.open(picture) as gif:
        assert gif.size[0] == RACE["width_px"]
        shown_ms = sum(frame.info["duration"] for frame in ImageSequence.Iterator(gif))
    assert 5 <= shown_ms / 1000 <= 8.1
    head = (ROOT / "README.md").read_text(encoding="utf-8").splitlines()[:6]
    assert any("docs/images/rescue.gif" in line for line in head)
