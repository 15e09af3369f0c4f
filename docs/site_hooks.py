"""What the site needs beside the pages: shipped files that they link to, and figures that open large."""

import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[1]
#: A link out of docs/, by its way up and what follows.
LINK = re.compile(r"\]\(((?:\.\./)*)\.\./(configs/[^)#]+)\)")

#: A figure that is no link yet.
FIGURE = re.compile(r'(?<!">)<img [^>]*src="([^"]+)"[^>]*>')


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


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Point links to such files at their place in the site."""
    return LINK.sub(r"](\1\2)", markdown)


#: Page of the fault matrix, and the place of the matrix on it.
MATRIX_PAGE, MATRIX = "results/fault-matrix.md", "<!-- fault matrix -->"


def on_page_read_source(page: Any, **_: Any) -> str | None:
    """Insert the fault matrix into its page; other pages are read as they are."""
    if page.file.src_uri != MATRIX_PAGE:
        return None
    text = (ROOT / "docs" / MATRIX_PAGE).read_text(encoding="utf-8")
    return text.replace(MATRIX, fault_matrix())


def fault_matrix() -> str:
    """Return the tables of the results in faults/, as `python -m faults --table` prints them."""
    import sys

    if str(ROOT) not in sys.path:
        sys.path.append(str(ROOT))
    from faults.results import RESULTS, Results
    from faults.table import page_part

    results = Results(ROOT / RESULTS)
    return page_part(results.read(), results.not_measured())


def on_page_content(html: str, **_: Any) -> str:
    """Let a click on a figure open it by itself, as large as the window; needs no script."""
    return FIGURE.sub(r'<a class="figure" href="\1" title="open by itself">\g<0></a>', html)
