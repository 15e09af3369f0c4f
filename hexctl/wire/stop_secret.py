"""The secret with which datagrams of a stop are signed, beside the certificates of a link.

It has a file of its own because it is needed where no certificate is: the datagrams must not depend on what
carries sessions. Viewers have none.
"""

import os
import secrets
from pathlib import Path

from hexctl.errors import InputError
from hexctl.files import read_secret
from hexctl.wire.links import Link, Role

SECRET_FILE = "stop.key"  # noqa: S105  its name

SECRET_BYTES = 32

#: Longest file that is read: the secret in hexadecimal digits, and space around them.
MOST_FILE_BYTES = 4 * SECRET_BYTES

#: Without certificates anybody who reaches the robot may stop it: datagrams are signed with this.
NO_SECRET = b""

#: Ends that have the secret.
HOLDERS = (Role.ROBOT, Role.CONTROLLER)


def write_stop_secret(folder: Path) -> list[Path]:
    """Make a secret for a folder of `hexctl keys new`; the result is its files, readable for the owner only.

    Raises InputError where there is one already, for a folder without both ends, or one that is not writable.
    """
    places = [folder / role.value for role in HOLDERS]
    for place in places:
        if not place.is_dir():
            raise InputError(f"{place}: is missing; allowed: a folder that hexctl keys new made, whole")
        if (place / SECRET_FILE).exists():
            raise InputError(f"{place / SECRET_FILE}: is there already; allowed: a folder without one")
    content, written = secrets.token_hex(SECRET_BYTES) + "\n", list[Path]()
    try:
        for place in places:
            path = place / SECRET_FILE
            descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
            written.append(path)
            with open(descriptor, "w", encoding="ascii") as file:
                file.write(content)
    except OSError as error:
        for path in written:  # one end alone could never agree with the other
            path.unlink(missing_ok=True)
        raise InputError(f"{folder}: cannot be written ({error.strerror}); allowed: one of yours") from error
    return written


def find_stop_secret(link: Link, role: Role) -> bytes | None:
    """Secret of one end of a link: `NO_SECRET` without certificates, None for a folder that has none.

    Raises InputError for a file that others may read, or that is no secret.
    """
    if link.credentials is None:
        return NO_SECRET
    for path in (link.credentials / role.value / SECRET_FILE, link.credentials / SECRET_FILE):
        if os.path.lexists(path):  # a dangling link is a key that cannot be read, not a missing one
            return _read(path)
    return None


def _read(path: Path) -> bytes:
    try:
        secret = bytes.fromhex(read_secret(path, MOST_FILE_BYTES).decode("ascii"))
    except PermissionError as error:
        raise InputError(f"{path}: {error.strerror}") from error
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{path}: is not a secret ({reason}); allowed: one of hexctl keys stop") from error
    if len(secret) != SECRET_BYTES:
        raise InputError(f"{path}: has {len(secret)} bytes; allowed: {SECRET_BYTES}, as of hexctl keys stop")
    return secret
