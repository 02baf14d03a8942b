"""A site's folder of keys: members added and removed, everything that follows written anew."""

from __future__ import annotations

import json
import re
import secrets
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Final, Literal

from annotated_types import Interval, Len
from pydantic import BaseModel, ConfigDict, ValidationError

from amr_slam import credentials
from amr_slam.keys.authority import KeyPair, issue, new_authority
from amr_slam.keys.files import MAX_BYTES, KeysError, read, write
from amr_slam.keys.rules import ROUTER, Kind, access_control, member, size_limits
from amr_slam.wire import MAX_MAP_BYTES, MAX_MESSAGE_BYTES

_STATE: Final = "site.json"
_NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")
_PART: Final = re.compile(r"\*\*?|[A-Za-z0-9_.-]+")
_FOLDERS: Final[dict[Kind, str]] = {"robot": "robots", "fleet": "fleet", "camera": "cameras"}
_ROUTER_PORT: Final = 7447
_LEASE_MS: Final = 1000
_QUEUE_BATCHES: Final = 16  # as in robots' and controllers' sessions
_MAX_PASSED_BYTES: Final = MAX_MAP_BYTES + MAX_MESSAGE_BYTES
"""A router puts no more together than the largest map and its attachment."""

Auth = Literal["tls", "password"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Member:
    """A robot, a controller or a camera system of a site."""

    kind: Kind
    name: str
    commands: bool
    """A controller that may call commands."""
    key: str | None
    """A camera system's: what it may publish."""
    folder: Path
    expires: datetime | None
    """None: a password, which does not."""


class _State(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)

    site: str
    prefix: str
    auth: Auth
    router_hosts: Annotated[list[str], Len(1, 64)]
    robots: Annotated[list[str], Len(0, 20_000)] = []
    fleet: Annotated[dict[str, bool], Len(0, 20_000)] = {}
    """Controllers, and whether they may call commands."""
    cameras: Annotated[dict[str, str], Len(0, 1000)] = {}
    """Camera systems, and the key expression of the poses of each."""
    ros2_domain: Annotated[int, Interval(ge=0, le=232)] | None = None
    vda5050: str | None = None


def create(
    folder: Path,
    site: str,
    router_hosts: Sequence[str],
    *,
    prefix: str = "amr",
    auth: Auth = "tls",
    days: int = 730,
) -> Site:
    """A new site in ``folder``, with the router's keys and configuration.

    Raises KeysError when there is one already or a name is none.
    """
    _checked(site)
    if (folder / _STATE).exists():
        raise KeysError(f"{folder}: is a site's folder already; its keys are not made anew")
    state = _State(site=site, prefix=prefix, auth=auth, router_hosts=list(router_hosts))
    made = Site(folder, state)
    if auth == "tls":
        authority = new_authority(site)
        write(folder / "authority" / credentials.KEY, authority.key, private=True)
        write(folder / "authority" / credentials.AUTHORITY, authority.certificate)
        made.renew_router(days)
    made.save()
    return made


def load(folder: Path) -> Site:
    """The site in ``folder``. Raises KeysError: none there, or damaged."""
    path = folder / _STATE
    try:
        with path.open("rb") as stream:
            state = _State.model_validate_json(stream.read(MAX_BYTES))
    except FileNotFoundError as error:
        raise KeysError(f"{folder}: no site's folder; begin with 'amr-slam keys init'") from error
    except OSError as error:
        raise KeysError(f"{path}: {error.strerror}") from error
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        raise KeysError(f"{path}: {first['msg']}") from error
    return Site(folder, state)


class Site:
    """A site as its folder has it. Every change is written at once."""

    def __init__(self, folder: Path, state: _State) -> None:
        self._folder = folder
        self._state = state

    @property
    def name(self) -> str:
        return self._state.site

    @property
    def router_folder(self) -> Path:
        """What the router's machine needs."""
        return self._folder / "router"

    def add_robot(self, name: str, days: int) -> Member:
        """A robot's folder; one that is known gets new keys. Raises KeysError."""
        self._free(name)
        self._issue("robot", name, days)
        if name not in self._state.robots:
            self._state.robots.append(name)
        self.save()
        return self._member("robot", name)

    def add_controller(self, name: str, days: int, *, commands: bool) -> Member:
        """A controller's folder, with or without the right to command. Raises KeysError."""
        self._issue("fleet", name, days)
        self._state.fleet[name] = commands
        self.save()
        return self._member("fleet", name)

    def add_camera(self, name: str, days: int, *, key: str) -> Member:
        """The folder of a camera system, which may publish poses on ``key`` and nothing else, for
        robots in shadow mode to hear. Raises KeysError, also where a key could be a robot's."""
        _checked(name)
        self._state.cameras[name] = self._apart(key)
        self._issue("camera", name, days)
        self.save()
        return self._member("camera", name)

    def revoke(self, kind: Kind, name: str) -> None:
        """From the router's next start on, the member's keys open nothing. Raises KeysError."""
        if kind == "robot" and name in self._state.robots:
            self._state.robots.remove(name)
        elif kind == "fleet" and name in self._state.fleet:
            del self._state.fleet[name]
        elif kind == "camera" and name in self._state.cameras:
            del self._state.cameras[name]
        else:
            raise KeysError(f"{self._folder}: no {kind} is named {name!r}")
        for file in (credentials.KEY, credentials.CERTIFICATE, credentials.LOGIN):
            (self._place(kind, name) / file).unlink(missing_ok=True)
        self.save()

    def allow_ros2(self, domain: int | None) -> None:
        """From the router's next start on, robots may also speak ROS 2 in this domain, each in the
        namespace of its name; None: none may. ``domain``: 0 to 232."""
        self._state.ros2_domain = domain
        self.save()

    def allow_vda5050(self, interface: str | None) -> None:
        """From the router's next start on, robots may also speak VDA 5050 on topics that begin with
        ``interface``, each under its name as serial number; None: none may. Raises KeysError."""
        if interface is not None:
            _checked(interface)
            self._free(interface)
        self._state.vda5050 = interface
        self.save()

    def members(self) -> list[Member]:
        """Robots, controllers, then cameras, by name. Raises KeysError when a file is damaged."""
        return [self._member(kind, name) for kind, name in self._names()]

    def renew_router(self, days: int) -> None:
        """New keys for the router."""
        hosts = list(dict.fromkeys([*self._state.router_hosts, "localhost", "127.0.0.1"]))
        self._write_pair(self.router_folder, ROUTER, hosts, days)

    def save(self) -> None:
        """Write the site's state and the router's configuration."""
        text = self._state.model_dump_json(indent=1) + "\n"
        write(self._folder / _STATE, text.encode())
        settings = json.dumps(self.router_settings(self.router_folder.resolve()), indent=1) + "\n"
        write(self.router_folder / "router.json5", settings.encode())
        if self._state.auth == "password":
            write(self.router_folder / "users.txt", self._users().encode(), private=True)

    def router_settings(self, folder: Path) -> dict[str, object]:
        """zenohd's configuration, for a router that has the router's files in ``folder``."""
        state, tls = self._state, self._state.auth == "tls"
        commanders = [name for name, commands in state.fleet.items() if commands]
        settings: dict[str, object] = {
            "mode": "router",
            "listen": {"endpoints": [f"{'tls' if tls else 'tcp'}/[::]:{_ROUTER_PORT}"]},
            "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
            "access_control": access_control(
                state.prefix,
                state.robots,
                commanders,
                [name for name in state.fleet if name not in commanders],
                by="cert_common_names" if tls else "usernames",
                ros2_domain=state.ros2_domain,
                vda5050=state.vda5050,
                cameras=state.cameras,
            ),
            "low_pass_filter": size_limits(
                state.prefix, MAX_MESSAGE_BYTES, ros2=state.ros2_domain is not None
            ),
        }
        link: dict[str, object] = {
            "rx": {"max_message_size": _MAX_PASSED_BYTES},
            # Robots see by it that the router hangs, and lose nothing when its machine is busy.
            "tx": {"lease": _LEASE_MS, "queue": {"size": {"real_time": _QUEUE_BATCHES}}},
        }
        transport: dict[str, object] = {"link": link}
        if tls:
            own = credentials.Credentials(folder=folder, login=None)
            link["tls"] = own.options()["transport/link/tls"]
        else:
            dictionary = str(folder / "users.txt")
            transport["auth"] = {"usrpwd": {"dictionary_file": dictionary}}
        return settings | {"transport": transport}

    def _names(self) -> list[tuple[Kind, str]]:
        return [
            *(("robot", name) for name in sorted(self._state.robots)),
            *(("fleet", name) for name in sorted(self._state.fleet)),
            *(("camera", name) for name in sorted(self._state.cameras)),
        ]

    def _apart(self, key: str) -> str:
        """A camera system's key expression: its first part is its own, so that no robot's key,
        in whatever form robots speak, ever lies within."""
        parts = key.split("/")
        theirs = {self._state.prefix.split("/")[0], self._state.vda5050, *self._state.robots}
        if len(key) > 256 or not all(_PART.fullmatch(part) for part in parts):
            raise KeysError(f"{key!r}: no key expression such as cameras/*/pose")
        if not _NAME.fullmatch(parts[0]) or parts[0].isdigit() or parts[0] in theirs:
            raise KeysError(
                f"{key!r}: should begin with a word of its own; robots speak under {parts[0]!r}"
            )
        return key

    def _free(self, word: str) -> None:
        """Raises KeysError where robots are to speak under a word that is a camera system's."""
        for name, key in self._state.cameras.items():
            if key.split("/")[0] == word:
                raise KeysError(f"{word!r}: camera {name} speaks under it, on {key}")

    def _issue(self, kind: Kind, name: str, days: int) -> None:
        _checked(name)
        common_name = member(kind, name)
        place = self._place(kind, name)
        if self._state.auth == "tls":
            self._write_pair(place, common_name, [common_name, "localhost", "127.0.0.1"], days)
        else:
            login = {"user": common_name, "password": secrets.token_urlsafe(24)}
            write(place / credentials.LOGIN, json.dumps(login).encode(), private=True)

    def _write_pair(self, place: Path, name: str, hosts: Sequence[str], days: int) -> None:
        authority = self._authority()
        try:
            pair = issue(authority, name, hosts, days)
        except ValueError as error:
            raise KeysError(f"{self._folder / 'authority'}: damaged: {error}") from error
        write(place / credentials.KEY, pair.key, private=True)
        write(place / credentials.CERTIFICATE, pair.certificate)
        write(place / credentials.AUTHORITY, authority.certificate)

    def _authority(self) -> KeyPair:
        place = self._folder / "authority"
        return KeyPair(
            key=read(place / credentials.KEY), certificate=read(place / credentials.AUTHORITY)
        )

    def _place(self, kind: Kind, name: str) -> Path:
        return self._folder / _FOLDERS[kind] / name

    def _member(self, kind: Kind, name: str) -> Member:
        place = self._place(kind, name)
        expires = None
        if self._state.auth == "tls":
            path = place / credentials.CERTIFICATE
            try:
                expires = KeyPair(key=b"", certificate=read(path)).expires
            except ValueError as error:
                raise KeysError(f"{path}: no certificate in it") from error
        return Member(
            kind=kind,
            name=name,
            commands=self._state.fleet.get(name, False) if kind == "fleet" else False,
            key=self._state.cameras.get(name) if kind == "camera" else None,
            folder=place,
            expires=expires,
        )

    def _users(self) -> str:
        lines = []
        for kind, name in self._names():
            login = credentials.read_credentials(self._place(kind, name)).login
            assert login is not None
            lines.append(f"{login[0]}:{login[1]}\n")
        return "".join(lines)


def expires_soon(member: Member, now: datetime | None = None) -> bool:
    """Whether it is time for new keys: less than 60 days left."""
    now = now or datetime.now(UTC)
    return member.expires is not None and (member.expires - now).days < 60


def _checked(name: str) -> None:
    if not _NAME.fullmatch(name):
        raise KeysError(f"{name!r}: should be 1 to 64 letters, digits, '_', '-' or '.'")
