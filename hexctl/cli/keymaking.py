"""What `hexctl keys` does: make certificates and say where they go; renew them; show what is there."""

import socket
from datetime import UTC, datetime
from pathlib import Path

from hexctl.backends.mavlink.codec import write_signing_key
from hexctl.cli.console import print_result
from hexctl.errors import InputError
from hexctl.wire.certificates import (
    AUTHORITY_FOLDER,
    CERTIFICATE_FILE,
    common_name,
    hosts_of,
    load_certificate,
    make_certificates,
    renew_certificates,
)
from hexctl.wire.links import Endpoint, Role

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
        print_result(f"{folder / part}  {use}")


def renew(folder: Path, *, days: int) -> None:
    """Make the certificates of a folder valid anew and say what is to be done with them."""
    renew_certificates(folder, days=days)
    show_all(folder)
    print_result("give each end its folder again; until then the old ones are good for as long as they say")


def make_signing_key(folder: Path) -> None:
    """Make the key that signs MAVLink frames in a folder and say where it goes."""
    path = write_signing_key(folder)
    print_result(f"{path}  to both ends: hexctl serve --device-keys {folder}, hexctl board --keys {folder}")


def show_all(folder: Path) -> None:
    """Print one line for each certificate of a folder.

    Raises InputError for a folder without any.
    """
    places = sorted([*folder.glob(CERTIFICATE_FILE), *folder.glob(f"*/{CERTIFICATE_FILE}")])
    if not places:
        raise InputError(f"{folder}: has no certificates; allowed: a folder that hexctl keys new made")
    now = datetime.now(UTC)
    for place in places:
        certificate = load_certificate(place)
        end = certificate.not_valid_after_utc
        until = f"until {end:%Y-%m-%d}" + (", EXPIRED: hexctl keys renew" if end < now else "")
        hosts = ", ".join(str(name.value) for name in hosts_of(certificate))
        print_result(
            f"{place.parent}: {common_name(certificate)}, {until}" + (f", for {hosts}" if hosts else "")
        )
