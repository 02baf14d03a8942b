"""Measure localization as docs/evaluation.md tells it, and write that page.

Example, a quick look: python tools/evaluate.py --scale 0.1 --only table1 slam --out out/page.md
"""

from __future__ import annotations

import argparse
import importlib
import os
import platform
import sys
import time
from pathlib import Path
from typing import Final

import numpy as np

from amr_slam.studies.report import Effort, Section, write_page

# Study -> module of amr_slam.studies, in the order of the page.
STUDIES: Final = {
    "table1": "table1",
    "slam": "slam_scratch",
    "real": "real",
    "blocked": "disturbed",
    "negatives": "negatives",
    "scaling": "scaling",
    "bound": "bound",
    "peers": "peers",
    "calibration": "calibrating",
    "large": "large",
    "exchanged": "exchanged",
}
NEEDS_LOGS: Final = frozenset({"real"})
# Hours of processor time, and a page of its own: --only large --out docs/evaluation-large.md.
ASKED_FOR: Final = frozenset({"large"})


def main() -> int:
    """Run the studies one after another; the page is written anew after each."""
    arguments = _parser().parse_args()
    begun_s = time.process_time()
    chosen = [name for name in STUDIES if name in arguments.only]
    if arguments.logs is None:
        chosen = [name for name in chosen if name not in NEEDS_LOGS]
    sections: list[Section] = []
    for name in chosen:
        study_begun_s = time.process_time()
        module = importlib.import_module(f"amr_slam.studies.{STUDIES[name]}")
        effort = Effort(scale=arguments.scale, seed=arguments.seed, progress=_say)
        logs = (arguments.logs,) if name in NEEDS_LOGS else ()
        sections.append(module.run(effort, *logs))
        _say(f"{name}: {time.process_time() - study_begun_s:.0f} s")
        write_page("Evaluation", _preface(chosen, arguments, begun_s), sections, arguments.out)
    return 0


def _say(text: str) -> None:
    print(text, flush=True)


def _preface(chosen: list[str], arguments: argparse.Namespace, begun_s: float) -> str:
    seed = f" --seed {arguments.seed}" if arguments.seed else ""
    logs = f" --logs {arguments.logs}" if NEEDS_LOGS & set(chosen) else ""
    command = f"--scale {arguments.scale:g}{seed} --only {' '.join(chosen)}{logs}"
    return (
        f"Written by `python tools/evaluate.py {command}` in "
        f"{(time.process_time() - begun_s) / 60.0:.0f} minutes of processor time: "
        f"{platform.machine()}, {os.cpu_count()} processors, Python {platform.python_version()}, "
        f"numpy {np.__version__}. All worlds, poses and noise are seeded."
    )


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--scale", type=float, default=1.0, help="1: the published page; 0.05: a quick look")
    add("--seed", type=int, default=0, help="other worlds and noise")
    usual = [name for name in STUDIES if name not in ASKED_FOR]
    add("--only", nargs="+", choices=list(STUDIES), default=usual, metavar="STUDY",
        help=", ".join(STUDIES))  # fmt: skip
    add("--out", type=Path, default=Path("docs/evaluation.md"), help="the page (Markdown)")
    add("--logs", type=Path, help="folder of recordings of real robots; without it, no 'real'")
    return parser


if __name__ == "__main__":
    sys.exit(main())
