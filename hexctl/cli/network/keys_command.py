"""`hexctl keys`: certificates for links beyond this computer, and the key of a servo board."""

from pathlib import Path
from typing import Annotated, Any

import typer

from hexctl.cli.console import print_result
from hexctl.cli.settings import Commands
from hexctl.cli.signature import with_options
from hexctl.wire.certificates import (
    AUTHORITY_FOLDER,
    CertificateOptions,
    hosts_of_this_computer,
    list_certificates,
    make_certificates,
    renew_certificates,
)
from hexctl.wire.links import Endpoint, Role
from hexctl.wire.stop_datagram import write_stop_secret

keys = Commands()

FolderArgument = Annotated[Path, typer.Argument(metavar="FOLDER", help="Folder of the certificates.")]


@keys.command()
@with_options(CertificateOptions)
def new(options: dict[str, Any], folder: FolderArgument = Path("keys")) -> None:
    """Make an authority, and certificates for a robot, its controllers and its viewers."""
    hosts = hosts_of_this_computer(options["hosts"])
    make_certificates(folder, hosts=hosts, days=options["days"])
    reached = Endpoint("tls", hosts[0], 7447)
    for part, use in (
        (Role.ROBOT.value, "to the robot: hexctl serve --listen tls/0.0.0.0:7447 --keys"),
        (Role.CONTROLLER.value, f"to clients that may command it: --connect {reached} --keys"),
        (Role.VIEWER.value, "to clients that may only view it"),
        (AUTHORITY_FOLDER, "stays here, out of reach: it can make more of them"),
    ):
        print_result(f"{folder / part}  {use}")


@keys.command()
@with_options(CertificateOptions, but=("hosts",))
def renew(options: dict[str, Any], folder: FolderArgument = Path("keys")) -> None:
    """Renew the certificates of a folder, for the same hosts; needs the folder's authority."""
    renew_certificates(folder, **options)
    _show(folder)
    print_result("copy its new folder to each end; until then the old certificates stay valid to their date")


@keys.command()
def stop(folder: FolderArgument = Path("keys")) -> None:
    """Make stop.key, the secret of the datagram stop, for certificates made without it."""
    for path in write_stop_secret(folder):
        print_result(f"{path}  to its end, next to key.pem; robots are then stopped by datagram too")


@keys.command()
def mavlink(folder: FolderArgument = Path("keys")) -> None:
    """Make mavlink.key, the secret that lets a servo board and its controller sign their frames."""
    from hexctl.backends.mavlink.codec import write_signing_key

    path = write_signing_key(folder)
    print_result(
        f"{path}  to both ends: hexctl serve --device-keys {folder}, hexctl sim board --keys {folder}"
    )


@keys.command()
def show(folder: FolderArgument = Path("keys")) -> None:
    """Show whose certificates a folder holds, for which hosts, and until when."""
    _show(folder)


def _show(folder: Path) -> None:
    for certificate in list_certificates(folder):
        expired = ", EXPIRED: hexctl keys renew" if certificate.expired else ""
        hosts = f", for {', '.join(certificate.hosts)}" if certificate.hosts else ""
        until = f"until {certificate.valid_until:%Y-%m-%d}"
        print_result(f"{certificate.folder}: {certificate.name}, {until}{expired}{hosts}")
