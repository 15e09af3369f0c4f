"""The key that signs MAVLink frames, from a file."""

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
            f"such as head -c {KEY_BYTES} /dev/urandom makes"
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
