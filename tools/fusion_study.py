"""Measure the fused pose between scans as docs/evaluation-fusion.md tells it, and write that page.

Example, a quick look: python tools/fusion_study.py --scale 0.05 --only promise --out out/page.md
"""

from __future__ import annotations

import argparse
import os
import platform
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np

from amr_slam.studies.fusion import between, events, pipeline, promise, recordings, repeated
from amr_slam.studies.report import Effort, Section, write_page

STUDIES: Final[dict[str, Callable[[Effort], Section]]] = {
    "promise": promise.study,
    "repeated": repeated.study,
    "between": between.study,
    "events": events.study,
    "pipeline": pipeline.study,
}


def main() -> int:
    """Run the studies one after another; the page is written anew after each."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    studies = dict(STUDIES)
    parser.add_argument("--only", nargs="+", choices=[*STUDIES, "recordings"], default=None)
    parser.add_argument("--scale", type=float, default=1.0, help="share of the runs")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=2, help="processes of the promise's runs")
    parser.add_argument("--logs", type=Path, help="folder of public logs, for the recordings")
    parser.add_argument("--out", type=Path, default=Path("docs/evaluation-fusion.md"))
    arguments = parser.parse_args()
    if arguments.logs is not None:
        studies["recordings"] = partial(recordings.study, logs=arguments.logs)
    effort = Effort(
        scale=arguments.scale,
        seed=arguments.seed,
        workers=arguments.workers,
        progress=_say,
    )
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    sections: list[Section] = []
    for name in arguments.only or studies:
        if name not in studies:
            parser.error("the recordings need --logs")
        sections.append(studies[name](effort))
        share = "" if arguments.scale == 1.0 else f" --scale {arguments.scale:g}"
        preface = (
            "How far the published pose is off between scans, whether it knows, and what it does "
            "when wheels slip or scans fail. Written by "
            f"`python tools/fusion_study.py --logs FOLDER{share}`, seed {arguments.seed}; "
            f"Python {platform.python_version()}, numpy {np.__version__}; "
            f"{sum(os.times()[:4]) / 60.0:.0f} min of processor time."
        )
        write_page("The fused pose between scans", preface, sections, arguments.out)
    return 0


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
