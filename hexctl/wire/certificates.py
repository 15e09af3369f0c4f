"""Certificates of both ends of a link: created, renewed, found and checked before a session opens."""

import ipaddress
import secrets
import socket
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Annotated

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.types import CertificatePublicKeyTypes, PrivateKeyTypes
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    load_pem_private_key,
)
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from hexctl.errors import InputError, argument
from hexctl.files import atomic_write, is_file, read_file, read_secret
from hexctl.options import Range, Typed
from hexctl.scratch import scratch_folder
from hexctl.wire.links import Role
from hexctl.wire.stop_datagram import write_stop_secret

AUTHORITY_FILE, CERTIFICATE_FILE, KEY_FILE = "ca.pem", "certificate.pem", "key.pem"

#: Maximum size of a certificate or a key.
MOST_BYTES = 1_000_000

#: Roles with the certificates that they accept: a controller may also view.
STAND_INS = {Role.VIEWER: (Role.VIEWER, Role.CONTROLLER)}


@dataclass(frozen=True, slots=True)
class Credentials:
    """PEM files of one end of a link: certificate of the authority, own certificate, private key."""

    authority: Path
    certificate: Path
    key: Path


def find_credentials(folder: Path, role: Role) -> Credentials:
    """Credentials of a role from its own folder, or from a folder of `hexctl keys new`.

    Raises InputError if they are missing, another role's, expired, or do not belong together.
    """
    roles = STAND_INS.get(role, (role,))
    for place in (*(folder / each.value for each in roles), folder):
        if is_file(place / CERTIFICATE_FILE):
            found = Credentials(place / AUTHORITY_FILE, place / CERTIFICATE_FILE, place / KEY_FILE)
            _check(found, roles)
            return found
    raise InputError(
        f"{argument('credentials')}: got {folder}, which has no {role.value}/{CERTIFICATE_FILE}; "
        "allowed: a folder that hexctl keys new made"
    )


def load_certificate(path: Path) -> x509.Certificate:
    """Certificate of a PEM file; raises InputError for any other file."""
    try:
        return x509.load_pem_x509_certificate(read_file(path, MOST_BYTES))
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: is not a certificate ({error}); allowed: a PEM file") from error


def common_name(certificate: x509.Certificate) -> str:
    """Common name of a certificate's subject, empty without one."""
    names = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    return str(names[0].value) if names else ""


def _check(found: Credentials, roles: tuple[Role, ...]) -> None:
    """Raise InputError for files that the other end would refuse without a reason."""
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
    if _private_key(found.key, "a PEM file").public_key() != certificate.public_key():
        raise InputError(f"{found.key}: does not belong to {found.certificate}")


def _private_key(path: Path, allowed: str) -> PrivateKeyTypes:
    """Others than the owner must not have access."""
    try:
        return load_pem_private_key(read_secret(path, MOST_BYTES), password=None)
    except PermissionError as error:
        raise InputError(f"{path}: {error.strerror}") from error
    except (OSError, ValueError, TypeError) as error:
        raise InputError(f"{path}: is not a private key ({error}); allowed: {allowed}") from error


AUTHORITY_FOLDER = "authority"
AUTHORITY_NAME = "hexctl authority"

DAYS = Range(low=1, high=3650, whole=True)

#: Start of validity before now: a robot's computer without a clock battery boots in the past.
HEAD_START = timedelta(days=1)

LOOPBACK = ("localhost", "127.0.0.1", "::1")

Key = ec.EllipticCurvePrivateKey


@dataclass(frozen=True, slots=True)
class _Issuer:
    certificate: x509.Certificate
    key: Key


@dataclass(frozen=True, slots=True, kw_only=True)
class CertificateOptions:
    """Hosts of certificates, and their validity."""

    hosts: Annotated[Sequence[str], Typed(flag="host")] = ()
    """Name or address under which clients reach the robot, repeatable. (default: this computer's name;
    loopback is always in)
    """

    days: Annotated[int, DAYS] = 825
    """Days that the certificates are valid, {}."""


def make_certificates(folder: Path, *, hosts: list[str], days: int) -> None:
    """Create a folder with an authority, and a folder for each role with its certificate and key.

    The folder must not exist, and is created completely or not at all. Robot and controllers also get the
    secret of the datagram stop. Raises InputError for a folder that exists or cannot be made, an invalid
    host, and days out of range.
    """
    DAYS.check(argument("days"), days)
    if folder.exists():
        raise InputError(f"{folder}: is there already; allowed: a new folder, keys are never overwritten")
    names = [_host(host) for host in hosts]
    issuer = _make_authority(days)
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with scratch_folder(folder.parent, folder.name) as half:  # mode 0700
            (half / ".gitignore").write_text("*\n")  # keys do not belong in a repository
            _write(half / AUTHORITY_FOLDER, issuer, issuer.certificate, issuer.key)
            for role in Role:
                key = _new_key()
                _write(half / role.value, issuer, _certify(role, key.public_key(), names, issuer, days), key)
            write_stop_secret(half)
            half.rename(folder)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made ({error.strerror}); allowed: a new folder") from error


def hosts_of_this_computer(hosts: Sequence[str]) -> list[str]:
    """Hosts for a robot's certificate: those given, or this computer's name, and always loopback."""
    wanted = hosts or [socket.gethostname()]
    return [*wanted, *(host for host in LOOPBACK if host not in wanted)]


@dataclass(frozen=True, slots=True, kw_only=True)
class CertificateInfo:
    """A certificate of a role or the authority, with the hosts at which its owner may listen."""

    folder: Path
    name: str
    hosts: tuple[str, ...]
    valid_until: datetime

    @property
    def expired(self) -> bool:
        """Whether its validity has ended."""
        return self.valid_until < datetime.now(UTC)


def list_certificates(folder: Path) -> list[CertificateInfo]:
    """All certificates in a folder and its folders, sorted by path; raises InputError if there are none."""
    places = sorted([*folder.glob(CERTIFICATE_FILE), *folder.glob(f"*/{CERTIFICATE_FILE}")])
    if not places:
        raise InputError(f"{folder}: has no certificates; allowed: a folder that hexctl keys new made")
    return [_info(place) for place in places]


def _info(place: Path) -> CertificateInfo:
    certificate = load_certificate(place)
    return CertificateInfo(
        folder=place.parent,
        name=common_name(certificate),
        hosts=tuple(str(host.value) for host in hosts_of(certificate)),
        valid_until=certificate.not_valid_after_utc,
    )


def renew_certificates(folder: Path, *, days: int) -> None:
    """Renew all certificates of a folder, for the same hosts and with the same private keys.

    Old and new certificates are mutually valid until the old ones expire. Raises InputError for a folder
    without its authority, or one that cannot be written, and for days out of range.
    """
    DAYS.check(argument("days"), days)
    owner = folder / AUTHORITY_FOLDER
    key = _load_key(owner / KEY_FILE)
    authority = load_certificate(owner / CERTIFICATE_FILE)
    issuer = _Issuer(_sign_authority(authority.subject, key, days), key)
    renewed = {owner: issuer.certificate}
    for role in Role:
        place = folder / role.value
        if place.is_dir():
            old = load_certificate(place / CERTIFICATE_FILE)
            renewed[place] = _certify(role, old.public_key(), hosts_of(old), issuer, days)
    try:
        for place, certificate in renewed.items():
            atomic_write(place / CERTIFICATE_FILE, certificate.public_bytes(Encoding.PEM))
            atomic_write(place / AUTHORITY_FILE, issuer.certificate.public_bytes(Encoding.PEM))
    except OSError as error:
        raise InputError(f"{folder}: cannot be written ({error.strerror})") from error


def hosts_of(certificate: x509.Certificate) -> list[x509.GeneralName]:
    """Hosts under which the owner of a certificate may listen."""
    try:
        return list(certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value)
    except x509.ExtensionNotFound:
        return []


def _load_key(path: Path) -> Key:
    key = _private_key(path, "one of hexctl keys new")
    if not isinstance(key, Key):
        raise InputError(f"{path}: is no key of hexctl's kind; allowed: what hexctl keys new made")
    return key


def _write(folder: Path, issuer: _Issuer, certificate: x509.Certificate, key: Key) -> None:
    folder.mkdir(mode=0o700)
    (folder / AUTHORITY_FILE).write_bytes(issuer.certificate.public_bytes(Encoding.PEM))
    (folder / CERTIFICATE_FILE).write_bytes(certificate.public_bytes(Encoding.PEM))
    (folder / KEY_FILE).touch(0o600, exist_ok=False)
    secret = key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    (folder / KEY_FILE).write_bytes(secret)


def _make_authority(days: int) -> _Issuer:
    key = _new_key()
    # Authorities need distinct names: OpenSSL reports a mix of two equal names as a bad signature.
    name = _name(f"{AUTHORITY_NAME} {secrets.token_hex(4)}")
    return _Issuer(_sign_authority(name, key, days), key)


def _sign_authority(name: x509.Name, key: Key, days: int) -> x509.Certificate:
    constraints = x509.BasicConstraints(ca=True, path_length=0)
    return (
        _builder(name, name, key.public_key(), days)
        .add_extension(constraints, critical=True)
        .sign(key, hashes.SHA256())
    )


def _certify(
    role: Role, key: CertificatePublicKeyTypes, hosts: list[x509.GeneralName], issuer: _Issuer, days: int
) -> x509.Certificate:
    """Only a robot's is valid for listening: a client must not be able to pose as the robot."""
    listens = role is Role.ROBOT
    usage = ExtendedKeyUsageOID.SERVER_AUTH if listens else ExtendedKeyUsageOID.CLIENT_AUTH
    builder = (
        _builder(_name(role.value), issuer.certificate.subject, key, days)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(x509.ExtendedKeyUsage([usage]), critical=True)
    )
    if listens and hosts:
        builder = builder.add_extension(x509.SubjectAlternativeName(hosts), critical=False)
    return builder.sign(issuer.key, hashes.SHA256())


def _builder(
    subject: x509.Name, issuer: x509.Name, key: CertificatePublicKeyTypes, days: int
) -> x509.CertificateBuilder:
    now = datetime.now(UTC)
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - HEAD_START)
        .not_valid_after(now + timedelta(days=days))
    )


def _new_key() -> Key:
    return ec.generate_private_key(ec.SECP256R1())


def _name(common_name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common_name)])


def _host(text: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(text))
    except ValueError:
        pass
    if not text or not all(sign.isalnum() or sign in "-._" for sign in text) or not text.isascii():
        raise InputError(
            f"{argument('host')}: got {text!r}; allowed: a name or an address, without protocol and port"
        )
    return x509.DNSName(text)
