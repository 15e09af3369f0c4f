"""A decoder under attack: what reads the bytes, what it may raise, and where to begin."""

import random
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from hexctl.errors import HexctlError


@dataclass(frozen=True, slots=True, kw_only=True)
class Target:
    """A decoder that is given bytes.

    Attributes:
        name: unique among all targets; of its file in the corpus.
        read: decodes the bytes, and uses what comes out as the program would.
        seeds: good inputs.
        refusals: what it may raise; anything else fell.
        words: parts of the format, which a mutation inserts.
        most_bytes: of an input.
        times: spoiled inputs of a test, beyond those of the corpus.
    """

    name: str
    read: Callable[[bytes], object]
    seeds: tuple[bytes, ...]
    refusals: tuple[type[Exception], ...] = (HexctlError,)
    words: tuple[bytes, ...] = ()
    most_bytes: int = 2000
    times: int = 100

    def fall(self, data: bytes) -> "Fall | None":
        """What is wrong with how it took an input, None if it was decoded or refused."""
        try:
            self.read(data)
        except self.refusals as error:
            return None if "\n" not in str(error) else Fall.of(data, error)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # noqa: BLE001  that is what is looked for; others than Exception too
            return Fall.of(data, error)
        return None


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
