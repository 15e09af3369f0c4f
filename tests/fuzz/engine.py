"""The search of one target: libFuzzer by atheris, which mutates what reached a new branch.

python -m tests.fuzz.engine ROOM TARGET FOLDER [FLAGS OF LIBFUZZER]
"""

import os
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

from tests.fuzz.rooms import targets_of

if TYPE_CHECKING:
    from tests.fuzz.target import Target

#: Time of the processor after which an input is told as slow.
SLOW_S = 1.0

#: Memory of the search, with what it has imported and its corpus, in MB.
MOST_MB = 3000


class Search:
    """Gives inputs to a target, and writes each defect that it finds to a file."""

    def __init__(self, target: "Target", folder: Path) -> None:
        self._target, self._folder = target, folder
        self._known: set[str] = set()

    def one(self, data: bytes) -> None:
        """Give one input."""
        began_s = time.process_time()
        fall = self._target.fall(data)
        taken_s = time.process_time() - began_s
        if fall is not None:
            self._tell(fall.where, data, fall.text)
        elif taken_s > SLOW_S:
            self._tell("slow", data, f"{taken_s:.1f} s of the processor\n")

    def _tell(self, where: str, data: bytes, text: str) -> None:
        if where in self._known:
            return
        self._known.add(where)
        stem = f"{self._target.name}-{len(self._known)}"
        (self._folder / f"{stem}.bin").write_bytes(data)
        (self._folder / f"{stem}.txt").write_text(f"{where}\n{text}")


def search(room: str, name: str, folder: Path, flags: list[str]) -> None:
    """Search a target until libFuzzer's flags end it, and with it the process.

    Falls are written to `folder`, inputs with new coverage to its folder `corpus`.
    """
    import atheris

    with atheris.instrument_imports(include=["hexctl", "rosbags", "yaml"]):
        target = next(each for each in targets_of(room) if each.name == name)
    corpus = folder / "corpus"
    corpus.mkdir(parents=True, exist_ok=True)
    from tests.fuzz.corpus import kept

    for number, data in enumerate((*target.seeds, *kept(name))):
        (corpus / f"seed-{number}").write_bytes(data)
    options = [
        f"-max_len={target.most_bytes}",
        f"-rss_limit_mb={MOST_MB}",
        f"-artifact_prefix={folder}{os.sep}",
    ]
    if target.words:
        (folder / "words").write_text("".join(f'"{_escaped(word)}"\n' for word in target.words))
        options.append(f"-dict={folder / 'words'}")
    atheris.Setup([sys.argv[0], *options, *flags, str(corpus)], Search(target, folder).one)
    atheris.Fuzz()


def _escaped(word: bytes) -> str:
    """A word as libFuzzer's dictionaries have it."""
    return "".join(f"\\x{byte:02x}" for byte in word)


if __name__ == "__main__":
    search(sys.argv[1], sys.argv[2], Path(sys.argv[3]), sys.argv[4:])
