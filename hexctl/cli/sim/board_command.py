"""`hexctl sim board`: a servo board that speaks MAVLink, with a simulated robot on it."""

import json
from typing import TYPE_CHECKING, Any

from hexctl.cli.output_options import JsonOption
from hexctl.cli.signature import with_options
from hexctl.simulators.board_service import BoardService

if TYPE_CHECKING:
    from hexctl.server.service import ServiceStarted


@with_options(BoardService, but=("link",), rare=("world", "failed_leg", "pty"))
def board(asked: dict[str, Any], as_json: JsonOption = False) -> None:
    """Simulate a servo board that speaks MAVLink 2, or servos on a bus.

    It runs until Ctrl-C. hexctl run --backend mavlink walks its simulated robot, and hexctl run --backend
    feetech --connect PORT that behind servos on a bus.
    """
    from hexctl.cli.console import StopOnInterrupt, print_note, print_result

    bus = asked["bus"]
    service = BoardService(**asked)

    def on_started(started: "ServiceStarted") -> None:
        robot = f"{started.robot} ({started.backend})"
        if bus is None:
            guarded = "signed frames only" if service.signed else "not signed"
            print_note(f"board of {robot} at {started.place}, {guarded}; Ctrl-C ends it")
        else:
            line = started.place + (f", {service.bits_per_s} baud" if service.bits_per_s else "")
            print_note(f"bus of {robot} with {bus} servos at {line}; Ctrl-C ends it")

    with StopOnInterrupt() as interrupt:
        report = service.run(interrupt.requested, on_started=on_started)
    if as_json:
        print_result(json.dumps(report))
