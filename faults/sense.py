"""Combinations that make no sense, and why: they are named in the table and not run."""

from faults.backend import BACKENDS, Backend
from faults.fault import FAULTS, Fault
from faults.phase import PHASES

#: Faults of what stands between a controller and a robot.
_OF_LINKS = (
    "controller-killed",
    "frozen-0.15",
    "frozen-0.3",
    "frozen-5",
    "server-killed",
    "server-frozen",
    "cable-out",
    "loss-10",
    "loss-30",
    "reorder",
    "delay-0.05",
    "delay-0.3",
    "garbled",
    "viewer-killed",
    "viewer-frozen",
    "flood",
)

ONE_PROCESS = "controller and simulation are one process, without a link"
OWN_SIMULATION = "each trial makes its own simulation"
SERVED_TWIN = "the simulation is part of the server, and ends or freezes with it"
WIRE = "a wire delivers in order and immediately"
CHECKED = "TCP delivers no garbled bytes"
LIMP = "its own serial timeout ends the pulses, and the robot drops; a test measures when"
NO_SUPPLY = "these servos have no supply that can be measured"
NO_FEEDBACK = "these servos measure nothing"
NO_TEMPERATURE = "no temperature is measured"
NO_TILT = "the tilt of the body is not measured: nothing can detect a fall"


def why_not(fault: Fault, backend: Backend, phase: str) -> str | None:
    """Why a combination makes no sense, or None for one that does."""
    name = fault.name
    if backend.name == "sim":
        if phase == "between trials":
            return OWN_SIMULATION
        if name in _OF_LINKS:
            return ONE_PROCESS
    if name in ("server-killed", "server-frozen") and backend.name == "zenoh":
        return SERVED_TWIN
    if name in ("server-killed", "server-frozen", "cable-out") and backend.goes_limp:
        return LIMP
    if name in ("reorder", "delay-0.05", "delay-0.3") and (backend.serial_bus or backend.hobby):
        return WIRE
    if name == "garbled" and backend.name == "zenoh":
        return CHECKED
    if name == "brown-out" and not (backend.serial_bus or "reset" in backend.kinds):
        return NO_SUPPLY
    if name in ("wild-reading", "frozen-encoder") and backend.hobby:
        return NO_FEEDBACK
    if name == "hot-servo" and not (backend.serial_bus or backend.name in ("sim", "zenoh")):
        return NO_TEMPERATURE
    if name == "fallen" and backend.name not in ("sim", "zenoh", "mavlink"):
        return NO_TILT
    return None


def cells() -> list[tuple[str, str, str]]:
    """Fault, backend and phase of all cells that make sense."""
    return [
        (fault.name, backend.name, phase)
        for backend in BACKENDS.values()
        for fault in FAULTS.values()
        for phase in PHASES
        if why_not(fault, backend, phase) is None
    ]


def left_out() -> dict[str, list[str]]:
    """By reason, what was left out, as `fault: backends`."""
    found: dict[str, dict[str, list[str]]] = {}
    for fault in FAULTS.values():
        for backend in BACKENDS.values():
            reasons = {why_not(fault, backend, phase) for phase in PHASES} - {None}
            if all(why_not(fault, backend, phase) for phase in PHASES):
                reason = str(why_not(fault, backend, "walking"))
                found.setdefault(reason, {}).setdefault(fault.words, []).append(backend.name)
            else:
                for reason in sorted(str(each) for each in reasons):
                    found.setdefault(reason, {}).setdefault("between trials, all faults", ["sim"])
    return {reason: _grouped(rows) for reason, rows in found.items()}


def _grouped(rows: dict[str, list[str]]) -> list[str]:
    """Faults with the same backends as `fault, fault: backends`."""
    by_backends: dict[str, list[str]] = {}
    for words, names in rows.items():
        by_backends.setdefault(", ".join(names), []).append(words)
    return [f"{', '.join(words)}: {names}" for names, words in by_backends.items()]
