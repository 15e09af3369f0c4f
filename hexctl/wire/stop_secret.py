"""The secret that signs stop datagrams, in its own file: a stop must not depend on certificates."""

import os
import secrets
from pathlib import Path

from hexctl.errors import InputError
from hexctl.files import read_secret
from hexctl.wire.links import Link, Role

SECRET_FILE = "stop.key"  # noqa: S105  its name

SECRET_BYTES = 32

#: Maximum size of the file: the secret in hexadecimal digits, and white space.
MOST_FILE_BYTES = 4 * SECRET_BYTES

#: Signs datagrams without certificates: anyone who reaches the robot may stop it.
NO_SECRET = b""

HOLDERS = (Role.ROBOT, Role.CONTROLLER)


def write_stop_secret(folder: Path) -> list[Path]:
    """Create a secret in a folder of `hexctl keys new`; return its files.

    Raises InputError if there is one already, if an end is missing, or if the folder is not writable.
    """
    places = [folder / role.value for role in HOLDERS]
    for place in places:
        if not place.is_dir():
            raise InputError(f"{place}: is missing; allowed: a complete folder from hexctl keys new")
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
        for path in written:  # both ends need the same secret
            path.unlink(missing_ok=True)
        raise InputError(f"{folder}: cannot be written ({error.strerror}); allowed: one of yours") from error
    return written


def find_stop_secret(link: Link, role: Role) -> bytes | None:
    """Secret of one end of a link: `NO_SECRET` without certificates, None for a folder without a secret.

    Raises InputError for an invalid file, or one that others may read.
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
