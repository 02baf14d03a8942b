"""The system test: a robot's computer in qemu, with a real kernel and systemd, is mistreated.

    PYTHONPATH=tests python -m system [--only NAME ...] [--cuts 20] [--write]

``make system-test`` installs what is needed and calls this. Makes the image in out/system-test
first, where it is not there or the sources have changed. Status 1 if a case is not met.
"""

from __future__ import annotations

import argparse
import hashlib
import subprocess
import sys
import time
from pathlib import Path

from system.cases import CASES, NotMetError
from system.drive import record
from system.machine import Machine, MachineError, missing
from system.power_cut import cut_power
from system.robot import Robot

from amr_slam.installation import wheel_of

REPO = Path(__file__).resolve().parent.parent.parent
HERE = Path(__file__).resolve().parent
PAGE = REPO / "docs/system-test.md"
_MARK = "<!-- the table: make system-test ARGS=--write -->"
_DRIVE_S = 1200.0
POWER = "power"


def main() -> int:
    """Parse, make the image, run, print the table."""
    arguments = _parser().parse_args()
    lacking = missing()
    if lacking is not None:
        print(f"system test: {lacking}", file=sys.stderr)
        return 1
    out = arguments.out.absolute()
    make_image(out)
    wanted = arguments.only or [case.name for case in CASES] + [POWER]
    rows = []
    if set(wanted) - {POWER}:
        rows += run_cases(out, wanted, arguments.accelerator)
    if POWER in wanted:
        told = cut_power(out, out / "power", arguments.cuts, arguments.accelerator)
        met = told.startswith(f"{arguments.cuts} of")
        rows.append(_row("power cut while a map is saved: a whole map", told, met=met))
    text = "\n".join(["| case | must | measured | result |", "|---|---|---|---|", *rows])
    print(text)
    if arguments.write:
        before = PAGE.read_text(encoding="utf-8").split(_MARK)
        PAGE.write_text(f"{before[0]}{_MARK}\n{text}\n{_MARK}{before[2]}", encoding="utf-8")
    return 0 if all(row.endswith("| met |") for row in rows) else 1


def run_cases(out: Path, wanted: list[str], accelerator: str) -> list[str]:
    """One row for each case; a machine that fails ends it there."""
    rows = []
    with Machine(out, out / "run", accelerator=accelerator) as machine:
        robot = Robot(machine, out / "drive.bin")
        robot.configure()
        robot.power_on()
        for case in CASES:
            # The others need a robot that is localized.
            if case.name not in wanted and case.name != "start":
                continue
            began_s = time.monotonic()
            try:
                measured, met = case.run(robot), True
            except NotMetError as reason:
                measured, met = str(reason), False
            except MachineError as error:
                measured, met = f"the test itself failed: {error}"[:300], False
            rows.append(_row(f"{case.name} | {case.must}", measured, met=met))
            print(f"{rows[-1]} ({time.monotonic() - began_s:.0f} s)", flush=True)
    return rows


def make_image(out: Path) -> None:
    """Anew where anything that is in it has changed. Raises CalledProcessError."""
    out.mkdir(parents=True, exist_ok=True)
    stamp, digest = out / "image.sha256", _digest()
    if stamp.exists() and stamp.read_text() == digest:
        return
    stamp.unlink(missing_ok=True)
    house, drive, lap = out / "wheelhouse", out / "drive.bin", out / "lap.mcap"
    python, lock = sys.executable, REPO / "requirements.lock"
    download = (python, "-m", "pip", "download", "-q", "--require-hashes", "-r", lock, "-d", house)
    _run(*download)
    for old in out.glob("amr_slam-*.whl"):
        old.unlink()
    wheel = wheel_of(REPO, out, None)
    record(drive, _DRIVE_S)
    _run(python, REPO / "tools/simulate.py", "--seed", "7", "--out", lap)
    replay = (python, "-m", "amr_slam", "replay", lap, "--config", REPO / "config/demo.toml")
    _run(*replay, "--map-out", out / "hall.amrmap")
    _run("bash", HERE / "image.sh", out, wheel, house, out / "hall.amrmap")
    stamp.write_text(digest)


def _digest() -> str:
    sources = [REPO / "requirements.lock", REPO / "pyproject.toml", REPO / "tools/install.py"]
    for folder in ("amr_slam", "drivers", "config", "systemd", "tests/system"):
        sources += sorted(p for p in (REPO / folder).rglob("*") if p.is_file())
    digest = hashlib.sha256()
    for path in sources:
        if "__pycache__" not in path.parts and "egg-info" not in str(path):
            digest.update(f"{path.relative_to(REPO)}\n".encode() + path.read_bytes())
    return digest.hexdigest()


def _row(what: str, measured: str, *, met: bool) -> str:
    name, _, must = what.partition(" | ")
    told = " ".join(measured.replace("|", "/").split())
    return f"| {name} | {must or name} | {told} | {'met' if met else '**not met**'} |"


def _run(*command: str | Path) -> None:
    subprocess.run(["nice", "-n", "10", *map(str, command)], check=True, stdin=subprocess.DEVNULL)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    names = [case.name for case in CASES] + [POWER]
    add = parser.add_argument
    add("--only", nargs="+", choices=names, metavar="CASE", help=", ".join(names))
    add("--cuts", type=int, default=20, help="of the power")
    add("--accelerator", choices=("tcg", "kvm"), default="tcg", help="kvm: in real time")
    add("--out", type=Path, default=Path("out/system-test"), help="image and disks")
    add("--write", action="store_true", help="put the table into docs/system-test.md")
    return parser


if __name__ == "__main__":
    sys.exit(main())
