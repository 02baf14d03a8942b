"""Who may look and who may command: tokens, the names of this server, and where a page is from.

A browser carries any page's requests to any address it can reach. So each request must name this
server (else a foreign name was bent to its address: DNS rebinding), and whatever a script can send
must come from this server's own page. Tokens go in a header, never in a cookie: no request has the
right by itself.
"""

from __future__ import annotations

import enum
import hashlib
import hmac
import ipaddress
import secrets
import ssl
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from cryptography import x509

from amr_slam.viewing.settings import ViewError, ViewSettings

_MIN_TOKEN: Final = 24
_MAX_TOKEN: Final = 256
_MAX_FILE_BYTES: Final = 64 * 1024
_LOOPBACK_NAMES: Final = ("localhost", "127.0.0.1", "[::1]")


class Right(enum.StrEnum):
    """What a page may do."""

    LOOK = "look"
    COMMAND = "command"
    """And look."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Access:
    """What decides on each request."""

    hosts: frozenset[str] | None
    """Values of ``Host`` that mean this server; None before the port is known."""
    scheme: str
    tokens: Mapping[bytes, Right]
    """By their SHA-256: what is compared tells nothing of a token by the time it takes."""
    open_to_look: bool
    """Nobody needs a token to look: loopback only."""
    allow_commands: bool

    def right_of(self, token: str | None) -> Right | None:
        """None: not even to look."""
        found: Right | None = None
        digest = _digest(token or "")
        for known, right in self.tokens.items():
            if hmac.compare_digest(digest, known):
                found = right
        if found is Right.COMMAND and not self.allow_commands:
            found = Right.LOOK
        return found or (Right.LOOK if self.open_to_look else None)

    def is_ours(self, host: str | None) -> bool:
        """Whether a request's ``Host`` means this server."""
        return self.hosts is not None and host is not None and host.lower() in self.hosts

    def is_our_page(self, origin: str | None, host: str | None) -> bool:
        """Whether a request's ``Origin`` is this server's page, as it came to this ``Host``."""
        return self.is_ours(host) and origin == f"{self.scheme}://{host}"


def read_tokens(path: Path) -> dict[bytes, Right]:
    """A file of lines ``look TOKEN`` or ``command TOKEN``; ``#`` begins a comment. Nobody but its
    owner may read it. Raises ViewError and OSError."""
    if path.stat().st_mode & 0o077:
        raise ViewError(f"{path}: others may read the tokens in it; chmod 600 {path}")
    with path.open("rb") as stream:
        data = stream.read(_MAX_FILE_BYTES + 1)
    if len(data) > _MAX_FILE_BYTES:
        raise ViewError(f"{path}: more than {_MAX_FILE_BYTES} bytes of tokens")
    tokens: dict[bytes, Right] = {}
    for number, line in enumerate(data.decode(errors="replace").splitlines(), 1):
        words = line.partition("#")[0].split()
        if not words:
            continue
        if len(words) != 2 or words[0] not in set(Right):
            raise ViewError(f"{path}:{number}: should be 'look TOKEN' or 'command TOKEN'")
        if not _MIN_TOKEN <= len(words[1]) <= _MAX_TOKEN:
            raise ViewError(
                f"{path}:{number}: a token has {_MIN_TOKEN} to {_MAX_TOKEN} characters; "
                "'openssl rand -hex 24' makes one"
            )
        tokens[_digest(words[1])] = Right(words[0])
    if not tokens:
        raise ViewError(f"{path}: no token in it")
    return tokens


def grant(settings: ViewSettings) -> tuple[Access, str | None]:
    """Access as the settings have it, without the port, and the token that was made for this run
    where commands are allowed and no file of tokens is given. Raises ViewError and OSError."""
    loopback = is_loopback(settings.host)
    if not loopback and (settings.tokens is None or settings.certificate is None):
        raise ViewError(
            f"--host {settings.host}: others than this computer are served with tokens and TLS "
            "only: --tokens FILE --cert FILE --key FILE"
        )
    made: str | None = None
    tokens: dict[bytes, Right] = {}
    if settings.tokens is not None:
        tokens = read_tokens(settings.tokens)
    elif settings.allow_commands:
        made = secrets.token_urlsafe(32)
        tokens = {_digest(made): Right.COMMAND}
    access = Access(
        hosts=None,
        scheme="http" if settings.certificate is None else "https",
        tokens=tokens,
        open_to_look=settings.tokens is None,
        allow_commands=settings.allow_commands,
    )
    return access, made


def names_of(settings: ViewSettings, port: int) -> frozenset[str]:
    """All ``Host`` values that mean this server. Raises ViewError and OSError."""
    names = {bracketed(settings.host)}
    if is_loopback(settings.host):
        names |= set(_LOOPBACK_NAMES)
    if settings.certificate is not None:
        names |= _names_in(settings.certificate)
    standard = 80 if settings.certificate is None else 443
    with_port = {f"{name}:{port}" for name in names}
    return frozenset(with_port | names if port == standard else with_port)


def tls(settings: ViewSettings) -> ssl.SSLContext | None:
    """None without a certificate. Raises ViewError."""
    if (settings.certificate is None) != (settings.key is None):
        raise ViewError("--cert and --key belong together")
    if settings.certificate is None:
        return None
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    try:
        context.load_cert_chain(settings.certificate, settings.key)
    except (OSError, ssl.SSLError) as error:
        raise ViewError(f"{settings.certificate}: no certificate with its key: {error}") from error
    return context


def is_loopback(host: str) -> bool:
    """Whether only this computer reaches an address."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def bracketed(host: str) -> str:
    """As it stands in URLs."""
    return f"[{host}]" if ":" in host else host.lower()


def _names_in(certificate: Path) -> set[str]:
    """The names for which browsers take it."""
    try:
        loaded = x509.load_pem_x509_certificate(certificate.read_bytes())
        named = loaded.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except (ValueError, x509.ExtensionNotFound) as error:
        raise ViewError(f"{certificate}: a certificate without names: {error}") from error
    names = {name.lower() for name in named.get_values_for_type(x509.DNSName)}
    return names | {bracketed(str(ip)) for ip in named.get_values_for_type(x509.IPAddress)}


def _digest(token: str) -> bytes:
    return hashlib.sha256(token.encode(errors="replace")).digest()
