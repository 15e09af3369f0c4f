"""Loads an ONNX network of stdin in another process, because a hostile one may take all memory or crash.

`python -m hexctl.control.policy.onnx_probe` prints a JSON object: inputs, outputs, metadata, or an error.
"""

import json
import resource
import sys
from typing import Any

#: Memory and time of the process.
MOST_BYTES, MOST_CPU_S = 4 << 30, 30


def session_of(content: bytes) -> Any:
    """Session of a network, on one thread of the processor; raises whatever the library raises."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4  # it would write to stderr
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    return onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])


def described(session: Any) -> dict[str, Any]:
    """Inputs, outputs and metadata of a session, after one inference of zeros."""
    import numpy as np

    inputs = {one.name: [one.type, list(one.shape)] for one in session.get_inputs()}
    outputs = {one.name: [one.type, list(one.shape)] for one in session.get_outputs()}
    if len(inputs) == 1 and all(kind == "tensor(float)" for kind, _ in inputs.values()):
        ((name, (_, shape)),) = inputs.items()
        if all(isinstance(size, int) for size in shape[1:]):
            sizes = [size if isinstance(size, int) else 1 for size in shape]
            session.run(None, {name: np.zeros(sizes, dtype=np.float32)})
    return {
        "inputs": inputs,
        "outputs": outputs,
        "metadata": dict(session.get_modelmeta().custom_metadata_map),
    }


def main() -> None:
    """Print the description of the network of stdin, or the error of the library."""
    resource.setrlimit(resource.RLIMIT_AS, (MOST_BYTES, MOST_BYTES))
    resource.setrlimit(resource.RLIMIT_CPU, (MOST_CPU_S, MOST_CPU_S))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    try:
        print(json.dumps(described(session_of(sys.stdin.buffer.read()))))  # noqa: T201  its answer
    except Exception as error:  # noqa: BLE001  the library raises its own kinds
        print(json.dumps({"error": str(error) or type(error).__name__}))  # noqa: T201


if __name__ == "__main__":
    main()
