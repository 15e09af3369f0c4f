"""Adds to the pages of the site: shipped files, generated references, equations, figures that open large."""

import re
import sys
import tomllib
from pathlib import Path
from typing import Any

import yaml
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "docs"))

from generated_reference import PARTS  # noqa: E402  a neighbour of this file

#: A link out of docs/ to a shipped file, by its `../` and its path.
LINK = re.compile(r"\]\(((?:\.\./)*)\.\./(configs/[^)#]+|LICENSE|CITATION\.cff)\)")

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]

#: Address of the repository, which a person sets before publication; empty until then.
REPOSITORY: str = PROJECT.get("urls", {}).get("Repository", "").removesuffix("/")

#: How much classes of pages count in the search: lists have every word, and most users look for what to do.
BOOSTS = {"api/index.md": 0.7, "api/": 0.3, "reference/": 0.7, "results/": 0.5}

#: Words for the search that pages lack, by page; the theme indexes tags like titles.
KEYWORDS: dict[str, str] = yaml.safe_load((ROOT / "docs" / "keywords.yaml").read_text(encoding="utf-8"))

#: A figure that is no link yet.
FIGURE = re.compile(r'(?<!">)<img [^>]*src="([^"]+)"[^>]*>')

#: Inline code of at most 30 characters, which does not break.
SHORT = re.compile(r"(?<!<pre>)(?<!</span>)<code>(?=(?:[^<&]|&\w+;){1,30}</code>)")

#: Classes of the API whose fields stand elsewhere, as options of a command or keys of a file.
LISTED_ELSEWHERE = re.compile(r"^::: hexctl\.[\w.]*?(?:Options|Spec|StudyPlan|World)$", re.MULTILINE)

#: The place of a generated reference: a comment, and a line for readers of the source.
GENERATED = re.compile(r"^<!-- generated: (\w+) -->\n.+$", re.MULTILINE)

#: A line that has the repository's address on the site, once there is one.
ADDRESSED = re.compile(r"^<!-- address: (\w+) -->\n(.+)$", re.MULTILINE)

#: What pymdownx.arithmatex leaves of an equation in TeX.
EQUATION = re.compile(r'<(span|div) class="arithmatex">\\([(\[])(.*?)\\[)\]]</\1>', re.DOTALL)


def on_config(config: Any) -> Any:
    """Show the version of the package, and its repository if the package names one."""
    config.site_name = f"{PROJECT['name']} {PROJECT['version']}"
    if REPOSITORY:
        config.repo_url, config.repo_name = REPOSITORY, "Repository"
        config.edit_uri = "edit/main/docs/"
        config.theme["features"].append("content.action.edit")
    return config


def on_files(files: Files, config: Any) -> Files:
    """Put every file under configs/ that a page links to into the site."""
    linked = {
        name
        for page in ROOT.glob("docs/**/*.md")
        for _, name in LINK.findall(page.read_text(encoding="utf-8"))
    }
    for name in sorted(linked):
        if (ROOT / name).is_file():
            files.append(File.generated(config, name, abs_src_path=str(ROOT / name)))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Point links to shipped files at their place, write generated references, weigh the page in search."""
    name = page.file.src_uri
    boost = next((boost for path, boost in BOOSTS.items() if name.startswith(path)), 1)
    page.meta["search"] = {"boost": boost}
    page.meta["tags"] = [KEYWORDS[name]] if name in KEYWORDS else []
    markdown = LISTED_ELSEWHERE.sub(r"\g<0>\n    options: {members: false, show_signature: false}", markdown)
    parts = {**PARTS, "fault_matrix": fault_matrix}
    markdown = GENERATED.sub(lambda found: parts[found[1]](), markdown)
    return ADDRESSED.sub(_addressed, LINK.sub(r"](\1\2)", markdown))


def _addressed(found: re.Match[str]) -> str:
    """A line with the repository's address, or as it stands in the source until there is one."""
    lines = {
        "support": f"[Open an issue]({REPOSITORY}/issues).",
        "uvx": f'```sh\nuvx --python 3.12 --from "hexctl[demo] @ git+{REPOSITORY}" hexctl demo\n```',
    }
    return lines[found[1]] if REPOSITORY else found[2]


def fault_matrix() -> str:
    """Return the tables of the results in faults/, as `python -m faults --table` prints them."""
    if str(ROOT) not in sys.path:
        sys.path.append(str(ROOT))
    from faults.results import RESULTS, Results
    from faults.table import page_part

    results = Results(ROOT / RESULTS)
    return page_part(results.read(), results.not_measured())


def on_page_content(html: str, **_: Any) -> str:
    """Let a click on a figure open it in full size, and write equations as MathML; neither needs a script."""
    shown = FIGURE.sub(r'<a class="figure" href="\1" title="open in full size">\g<0></a>', html)
    shown = SHORT.sub('<code class="short">', shown)
    return EQUATION.sub(_mathml, shown) if EQUATION.search(shown) else shown


def _mathml(found: re.Match[str]) -> str:
    from html import unescape

    from latex2mathml.converter import convert

    return str(convert(unescape(found[3]), display="block" if found[2] == "[" else "inline"))
