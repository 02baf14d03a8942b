"""Puts AMR-SLAM on a robot's computer, and takes it away: what ``tools/install.py`` does.

Standard library only: it runs before anything is installed. Each version gets a virtual
environment of its own beside the others, and ``/opt/amr-slam`` is a link to the one in use: an
upgrade that fails half-way changes nothing, and going back is one link.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

PROGRAM: Final = "opt/amr-slam"
"""Link to the version in use."""
VERSIONS: Final = "opt/amr-slam.versions"
STATE: Final = ("var/lib/private/amr-slam", "var/lib/amr-slam")
"""Maps and recordings; the second is systemd's link to the first."""
CACHE: Final = ("var/cache/private/amr-slam", "var/cache/amr-slam")
CONFIGURATION: Final = "etc/amr-slam"
UNIT: Final = "etc/systemd/system/amr-slam@.service"
_SHARED: Final = "share/amr-slam"
"""In a version's environment: what ``pyproject.toml`` names as data files."""
_ADAPTED: Final = {
    "etc/amr-slam/robot.toml": "config/robot.toml",
    "etc/udev/rules.d/70-amr-slam.rules": "udev/70-amr-slam.rules",
    "etc/systemd/network/80-amr-slam-can.network": "networkd/80-amr-slam-can.network",
}
"""What each robot has its own values in: written once, never overwritten."""
_COMPLETE: Final = ".complete"
_KEPT_VERSIONS: Final = 2
"""The one in use and the one before it."""


class InstallError(Exception):
    """Nothing was changed that is in use; one line says why."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Machine:
    """Where to install, and how to do what cannot be undone by deleting a file."""

    root: Path
    """``/`` on a robot. Elsewhere only files are written: no running system is told of them."""
    dry: bool = False
    """Say what would be done and do nothing."""
    say: Callable[[str], object]
    """Takes one line for each thing that is done."""

    @property
    def is_running(self) -> bool:
        """Whether systemd runs here and is to be told."""
        return self.root == Path("/") and Path("/run/systemd/system").is_dir()

    def run(self, *command: str | Path, environment: Mapping[str, str] | None = None) -> None:
        """Raises InstallError with the command's last line where it fails."""
        words = [str(word) for word in command]
        self.say(shlex.join(words))
        if self.dry:
            return
        done = subprocess.run(words, env=environment, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            said = (done.stderr or done.stdout).strip().splitlines()
            reason = said[-1] if said else f"status {done.returncode}"
            raise InstallError(f"{shlex.join(words[:6])} ...: {reason}")

    def copy(self, source: Path, target: Path) -> None:
        """Readable by all, replaced as a whole; nothing where it is the same already."""
        if target.exists() and target.read_bytes() == source.read_bytes():
            return
        self.say(f"write {target}")
        if self.dry:
            return
        target.parent.mkdir(parents=True, exist_ok=True)
        fresh = target.with_name(f".{target.name}.new")
        shutil.copyfile(source, fresh)
        fresh.chmod(0o644)
        fresh.replace(target)

    def link(self, target: Path, name: Path) -> None:
        """Replaced at once: at no instant is there none."""
        self.say(f"link {name} to {target}")
        if self.dry:
            return
        fresh = name.with_name(f".{name.name}.new")
        fresh.unlink(missing_ok=True)
        fresh.symlink_to(os.path.relpath(target, name.parent))
        fresh.replace(name)

    def remove(self, path: Path) -> None:
        if not (path.exists() or path.is_symlink()):
            return
        self.say(f"remove {path}")
        if self.dry:
            return
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink()


def install(machine: Machine, wheel: Path, lock: Path, wheelhouse: Path | None) -> None:
    """Install a version or go over to it; the same again changes nothing.

    ``wheelhouse``: a folder of packages to install from, without any network. Raises InstallError.
    """
    version = machine.root / VERSIONS / _version(wheel, lock)
    program = machine.root / PROGRAM
    if program.exists() and not program.is_symlink():
        raise InstallError(f"{program} is no link of this installer's: move it away first")
    if not (version / _COMPLETE).exists():
        _make_environment(machine, version, wheel, lock, wheelhouse)
    if not program.is_symlink() or program.resolve() != version.resolve():
        machine.link(version, program)
    shared = version / _SHARED
    if machine.dry and not shared.exists():
        machine.say(f"write {machine.root / UNIT} and, where they are not there yet:")
        for name in _ADAPTED:
            machine.say(f"  {machine.root / name}")
    else:
        _put_files(machine, shared)
    _forget_old_versions(machine, version)
    _reload(machine)


def roll_back(machine: Machine) -> None:
    """Go back to the version that was used before. Raises InstallError where there is none."""
    program = machine.root / PROGRAM
    others = [v for v in _versions(machine) if v.resolve() != program.resolve()]
    if not others:
        raise InstallError(f"there is no other version in {machine.root / VERSIONS}")
    machine.link(others[0], program)
    if not machine.dry:
        os.utime(others[0])
    _put_files(machine, others[0] / _SHARED)
    _reload(machine)


def uninstall(machine: Machine, *, purge: bool) -> None:
    """Stop and remove it. Maps, recordings and configuration stay, but with ``purge``."""
    if machine.is_running:
        machine.run("systemctl", "disable", "--now", *_instances(machine))
    for name in (PROGRAM, VERSIONS, UNIT, *CACHE):
        machine.remove(machine.root / name)
    if purge:
        for name in (*_ADAPTED, CONFIGURATION, *STATE):
            machine.remove(machine.root / name)
    else:
        kept = [*_ADAPTED, STATE[0]]
        for path in (machine.root / name for name in kept):
            if path.exists():
                machine.say(f"keep {path} (--purge removes it)")
    _reload(machine)


def wheel_of(sources: Path, into: Path, wheelhouse: Path | None) -> Path:
    """Build the wheel of these sources into a folder. Raises InstallError."""
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", *_offline(wheelhouse)]
    # The sources may be anybody's: their folder is not written to.
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "sources"
        hidden = shutil.ignore_patterns(".*", "out", "build", "*.egg-info")
        shutil.copytree(sources, copy, ignore=hidden)
        silent = Machine(root=Path("/"), say=lambda _: None)
        silent.run(*command, "--wheel-dir", into, copy)
    (wheel,) = into.glob("amr_slam-*.whl")
    return wheel


def _version(wheel: Path, lock: Path) -> str:
    """Named by what is in it: a wheel that is built anew from the same sources is the same."""
    try:
        with zipfile.ZipFile(wheel) as content:
            (record,) = (n for n in content.namelist() if n.endswith(".dist-info/RECORD"))
            listed = sorted(content.read(record).splitlines())
    except (OSError, ValueError, zipfile.BadZipFile) as error:
        raise InstallError(f"{wheel}: no wheel: {error}") from error
    python = f"{sys.version_info.major}.{sys.version_info.minor}".encode()
    digest = hashlib.sha256(b"\n".join([*listed, lock.read_bytes(), python])).hexdigest()
    return f"{wheel.name.split('-')[1]}-{digest[:10]}"


def _make_environment(
    machine: Machine, version: Path, wheel: Path, lock: Path, wheelhouse: Path | None
) -> None:
    machine.remove(version)  # what an installation that was broken off has left
    machine.run(sys.executable, "-m", "venv", version)
    # -I: no module of the folder that this is started in.
    pip = (version / "bin/python", "-I", "-m", "pip", "--disable-pip-version-check", "install")
    quiet = ("--quiet", *_offline(wheelhouse))
    machine.run(*pip, *quiet, "--require-hashes", "-r", lock)
    machine.run(*pip, *quiet, "--no-deps", wheel)
    # Where the service will look for it; systemd gives the folder to the service's user.
    cache = machine.root / CACHE[0]
    machine.say(f"compile into {cache}")
    if machine.dry:
        return
    private = cache.parent
    private.mkdir(parents=True, exist_ok=True)
    private.chmod(0o700)
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(cache)}
    machine.run(version / "bin/python", "-I", "-m", "amr_slam.warming", environment=environment)
    (version / _COMPLETE).touch()


def _put_files(machine: Machine, shared: Path) -> None:
    machine.copy(shared / "systemd/amr-slam@.service", machine.root / UNIT)
    for name, source in _ADAPTED.items():
        target = machine.root / name
        if not target.exists():
            machine.copy(shared / source, target)
        elif target.read_bytes() != (shared / source).read_bytes():
            machine.say(f"keep {target} (it differs from {shared / source})")


def _versions(machine: Machine) -> list[Path]:
    """The complete ones, those last used first."""
    marks = (machine.root / VERSIONS).glob(f"*/{_COMPLETE}")
    return sorted((mark.parent for mark in marks), key=_used_ns, reverse=True)


def _used_ns(version: Path) -> int:
    return version.stat().st_mtime_ns


def _forget_old_versions(machine: Machine, used: Path) -> None:
    if not machine.dry:
        os.utime(used)
    for version in _versions(machine)[_KEPT_VERSIONS:]:
        machine.remove(version)


def _reload(machine: Machine) -> None:
    """A robot that drives is not restarted: that is said, not done."""
    if not machine.is_running:
        return
    machine.run("systemctl", "daemon-reload")
    with contextlib.suppress(FileNotFoundError):  # a container without udev
        machine.run("udevadm", "control", "--reload")
        machine.run("udevadm", "trigger", "--subsystem-match=tty", "--action=add")


def _instances(machine: Machine) -> Iterable[str]:
    """Units to disable: those whose configuration is there, and any that runs."""
    names = sorted(p.stem for p in (machine.root / CONFIGURATION).glob("*.toml"))
    return [f"amr-slam@{name}.service" for name in names] or ["amr-slam@robot.service"]


def _offline(wheelhouse: Path | None) -> tuple[str, ...]:
    return () if wheelhouse is None else ("--no-index", "--find-links", str(wheelhouse))
