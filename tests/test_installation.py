"""tools/install.py with real environments and pip, in a folder instead of a robot's root."""

from __future__ import annotations

import subprocess
import sys
import tomllib
import zipfile
from collections.abc import Mapping
from pathlib import Path

import pytest
from paths import REPO

from amr_slam.installation import InstallError, Machine, install, roll_back, uninstall

WARMING = """
import os, pathlib
pathlib.Path(os.environ["NUMBA_CACHE_DIR"]).mkdir(parents=True)
"""
LINK, UNIT = "opt/amr-slam", "etc/systemd/system/amr-slam@.service"
EXAMPLE = "etc/amr-slam/robot.toml"
RULES = "etc/udev/rules.d/70-amr-slam.rules"
BUS = "etc/systemd/network/80-amr-slam-can.network"


class Quick(Machine):
    """One pip for all environments, instead of one unpacked in each: the commands are the same."""

    def run(self, *command: str | Path, environment: Mapping[str, str] | None = None) -> None:
        words = [str(word) for word in command]
        if "venv" in words:
            words.insert(3, "--without-pip")
        elif "pip" in words:
            words[:4] = [sys.executable, "-m", "pip", "--python", words[0]]
        super().run(*words, environment=environment)


class Robot:
    """A computer in a folder, and versions of a program small enough to install in a test."""

    def __init__(self, folder: Path) -> None:
        self.root = folder / "root"
        self.root.mkdir()
        self.folder = folder
        self.house = folder / "house"
        self.house.mkdir()
        self.lock = folder / "requirements.lock"
        self.lock.write_text("")
        self.said: list[str] = []

    def machine(self, *, dry: bool = False) -> Machine:
        self.said.clear()
        return Quick(root=self.root, dry=dry, say=self.said.append)

    def wheel(self, version: str) -> Path:
        path = self.folder / f"amr_slam-{version}-py3-none-any.whl"
        info, data = f"amr_slam-{version}.dist-info", f"amr_slam-{version}.data/data"
        shipped = {
            "config/robot.toml": "config/robot.toml",
            "udev/70-amr-slam.rules": "config/udev/70-amr-slam.rules",
            "networkd/80-amr-slam-can.network": "config/networkd/80-amr-slam-can.network",
            "systemd/amr-slam@.service": "systemd/amr-slam@.service",
        }
        content = {
            "amr_slam/__init__.py": f"VERSION = {version!r}\n",
            "amr_slam/warming.py": WARMING if version == "1.0" else "",
            f"{info}/METADATA": f"Metadata-Version: 2.1\nName: amr-slam\nVersion: {version}\n",
            f"{info}/WHEEL": "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
        }
        for name, source in shipped.items():
            content[f"{data}/share/amr-slam/{name}"] = (REPO / source).read_text()
        content[f"{info}/RECORD"] = "".join(f"{name},,\n" for name in content)
        with zipfile.ZipFile(path, "w") as archive:
            for name, text in content.items():
                archive.writestr(name, text)
        return path

    def install(self, version: str, *, dry: bool = False) -> None:
        install(self.machine(dry=dry), self.wheel(version), self.lock, self.house)

    def used(self) -> str:
        """What the version in use says that it is."""
        python = str(self.root / LINK / "bin/python")
        asked = [python, "-Ic", "import amr_slam; print(amr_slam.VERSION)"]
        done = subprocess.run(asked, capture_output=True, text=True, check=True)
        return done.stdout.strip()

    def files(self) -> set[str]:
        return {str(path.relative_to(self.root)) for path in self.root.rglob("*")}


@pytest.fixture
def robot(tmp_path: Path) -> Robot:
    return Robot(tmp_path)


def test_an_installation_is_complete_and_the_same_again_changes_nothing(robot: Robot) -> None:
    robot.install("1.0")
    assert robot.used() == "1.0"
    assert (robot.root / UNIT).read_bytes() == (REPO / "systemd/amr-slam@.service").read_bytes()
    assert {EXAMPLE, RULES, BUS, "var/cache/private/amr-slam"} <= robot.files()
    assert (robot.root / "var/cache/private").stat().st_mode & 0o777 == 0o700
    before = robot.files()
    robot.install("1.0")
    assert robot.said == []
    assert robot.files() == before


def test_what_a_robot_has_its_own_values_in_is_never_overwritten(robot: Robot) -> None:
    (robot.root / EXAMPLE).parent.mkdir(parents=True)
    (robot.root / EXAMPLE).write_text("# mine\n")
    robot.install("1.0")
    (robot.root / UNIT).write_text("# from an older version\n")
    robot.install("1.0")
    assert (robot.root / EXAMPLE).read_text() == "# mine\n"
    assert "[Service]" in (robot.root / UNIT).read_text()
    assert any(EXAMPLE in line and line.startswith("keep") for line in robot.said)


def test_an_upgrade_can_be_taken_back_and_old_versions_go(robot: Robot) -> None:
    for version in ("1.0", "1.1", "1.2"):
        robot.install(version)
        assert robot.used() == version
    assert len(list((robot.root / "opt/amr-slam.versions").iterdir())) == 2
    roll_back(robot.machine())
    assert robot.used() == "1.1"
    roll_back(robot.machine())
    assert robot.used() == "1.2"


def test_an_upgrade_that_fails_leaves_what_is_in_use(robot: Robot) -> None:
    robot.install("1.0")
    robot.lock.write_text("no-such-package==1.0 --hash=sha256:" + 64 * "0" + "\n")
    with pytest.raises(InstallError, match="No matching distribution"):
        robot.install("1.1")
    assert robot.used() == "1.0"
    robot.lock.write_text("")
    robot.install("1.1")  # over what was left half-made
    assert robot.used() == "1.1"


def test_there_may_be_nothing_to_go_back_to(robot: Robot) -> None:
    robot.install("1.0")
    with pytest.raises(InstallError, match="no other version"):
        roll_back(robot.machine())


def test_a_dry_run_tells_and_does_nothing(robot: Robot) -> None:
    robot.install("1.0", dry=True)
    told = "\n".join(robot.said)
    assert all(name in told for name in (LINK, UNIT, EXAMPLE, RULES, BUS, "--require-hashes"))
    assert robot.files() == set()
    robot.install("1.0")
    before = robot.files()
    uninstall(robot.machine(dry=True), purge=True)
    assert robot.files() == before


def test_uninstalling_keeps_what_the_robot_has_learned(robot: Robot) -> None:
    robot.install("1.0")
    state = robot.root / "var/lib/private/amr-slam"
    (state / "maps").mkdir(parents=True)
    (state / "maps/hall.amrmap").write_bytes(b"map")
    uninstall(robot.machine(), purge=False)
    left = robot.files()
    assert {"var/lib/private/amr-slam/maps/hall.amrmap", EXAMPLE, RULES, BUS} <= left
    assert not any("opt/amr-slam" in name or name == UNIT or "cache/" in name for name in
                   left - {"var/cache/private"})  # fmt: skip
    robot.install("1.0")
    assert robot.used() == "1.0"
    uninstall(robot.machine(), purge=True)
    assert not {name for name in robot.files() if (robot.root / name).is_file()}


def test_a_folder_where_the_link_belongs_is_left_alone(robot: Robot) -> None:
    (robot.root / LINK / "bin").mkdir(parents=True)
    with pytest.raises(InstallError, match="move it away"):
        robot.install("1.0")
    assert (robot.root / LINK / "bin").is_dir()


def test_what_is_no_wheel_is_refused_in_one_line(robot: Robot) -> None:
    wheel = robot.folder / "amr_slam-1.0-py3-none-any.whl"
    wheel.write_bytes(b"PK")
    with pytest.raises(InstallError, match="no wheel"):
        install(robot.machine(), wheel, robot.lock, robot.house)


def test_the_command_needs_nothing_installed_and_fails_in_one_line(robot: Robot) -> None:
    command = [sys.executable, "-I", str(REPO / "tools/install.py"), "--root", str(robot.root)]
    done = subprocess.run(
        [*command, "--wheel", str(robot.wheel("1.0")), "--dry-run"],
        capture_output=True, text=True, check=True, env={}, cwd="/",
    )  # fmt: skip
    assert "--require-hashes" in done.stdout
    failed = subprocess.run(
        [*command, "--rollback"], capture_output=True, text=True, check=False, env={}, cwd="/"
    )
    assert failed.returncode == 1
    assert failed.stderr.startswith("install: there is no other version")
    assert failed.stderr.count("\n") == 1


def test_the_package_carries_all_that_is_installed() -> None:
    project = tomllib.loads((REPO / "pyproject.toml").read_text())
    patterns = project["tool"]["setuptools"]["data-files"]
    carried = {
        f"{target}/{path.name}"
        for target, sources in patterns.items()
        for source in sources
        for path in REPO.glob(source)
    }
    assert {
        "share/amr-slam/config/robot.toml",
        "share/amr-slam/udev/70-amr-slam.rules",
        "share/amr-slam/networkd/80-amr-slam-can.network",
        "share/amr-slam/systemd/amr-slam@.service",
    } <= carried
