"""The server's certificate: somebody's own, or a self-signed one that is made at the first start and kept."""

from __future__ import annotations

import datetime
import ipaddress
import os
import socket
import ssl
from pathlib import Path

from synchronizar.errors import InputError, os_faults

_DAYS = 5 * 365
_RENEW_DAYS = 30


def state_folder() -> Path:
    """Where this user's certificate and the rooms' secrets are kept: XDG's state folder."""
    base = os.environ.get("XDG_STATE_HOME") or str(Path.home() / ".local" / "state")
    return Path(base) / "synchronizar"


def own_addresses() -> list[str]:
    """Addresses of this machine in its networks, the one that leads out first; nothing is sent to find them."""
    found = []
    for family, far in ((socket.AF_INET, "192.0.2.1"), (socket.AF_INET6, "2001:db8::1")):
        with socket.socket(family, socket.SOCK_DGRAM) as probe:
            try:
                probe.connect((far, 9))
                found.append(str(probe.getsockname()[0]))
            except OSError:
                continue
    return found or ["127.0.0.1"]


def server_context(certificate: Path | None) -> tuple[ssl.SSLContext, bytes]:
    """The context to serve with, and the certificate in DER. `certificate`: a PEM file with chain and key; None: own.

    Raises InputError where the file is none.
    """
    path = certificate or _own_certificate()
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    try:
        context.load_cert_chain(path)
        der = ssl.PEM_cert_to_DER_cert(_first_certificate(path))
    except (OSError, ssl.SSLError, ValueError) as error:
        raise InputError(path, f"is no PEM file with a certificate and its key: {error}") from error
    return context, der


def _first_certificate(path: Path) -> str:
    text = path.read_text(encoding="ascii")
    begin, end = "-----BEGIN CERTIFICATE-----", "-----END CERTIFICATE-----"
    if begin not in text or end not in text:
        raise ValueError("there is no certificate in it")
    return text[text.index(begin) : text.index(end) + len(end)] + "\n"


def _own_certificate() -> Path:
    path = state_folder() / "certificate.pem"
    if not _still_good(path):
        with os_faults(path):
            path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
            path.touch(mode=0o600)
            path.chmod(0o600)
            path.write_bytes(make_certificate(_DAYS)[0])
    return path


def _still_good(path: Path) -> bool:
    """Whether it is there, names all present addresses, and holds for a while."""
    from cryptography import x509

    try:
        certificate = x509.load_pem_x509_certificate(path.read_bytes())
        names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        named = {str(address) for address in names.get_values_for_type(x509.IPAddress)}
    except (OSError, ValueError, x509.ExtensionNotFound):
        return False
    left = certificate.not_valid_after_utc - datetime.datetime.now(datetime.UTC)
    return left.days > _RENEW_DAYS and named.issuperset(own_addresses())


def make_certificate(days: int) -> tuple[bytes, bytes]:
    """A self-signed certificate with its key in PEM, and the certificate alone in DER; it names all own addresses."""
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec
    from cryptography.x509.oid import NameOID

    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, f"synchronizar on {socket.gethostname()}"[:64])])
    addresses = {*own_addresses(), "127.0.0.1", "::1"}
    names: list[x509.GeneralName] = [x509.DNSName("localhost"), x509.DNSName(f"{socket.gethostname()}.local")]
    names += [x509.IPAddress(ipaddress.ip_address(address)) for address in sorted(addresses)]
    now = datetime.datetime.now(datetime.UTC)
    certificate = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - datetime.timedelta(hours=1))
        .not_valid_after(now + datetime.timedelta(days=days))
        .add_extension(x509.SubjectAlternativeName(names), critical=False)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .sign(key, hashes.SHA256())
    )
    private = key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    shown = certificate.public_bytes(serialization.Encoding.PEM)
    return private + shown, certificate.public_bytes(serialization.Encoding.DER)
