"""Feed parsers with bytes that nobody sends: guided by coverage, then as many as time allows.

Example: python tools/fuzz.py s300_stream --runs 10000000
A finding goes to out/fuzz/NAME/crash-*, its traceback to standard error; exit status 1.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "tests"), str(ROOT / "drivers"), str(ROOT)]
import fuzzing  # noqa: E402 - lives with the targets, in tests

OUT: Final = ROOT / "out/fuzz"
PARSERS: Final = ("amr_drivers", "amr_slam.recording", "amr_slam.map.file")
"""What is instrumented; all else would only be slower."""


def main() -> int:
    """Fuzz the targets, as many at once as there are processors."""
    arguments = _parser().parse_args()
    if arguments.phase == "guided":
        return guided(arguments.targets[0], arguments.guided)
    if arguments.phase == "blind":
        return blind(arguments.targets[0], arguments.runs)
    names = fuzzing.names() if "all" in arguments.targets else arguments.targets
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return int(any(pool.map(lambda name: _both(name, arguments), names)))


def guided(name: str, runs: int) -> int:
    """Changes that atheris chooses by what they reach; what reaches more stays in out/fuzz."""
    # Loops that atheris has instrumented cannot be compiled.
    os.environ["AMR_SLAM_COMPILED"] = "0"
    import atheris  # noqa: PLC0415 - the other phase does without

    with atheris.instrument_imports(include=list(PARSERS)):
        target = fuzzing.load(name)
    known = [*target.seeds(), *fuzzing.corpus(name)]
    folder = fuzzing.write_inputs(known, OUT / name)
    longest = max(64, 2 * max(map(len, known)))
    options = [
        f"-runs={runs}",
        f"-max_len={longest}",
        f"-artifact_prefix={folder}/",
        "-verbosity=0",
    ]
    atheris.Setup([sys.argv[0], *options, str(folder)], target.target)
    atheris.Fuzz()  # ends the process
    return 0


def blind(name: str, runs: int) -> int:
    """Random changes of all inputs so far, without instruments: several times as many a second."""
    begun_s = time.process_time()
    count = fuzzing.change_at_random(name, runs, OUT / name)
    speed = runs / (time.process_time() - begun_s)
    print(f"{name}: {runs} random changes of {count} inputs, {speed:.0f}/s", flush=True)
    return 0


def _both(name: str, arguments: argparse.Namespace) -> int:
    command = [sys.executable, __file__, name, "--guided", str(arguments.guided)]
    begun_s = time.monotonic()
    done = subprocess.run([*command, "--phase", "guided"], stderr=subprocess.PIPE, check=False)
    if done.returncode:
        sys.stderr.buffer.write(done.stderr)
        return done.returncode
    seconds = time.monotonic() - begun_s
    print(f"{name}: {arguments.guided} guided by coverage in {seconds:.0f} s", flush=True)
    if arguments.keep:
        fuzzing.write_corpus(name, fuzzing.read_inputs(OUT / name))
    blind_runs = str(max(0, arguments.runs - arguments.guided))
    command += ["--runs", blind_runs, "--phase", "blind"]
    return subprocess.run(command, check=False).returncode


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("targets", nargs="+", choices=[*fuzzing.names(), "all"], metavar="TARGET")
    parser.add_argument("--runs", type=int, default=1_000_000, help="executions in all")
    parser.add_argument("--guided", type=int, default=100_000, help="of which guided by coverage")
    parser.add_argument("--keep", action="store_true", help="put what was found into tests/fuzz")
    parser.add_argument(
        "--phase", choices=("both", "guided", "blind"), default="both", help=argparse.SUPPRESS
    )
    return parser


if __name__ == "__main__":
    sys.exit(main())
