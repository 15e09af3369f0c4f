"""A decoder under attack: what reads the bytes, what it may raise, and where to begin."""

import atexit
import os
import random
import shutil
import tempfile
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from hexctl.errors import HexctlError

#: Words of numbers that no robot has, as text, in JSON and in binary.
NUMBERS = (b"nan", b"inf", b"1e400", b"-1", b"9" * 400)
NO_VALUES = (b"null", b"true", b"[]", b"{}", b'""', b'"\\ud800"', b"[" * 50)
JSON_WORDS = (b"NaN", b"-Infinity", *NUMBERS[2:], *NO_VALUES)
BINARY_NUMBERS = (
    *(np.array(value, "<f8").tobytes() for value in (np.nan, np.inf, 1e308)),
    *(np.array(value, "<f4").tobytes() for value in (np.nan, np.inf)),
    *(np.array(value, "<u4").tobytes() for value in (2**32 - 1, 18)),
    *(np.array(value, "<u2").tobytes() for value in (2**16 - 1, 2**16 - 2)),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Target:
    """A decoder that is given bytes.

    Attributes:
        name: unique among all targets; of its lines in the corpus.
        read: decodes an input, and uses what comes out as the program would.
        seeds: good inputs.
        given: turns an input into the argument of `read`.
        refusals: what it may raise; anything else fell.
        words: parts of the format, which a mutation inserts.
        times: spoiled inputs of a test, beyond those of the corpus.
    """

    name: str
    read: Callable[[Any], object]
    seeds: tuple[bytes, ...]
    given: Callable[[bytes], Any] = bytes
    refusals: tuple[type[Exception], ...] = (HexctlError,)
    words: tuple[bytes, ...] = ()
    times: int = 100

    @property
    def most_bytes(self) -> int:
        """Length of an input, at most."""
        return 200 + 2 * max(map(len, (*self.seeds, *self.words)))

    def fall(self, data: bytes) -> "Fall | None":
        """What is wrong with how it took an input, None if it was decoded or refused."""
        try:
            self.read(self.given(data))
        except self.refusals as error:
            return None if "\n" not in str(error) else Fall.of(data, error)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # noqa: BLE001  that is what is looked for; others than Exception too
            return Fall.of(data, error)
        return None


def target(*seeds: bytes, **about: Any) -> Callable[[Callable[[Any], object]], Target]:
    """Make a target of a function with good inputs: that of `read_stop_file` is named `stop-file`."""

    def made(read: Callable[[Any], object]) -> Target:
        name = read.__name__.removeprefix("read_").replace("_", "-")
        return Target(name=name, read=read, seeds=seeds, **about)

    return made


@cache
def own_folder() -> Path:
    """A folder of this process, deleted at exit; in memory if the system allows it."""
    memory = Path("/dev/shm")  # noqa: S108  the folder in it has a name of its own
    place = memory if os.access(memory, os.W_OK) else None
    folder = Path(tempfile.mkdtemp(prefix="hexctl-fuzz-", dir=place))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


def written(name: str, data: bytes) -> Path:
    """Path of a file with an input, which only its owner may read."""
    path = own_folder() / name
    path.write_bytes(data)
    path.chmod(0o600)
    return path


def as_text(data: bytes) -> str:
    """Text as the command line gives it: what is no UTF-8 is escaped."""
    return data.decode("utf-8", "surrogateescape")


@dataclass(frozen=True, slots=True)
class Fall:
    """An input on which a decoder fell.

    Attributes:
        data: the input.
        where: the error and the innermost line of hexctl; two falls of one place are one defect.
        text: the traceback.
    """

    data: bytes
    where: str
    text: str

    @classmethod
    def of(cls, data: bytes, error: BaseException) -> "Fall":
        """Fall by an error that was raised."""
        frames = traceback.extract_tb(error.__traceback__)
        own = [frame for frame in frames if "hexctl" in Path(frame.filename).parts] or frames
        place = f"{Path(own[-1].filename).name}:{own[-1].lineno}"
        return cls(data, f"{type(error).__name__} at {place}", "".join(traceback.format_exception(error)))


def spoiled(good: bytes, chance: random.Random, words: tuple[bytes, ...] = ()) -> bytes:
    """An input that is cut off, flipped, doubled in part, or has words of the format in other places."""
    data = bytearray(good)
    for _ in range(chance.randrange(1, 5)):
        place = chance.randrange(len(data) + 1)
        end = min(len(data), place + chance.randrange(1, 9))
        how = chance.randrange(6)
        if how == 0:
            del data[place:end]
        elif how == 1 and place < len(data):
            data[place] ^= 1 << chance.randrange(8)
        elif how == 2:
            data[place:place] = chance.choice(words or (b"0", b"-1", b"\xff" * 8))
        elif how == 3:
            data[place:end] = chance.randbytes(end - place)
        elif how == 4:
            data[place:place] = data[place:end] * chance.randrange(1, 9)
        else:
            del data[place:]
    return bytes(data)
