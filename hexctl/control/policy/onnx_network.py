"""A network of an ONNX file: probed in another process, then loaded, warmed and called on one thread."""

import json
import subprocess
import sys
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from hexctl.control.policy.onnx_probe import session_of
from hexctl.errors import InputError, MissingExtraError, argument
from hexctl.files import read_file
from hexctl.types import FloatArray

#: Maximum size of a file; networks that walk have less than 10 MB.
MOST_BYTES = 64_000_000

#: How long a probe may take, and inferences before the robot stands.
PROBE_S, WARMING = 60.0, 20

ALLOWED = "an ONNX network with standard operators and its weights in the same file, up to 64 MB"


@dataclass(frozen=True, slots=True)
class OnnxFile:
    """A network that a probe has loaded.

    Attributes:
        path: of the file.
        content: of the file.
        inputs: type and shape by name; unknown sizes are texts or None.
        outputs: type and shape by name.
        metadata: texts by key.
    """

    path: Path
    content: bytes
    inputs: dict[str, tuple[str, list[Any]]]
    outputs: dict[str, tuple[str, list[Any]]]
    metadata: dict[str, str]

    @classmethod
    def read(cls, path: Path) -> "OnnxFile":
        """Probe a file; raises InputError for an unusable one, MissingExtraError without onnxruntime."""
        try:
            content = read_file(path, MOST_BYTES)
        except OSError as error:
            raise InputError(
                f"{argument('policy')}: {str(path)!r} cannot be read ({error.strerror}); allowed: {ALLOWED}"
            ) from error
        if find_spec("onnxruntime") is None:
            raise MissingExtraError("a policy", "policy")
        found = _probed(content, path)
        return cls(path, content, found["inputs"], found["outputs"], found["metadata"])

    def the_input(self, name: str | None) -> tuple[str, int]:
        """Name and number of values of the network's input; raises InputError for another kind of input."""
        if (len(self.inputs) != 1 and name is None) or (name is not None and [*self.inputs] != [name]):
            got = f"inputs {', '.join(self.inputs)}"
            raise self._refused(f"{got}; allowed: one, without a memory" + _named(name))
        ((name, (kind, shape)),) = self.inputs.items()
        return name, self._size(name, kind, shape)

    def the_output(self, name: str | None) -> tuple[str, int]:
        """Name and number of values of the network's output; raises InputError for another kind of output."""
        if name is None and len(self.outputs) == 1:
            name = next(iter(self.outputs))
        if name not in self.outputs:
            got = f"outputs {', '.join(self.outputs)}"
            raise self._refused(f"{got}; allowed: one, or the contract's output: NAME{_named(name)}")
        return name, self._size(name, *self.outputs[name])

    def session(self) -> Any:
        """Session of the network."""
        return session_of(self.content)

    def _size(self, name: str, kind: str, shape: list[Any]) -> int:
        sizes = [size for size in shape[-1:] if isinstance(size, int) and size > 0]
        flat = (
            len(shape) in (1, 2)
            and sizes
            and (len(shape) == 1 or shape[0] in (1, None) or isinstance(shape[0], str))
        )
        if kind != "tensor(float)" or not flat:
            raise self._refused(f"{name} {kind} {shape}; allowed: float numbers of shape (1, n)")
        return int(sizes[0])

    def _refused(self, got: str) -> InputError:
        return InputError(f"{argument('policy')}: {self.path.name}: got {got}")


def _named(name: str | None) -> str:
    return "" if name is None else f" (the contract names {name})"


def _probed(content: bytes, path: Path) -> dict[str, Any]:
    command = [sys.executable, "-m", "hexctl.control.policy.onnx_probe"]
    try:
        done = subprocess.run(command, input=content, capture_output=True, timeout=PROBE_S, check=False)
    except subprocess.TimeoutExpired:
        raise _unusable(path, "it took more than a minute to load") from None
    try:
        found: dict[str, Any] = json.loads(done.stdout)
    except ValueError:
        raise _unusable(path, f"it ends the process that loads it, with {done.returncode}") from None
    if "error" in found:
        raise _unusable(path, " ".join(str(found["error"]).split())[:160])
    return found


def _unusable(path: Path, why: str) -> InputError:
    return InputError(f"{argument('policy')}: {path} cannot be loaded ({why}); allowed: {ALLOWED}")


class OnnxNetwork:
    """Raw actions, (m,), of an observation, (n,), in single precision."""

    def __init__(self, file: OnnxFile, *, source: str, output: str, size: int) -> None:
        """Load and warm a network with input `source` of a size, and an output."""
        self._session, self._source, self._output = file.session(), source, [output]
        self._shape = (1, size) if len(file.inputs[source][1]) == 2 else (size,)
        for _ in range(WARMING):
            self(np.zeros(size))

    def __call__(self, observation: FloatArray) -> FloatArray:
        """Raw actions of an observation."""
        values = observation.astype(np.float32).reshape(self._shape)
        (actions,) = self._session.run(self._output, {self._source: values})
        return np.asarray(actions, dtype=float).ravel()
