"""A policy: a function from observations to actions, with the contract that makes them a walk."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hexctl.errors import InputError, argument, check_callable
from hexctl.types import N_JOINTS, FloatArray

if TYPE_CHECKING:
    from hexctl.control.policy.contract import PolicyContract
    from hexctl.control.policy.onnx_network import OnnxFile

#: Files next to a network that may have its contract; `{}` is its name without the suffix.
BESIDE = ("{}.yaml", "{}.yml", "deploy.yaml", "IO_descriptors.yaml", "{}_IO_descriptors.yaml")

#: Keys of hexctl that may stand in another program's file.
ADDED = ("control_hz", "command", "motors", "joint_map", "zeros_rad", "terms", "stand_in", "normaliser")

#: Raw actions, (18,), of an observation, (n,).
Act = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True, slots=True, eq=False)
class Policy:
    """A trained policy: a callable with its contract.

        policy = hexctl.Policy.load("walk.onnx")
        hexctl.run(robot="ant", policy=policy, duration_s=5)

    Attributes:
        contract: its joints, observation and actions.
        act: raw actions, (18,), of an observation, (n,); from another thread never.
        name: in results.
    """

    contract: "PolicyContract"
    act: Act = field(repr=False)
    name: str = "policy"

    def __post_init__(self) -> None:
        check_callable(self.act, "policy.act", "a function of an observation that returns actions")

    def __call__(self, observation: FloatArray) -> FloatArray:
        """Raw actions, (18,), of a raw observation, (n,), normalised if the contract says so."""
        mean, std = self.contract.mean, self.contract.std
        if mean is not None and std is not None:
            observation = (observation - mean) / std
        return self.act(observation)

    def __str__(self) -> str:
        return self.name

    @classmethod
    def load(cls, path: str | Path) -> "Policy":
        """Policy of an ONNX file with its contract in the metadata or in a file next to it.

        Raises InputError for an unusable file, and for what its contract lacks; MissingExtraError without
        onnxruntime (extra `policy`).
        """
        from hexctl.control.policy.onnx_network import OnnxFile, OnnxNetwork

        file = OnnxFile.read(Path(path))
        contract = read_contract(file)
        source, size = check_sizes(file, contract)
        output, _ = file.the_output(contract.output)
        network = OnnxNetwork(file, source=source, output=output, size=size)
        return cls(contract, network, file.path.name)


def check_sizes(file: "OnnxFile", contract: "PolicyContract") -> tuple[str, int]:
    """Name and size of a network's input; raises InputError if it does not fit the contract."""
    source, size = file.the_input(contract.input)
    if size != contract.observation_size:
        parts = ", ".join(f"{term.name} {term.width * term.history}" for term in contract.terms)
        raise InputError(
            f"policy: {file.path.name} takes {size} numbers, and its contract has "
            f"{contract.observation_size}: {parts}"
        )
    _, actions = file.the_output(contract.output)
    if actions != N_JOINTS:
        raise InputError(
            f"policy: {file.path.name} gives {actions} actions; allowed: {N_JOINTS}, a position of each joint"
        )
    return source, size


def read_contract(file: "OnnxFile") -> "PolicyContract":
    """Contract of a network; raises InputError for what is missing or wrong."""
    from hexctl.control.policy.contract_file import contract_of

    content, origin = contract_content(file)
    return contract_of(content, file.path.with_suffix(".yaml"), origin)


def contract_content(file: "OnnxFile") -> tuple[dict[str, Any], str]:
    """Keys of hexctl's contract file from all sources of a network, and where they were read."""
    from hexctl.control.policy.contract_sources import from_mjlab, is_of_mjlab
    from hexctl.robot.configs import read_mapping

    beside = contract_file(file.path)
    own = {} if beside is None else read_mapping(beside)
    origins = [] if beside is None else [beside.name]
    content: dict[str, Any] = {}
    base = own
    if _format(own) is not None:  # keys of hexctl may be added to it
        base = {key: value for key, value in own.items() if key in ADDED}
        content = _converted(own, beside or file.path, base)
    if "from" in base:
        other = file.path.parent / str(base["from"])
        content, origins = _converted(read_mapping(other), other, base), [*origins, other.name]
    elif not content and is_of_mjlab(file.metadata):
        content = _guarded(file.path.name, lambda: from_mjlab(file.metadata, file.path.name))
        origins = [*origins, f"the metadata of {file.path.name}"]
    if not origins:
        names = ", ".join(name.format(file.path.stem) for name in BESIDE[:1] + BESIDE[2:4])
        raise InputError(
            f"{argument('policy')}: {file.path} has no contract, neither metadata of mjlab nor a file next "
            f"to it ({names}); next: hexctl policy new {file.path}"
        )
    return _merged(content, base), " and ".join(origins)


def contract_file(path: Path) -> Path | None:
    """File with a contract next to a network, or None."""
    found = (path.with_name(name.format(path.stem)) for name in BESIDE)
    return next((one for one in found if one.is_file()), None)


def _format(content: Mapping[str, Any]) -> str | None:
    from hexctl.control.policy.contract_sources import is_of_isaac_lab, is_of_unitree

    return "isaac" if is_of_isaac_lab(content) else "unitree" if is_of_unitree(content) else None


def _converted(content: Mapping[str, Any], path: Path, own: Mapping[str, Any]) -> dict[str, Any]:
    from hexctl.control.policy.contract_sources import from_isaac_lab, from_unitree

    if (kind := _format(content)) is None:
        raise InputError(
            f"{path}: got another file; allowed: Isaac Lab's IO descriptor, Unitree's deploy.yaml"
        )
    if kind == "isaac":
        return _guarded(path.name, lambda: from_isaac_lab(content, path.name))
    return _guarded(path.name, lambda: from_unitree(content, path.name, own.get("motors")))


def _guarded(name: str, read: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """What a reader returns; a value of another type than its program writes is refused."""
    try:
        return read()
    except InputError:
        raise
    except (TypeError, ValueError, LookupError, AttributeError, ArithmeticError) as error:
        raise InputError(f"{name}: it is not as its program writes it ({error})") from error


def _merged(content: dict[str, Any], own: Mapping[str, Any]) -> dict[str, Any]:
    """Keys of another program's file, replaced by those of hexctl's: `action` and terms key by key."""
    merged = content | {key: value for key, value in own.items() if key != "terms"}
    if isinstance(content.get("action"), dict) and isinstance(own.get("action"), dict):
        merged["action"] = content["action"] | own["action"]
    changes, terms = own.get("terms"), merged.get("observations")
    if isinstance(changes, dict) and isinstance(terms, list):
        names = [term.get("name") for term in terms if isinstance(term, dict)]
        for name, change in changes.items():
            if name not in names or not isinstance(change, dict):
                raise InputError(f"terms: got {name}; allowed: keys by term: {', '.join(map(str, names))}")
        merged["observations"] = [
            term | changes.get(term.get("name"), {}) if isinstance(term, dict) else term for term in terms
        ]
    return merged
