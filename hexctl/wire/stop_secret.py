"""The secret with which datagrams of a stop are signed, beside the certificates of a link.

It has a file of its own because it is needed where no certificate is: the datagrams must not depend on what
carries sessions. Viewers have none.
"""

import os
import secrets
import stat
from pathlib import Path

from hexctl.errors import InputError
from hexctl.wire.links import Link, Role

SECRET_FILE = "stop.key"  # noqa: S105  its name

SECRET_BYTES = 32

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
    content = secrets.token_hex(SECRET_BYTES) + "\n"
    try:
        return [_write(place / SECRET_FILE, content) for place in places]
    except OSError as error:
        raise InputError(f"{folder}: cannot be written ({error.strerror}); allowed: one of yours") from error


def find_stop_secret(link: Link, role: Role) -> bytes | None:
    """Secret of one end of a link: `NO_SECRET` without certificates, None for a folder that has none.

    Raises InputError for a file that others may read, or that is no secret.
    """
    if link.credentials is None:
        return NO_SECRET
    for path in (link.credentials / role.value / SECRET_FILE, link.credentials / SECRET_FILE):
        if path.is_file():
            return _read(path)
    return None


def _write(path: Path, content: str) -> Path:
    with open(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="ascii") as file:
        file.write(content)
    return path


def _read(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            mode, text = os.fstat(file.fileno()).st_mode, file.read(4 * SECRET_BYTES)
        secret = bytes.fromhex(text.decode("ascii"))
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: is not a secret ({error}); allowed: one of hexctl keys stop") from error
    if mode & (stat.S_IRWXG | stat.S_IRWXO):
        raise InputError(f"{path}: other users of this computer can read it; chmod 600 {path}")
    if len(secret) != SECRET_BYTES:
        raise InputError(f"{path}: has {len(secret)} bytes; allowed: {SECRET_BYTES}, as of hexctl keys stop")
    return secret
