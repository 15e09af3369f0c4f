"""What the site needs besides its pages: shipped files, the fault matrix, and figures that open large."""

import re
import sys
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[1]
#: A link out of docs/, by its way up and what follows.
LINK = re.compile(r"\]\(((?:\.\./)*)\.\./(configs/[^)#]+)\)")

#: Where the page of the fault matrix has the matrix.
MATRIX = "<!-- fault matrix -->"

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
    """Point links to such files at their place in the site, and insert the fault matrix."""
    markdown = LINK.sub(r"](\1\2)", markdown)
    return markdown.replace(MATRIX, fault_matrix()) if MATRIX in markdown else markdown


def fault_matrix() -> str:
    """Return the tables of the results in faults/, as `python -m faults --table` prints them."""
    if str(ROOT) not in sys.path:
        sys.path.append(str(ROOT))
    from faults.results import RESULTS, Results
    from faults.table import page_part

    results = Results(ROOT / RESULTS)
    return page_part(results.read(), results.not_measured())


def on_page_content(html: str, **_: Any) -> str:
    """Let a click on a figure open it by itself, as large as the window; needs no script."""
    return FIGURE.sub(r'<a class="figure" href="\1" title="open by itself">\g<0></a>', html)
