"""What `hexctl board` does with its options: check, open, serve until told to stop."""

import json
from dataclasses import dataclass
from pathlib import Path

from hexctl.backends.clock import request_realtime_priority
from hexctl.backends.mavlink.codec import read_signing_key
from hexctl.backends.mavlink.transport import (
    DEFAULT_BOARD_PORT,
    Port,
    PortAddress,
    PtyPort,
    check_guarded,
    open_port,
    parse_port,
)
from hexctl.backends.registry import make_servos
from hexctl.cli.console import DONE, StopOnInterrupt, print_note, print_result
from hexctl.cli.twin import Twin
from hexctl.errors import InputError
from hexctl.serve.servo_board import ServoBoard

BACKENDS = ("sim", "mock")
MIN_EXPIRY_S, MAX_EXPIRY_S = 0.05, 1.0
MIN_RELEASE_S, MAX_RELEASE_S = 1.0, 3600.0


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardRequest:
    """The options of `hexctl board` as values."""

    port: str | None
    pty: bool
    twin: Twin
    expiry_s: float
    release_after_s: float
    keys: Path | None
    insecure: bool
    as_json: bool


def execute(request: BoardRequest) -> int:
    """Be a board as requested until interrupted, and return the exit code."""
    address = _check(request)
    key = read_signing_key(request.keys)
    options = request.twin.options()
    servo_map = options.servo_map
    servos = make_servos(request.twin.backend, options)
    port, place = _open(request, address)
    board = ServoBoard(
        servos,
        servo_map,
        port,
        signing_key=key,
        expiry_s=request.expiry_s,
        release_after_s=request.release_after_s,
    )
    signed = "signed frames only" if key is not None else "not signed"
    greeting = f"board of {servos.robot.name} ({request.twin.backend}) at {place}, {signed}; Ctrl-C ends it"
    with StopOnInterrupt() as interrupt:
        request_realtime_priority()
        board.run(interrupt.requested, ready=lambda: print_note(greeting))
    if request.as_json:
        print_result(json.dumps(board.report()))
    return DONE


def _check(request: BoardRequest) -> PortAddress:
    """Refuse what no board can be, before anything is opened."""
    if request.twin.backend not in BACKENDS:
        raise InputError(f"--backend: got {request.twin.backend}; allowed: {', '.join(BACKENDS)}")
    request.twin.check()
    if request.pty and request.port is not None:
        raise InputError(f"--pty: got --port {request.port} too; allowed: one or the other")
    _check_between("--expiry", request.expiry_s, MIN_EXPIRY_S, MAX_EXPIRY_S)
    _check_between("--release-after", request.release_after_s, MIN_RELEASE_S, MAX_RELEASE_S)
    address = parse_port(request.port or DEFAULT_BOARD_PORT)
    if not request.pty:
        check_guarded(
            address,
            option="--port",
            text=str(request.port),
            signed=request.keys is not None,
            insecure=request.insecure,
        )
    return address


def _check_between(option: str, value: float, lowest: float, highest: float) -> None:
    if not lowest <= value <= highest:  # false for nan too
        raise InputError(f"{option}: got {value:g}; allowed: {lowest:g} to {highest:g} s")


def _open(request: BoardRequest, address: PortAddress) -> tuple[Port, str]:
    """Open the port and say where others find it."""
    if request.pty:
        terminal = PtyPort()
        return terminal, terminal.path
    place = request.port or DEFAULT_BOARD_PORT
    return open_port(address, text=place), place
