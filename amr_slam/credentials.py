"""A member's folder as ``amr-slam keys`` writes it: what a session shows and what it demands."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

AUTHORITY, CERTIFICATE, KEY, LOGIN = "ca.pem", "cert.pem", "key.pem", "login.json"

_MAX_BYTES: Final = 64 * 1024


class CredentialsError(ValueError):
    """A folder that is none of a member: one line that names it and what is missing."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Credentials:
    """How a session proves who it is."""

    folder: Path
    login: tuple[str, str] | None
    """User and password; None: by certificate."""

    def options(self) -> dict[str, Any]:
        """Zenoh configuration, by path."""
        if self.login is not None:
            user, password = self.login
            return {"transport/auth/usrpwd": {"user": user, "password": password}}
        folder = self.folder.resolve()
        return {
            "transport/link/tls": {
                "root_ca_certificate": str(folder / AUTHORITY),
                "listen_private_key": str(folder / KEY),
                "listen_certificate": str(folder / CERTIFICATE),
                "connect_private_key": str(folder / KEY),
                "connect_certificate": str(folder / CERTIFICATE),
                "enable_mtls": True,
                "verify_name_on_connect": True,
            }
        }


def read_credentials(folder: Path) -> Credentials:
    """Raises CredentialsError when files are missing or cannot be read."""
    if (folder / LOGIN).exists():
        return Credentials(folder=folder, login=_login(folder / LOGIN))
    for name in (AUTHORITY, CERTIFICATE, KEY):
        try:
            with (folder / name).open("rb") as stream:
                stream.read(1)
        except OSError as error:
            raise CredentialsError(
                f"{folder / name}: {error.strerror}: the folder must be one that "
                "'amr-slam keys' has written"
            ) from error
    return Credentials(folder=folder, login=None)


def _login(path: Path) -> tuple[str, str]:
    try:
        with path.open("rb") as stream:
            fields = json.loads(stream.read(_MAX_BYTES))
        user, password = fields["user"], fields["password"]
    except OSError as error:
        raise CredentialsError(f"{path}: {error.strerror}") from error
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise CredentialsError(f"{path}: no user and password in it") from error
    if not (isinstance(user, str) and isinstance(password, str) and user and password):
        raise CredentialsError(f"{path}: no user and password in it")
    return user, password
