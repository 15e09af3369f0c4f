"""The key that signs MAVLink frames, in a file."""

import os
import secrets
from pathlib import Path

from hexctl.errors import InputError

#: Name of the key in the folder that `--keys` names.
KEY_FILE = "mavlink.key"

KEY_BYTES = 32


def read_signing_key(folder: Path | None) -> bytes | None:
    """Return the key in a folder, or None without a folder.

    The file holds 32 bytes, or the 64 hexadecimal digits of them. Raises InputError for anything else.
    """
    if folder is None:
        return None
    path = folder / KEY_FILE
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(
            f"{path}: cannot be read ({error.strerror}); allowed: a file of {KEY_BYTES} random bytes, "
            f"such as hexctl keys mavlink {folder} makes"
        ) from error
    if len(content) == KEY_BYTES:
        return content
    try:
        key = bytes.fromhex(content.decode("ascii"))
    except ValueError:
        key = b""
    if len(key) != KEY_BYTES:
        raise InputError(
            f"{path}: got {len(content)} bytes; allowed: {KEY_BYTES} bytes, or {2 * KEY_BYTES} hexadecimal "
            "digits"
        )
    return key


def write_signing_key(folder: Path) -> Path:
    """Make a new key in a folder, for its owner's eyes only, and return its file.

    Raises InputError where there is one already, or it cannot be written.
    """
    path = folder / KEY_FILE
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except FileExistsError as error:
        raise InputError(f"{path}: is there already; allowed: a folder without one") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be made ({error.strerror}); allowed: a folder of yours") from error
    with open(descriptor, "w", encoding="ascii") as file:
        file.write(secrets.token_hex(KEY_BYTES) + "\n")
    return path
