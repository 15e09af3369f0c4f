"""Opens the input devices of a drive from its options."""

import sys
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

from hexctl.errors import InputError
from hexctl.options import flag_name
from hexctl.teleop.drive_options import DriveOptions

if TYPE_CHECKING:
    from hexctl.teleop.drive_page import DrivePage
    from hexctl.teleop.drive_session import Device, DriveSession
    from hexctl.wire.certificates import Credentials


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


def _page(stack: ExitStack, session: "DriveSession", address: str, options: DriveOptions) -> "DrivePage":
    from hexctl.teleop.drive_page import DrivePage
    from hexctl.teleop.picture_relay import PictureRelay
    from hexctl.wire.page_address import PageAddress

    view, folder = options.page_view, options.page_keys
    return DrivePage(
        PageAddress.parse(address),
        session.drive.arbiter.source("page"),
        session.drive.share,
        session.ask,
        credentials=None if folder is None else _credentials(folder),
        pictures=None if view is None else stack.enter_context(PictureRelay(view)),
    )


def _credentials(folder: Path) -> "Credentials":
    from hexctl.wire.certificates import find_credentials
    from hexctl.wire.links import Role

    try:
        return find_credentials(folder, Role.ROBOT)
    except InputError as error:
        flags = {"credentials": "keys"}
        raise InputError(error.worded(lambda name: f"--page-{flags.get(name, flag_name(name))}")) from error
