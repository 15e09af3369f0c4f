"""Certificates of one end of a link: found, and checked before anything is opened."""

import stat
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from hexctl.errors import InputError
from hexctl.wire.role import Role

if TYPE_CHECKING:
    from cryptography.x509 import Certificate

AUTHORITY_FILE, CERTIFICATE_FILE, KEY_FILE = "ca.pem", "certificate.pem", "key.pem"

#: Whose certificate may stand in for a role's own: who may command may also look.
STAND_INS = {Role.VIEWER: (Role.VIEWER, Role.CONTROLLER)}


@dataclass(frozen=True, slots=True)
class Credentials:
    """Paths of PEM files.

    Attributes:
        authority: certificate of the authority that signed both ends'.
        certificate: this end's.
        key: its private key.
    """

    authority: Path
    certificate: Path
    key: Path


def find_credentials(folder: Path, role: Role) -> Credentials:
    """Return the credentials of a role from its own folder, or from the one that `hexctl keys new` made.

    Raises InputError when they are not there, are another role's, expired, or do not belong together.
    """
    roles = STAND_INS.get(role, (role,))
    for place in (*(folder / each.value for each in roles), folder):
        if (place / CERTIFICATE_FILE).is_file():
            found = Credentials(place / AUTHORITY_FILE, place / CERTIFICATE_FILE, place / KEY_FILE)
            _check(found, roles)
            return found
    raise InputError(
        f"--keys: got {folder}, which has no {role.value}/{CERTIFICATE_FILE}; "
        "allowed: a folder that hexctl keys new made"
    )


def load_certificate(path: Path) -> "Certificate":
    """Return the certificate of a PEM file.

    Raises InputError for a file that is none.
    """
    from cryptography.x509 import load_pem_x509_certificate

    try:
        return load_pem_x509_certificate(path.read_bytes())
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: is no certificate ({error}); allowed: a PEM file") from error


def common_name(certificate: "Certificate") -> str:
    """Return the common name of whom a certificate is for, empty without one."""
    from cryptography.x509.oid import NameOID

    names = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    return str(names[0].value) if names else ""


def _check(found: Credentials, roles: tuple[Role, ...]) -> None:
    """Refuse what the other end would refuse too, but without saying why."""
    from cryptography.exceptions import InvalidSignature

    certificate, authority = load_certificate(found.certificate), load_certificate(found.authority)
    name = common_name(certificate)
    if name not in [role.value for role in roles]:
        allowed = " or ".join(role.value for role in roles)
        raise InputError(f"{found.certificate}: is for {name!r}; allowed here: {allowed}")
    now = datetime.now(UTC)
    if not certificate.not_valid_before_utc <= now <= certificate.not_valid_after_utc:
        raise InputError(
            f"{found.certificate}: is valid from {certificate.not_valid_before_utc:%Y-%m-%d} to "
            f"{certificate.not_valid_after_utc:%Y-%m-%d}, and now it is {now:%Y-%m-%d}; "
            "see to this computer's clock, or make new ones with hexctl keys new"
        )
    try:
        certificate.verify_directly_issued_by(authority)
    except (InvalidSignature, ValueError, TypeError) as error:
        raise InputError(f"{found.certificate}: was not signed by {found.authority}") from error
    _check_key(found, certificate)


def _check_key(found: Credentials, certificate: "Certificate") -> None:
    from cryptography.hazmat.primitives.serialization import load_pem_private_key

    try:
        readable_by_all = found.key.stat().st_mode & stat.S_IROTH
        key = load_pem_private_key(found.key.read_bytes(), password=None)
    except (OSError, ValueError, TypeError) as error:
        raise InputError(f"{found.key}: is no private key ({error}); allowed: a PEM file") from error
    if readable_by_all:
        raise InputError(f"{found.key}: everybody on this computer can read it; chmod 600 {found.key}")
    if key.public_key() != certificate.public_key():
        raise InputError(f"{found.key}: does not belong to {found.certificate}")
