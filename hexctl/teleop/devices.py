"""Opens the input devices of a drive from its options."""

import sys
from collections.abc import Callable
from contextlib import ExitStack
from typing import TYPE_CHECKING

from hexctl.teleop.drive_options import DriveOptions

if TYPE_CHECKING:
    from hexctl.teleop.control_page import ControlPage
    from hexctl.teleop.drive_session import Device, DriveSession


def open_devices(
    stack: ExitStack,
    session: "DriveSession",
    options: DriveOptions,
    *,
    terminal: bool,
    say: Callable[[str], None],
) -> "list[Device]":
    """Open the input devices; `stack` closes them, `say` takes a line about each.

    Raises InputError for certificates of a page that cannot be used, RobotFaultError for an address in use.
    """
    from hexctl.teleop.gamepad import Gamepad, undrivable_pads
    from hexctl.teleop.keyboard import HELP, Keyboard, KeyTerminal

    drive, devices = session.drive, list["Device"]()
    if options.page is not None:
        page = stack.enter_context(_page(stack, session, options.page, options))
        devices.append(page)
        token = "" if page.token is None else f" with the token {page.token}"
        say(f"hexctl: drive on {page.url}{token}")
    if options.gamepad != "none":
        if options.pad is not None and not options.pad.exists():
            say(f"hexctl: no gamepad at {options.pad} yet; it may be plugged in at any time")
        if options.pad is None:
            for path, lack in undrivable_pads().items():
                say(f"hexctl: {path}: {lack}; it can stop the robot with `hexctl estop --ready`")
        pad = Gamepad(
            drive.arbiter.source("gamepad"), drive.share, session.ask, session.lean, path=options.pad
        )
        stack.callback(pad.close)
        devices.append(pad)
    if options.keyboard and terminal:
        say(HELP)
        keys = stack.enter_context(KeyTerminal(sys.stdin.fileno(), sys.stderr.fileno()))
        source = drive.arbiter.source("keyboard")
        devices.append(Keyboard(source, drive.share, session.ask, keys.keys, keys.show))
    return devices


def _page(stack: ExitStack, session: "DriveSession", address: str, options: DriveOptions) -> "ControlPage":
    from hexctl.teleop.control_page import ControlPage, page_html
    from hexctl.teleop.picture_relay import PictureRelay
    from hexctl.wire.page_address import PageAddress

    view = options.page_view
    return ControlPage(
        PageAddress.parse(address),
        page_html("drive"),
        session.drive.arbiter.source("page"),
        session.drive.share,
        session.ask,
        credentials=options.page_credentials,
        pictures=None if view is None else stack.enter_context(PictureRelay(view)),
    )
