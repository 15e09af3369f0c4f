"""What `hexctl keys` does: make certificates and say where they go; show what is there."""

import socket
from pathlib import Path

from hexctl.cli.output import say
from hexctl.errors import InputError
from hexctl.serve.certificates import AUTHORITY_FOLDER, make_certificates
from hexctl.wire.credentials import CERTIFICATE_FILE, common_name, load_certificate
from hexctl.wire.endpoint import Endpoint
from hexctl.wire.role import Role

LOOPBACK = ("localhost", "127.0.0.1", "::1")


def make(folder: Path, *, hosts: list[str], days: int) -> None:
    """Make certificates and say which folder goes where."""
    wanted = hosts or [socket.gethostname()]
    everywhere = [*wanted, *(host for host in LOOPBACK if host not in wanted)]
    make_certificates(folder, hosts=everywhere, days=days)
    for part, use in (
        (Role.ROBOT.value, "to the robot: hexctl serve --listen tls/0.0.0.0:7447 --keys"),
        (
            Role.CONTROLLER.value,
            f"to whoever may command it: --connect {Endpoint('tls', wanted[0], 7447)} --keys",
        ),
        (Role.VIEWER.value, "to whoever may only look"),
        (AUTHORITY_FOLDER, "stays here, out of reach: it can make more of them"),
    ):
        say(f"{folder / part}  {use}")


def show_all(folder: Path) -> None:
    """Print one line for each certificate of a folder.

    Raises InputError for a folder without any.
    """
    places = sorted([*folder.glob(CERTIFICATE_FILE), *folder.glob(f"*/{CERTIFICATE_FILE}")])
    if not places:
        raise InputError(f"{folder}: has no certificates; allowed: a folder that hexctl keys new made")
    for place in places:
        certificate = load_certificate(place)
        until = f"{certificate.not_valid_after_utc:%Y-%m-%d}"
        say(f"{place.parent}: {common_name(certificate)}, until {until}{_hosts_of(place)}")


def _hosts_of(place: Path) -> str:
    """Return for which hosts a certificate is, as the end of a sentence."""
    from cryptography import x509

    try:
        names = load_certificate(place).extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except x509.ExtensionNotFound:
        return ""
    return ", for " + ", ".join(str(name.value) for name in names)
