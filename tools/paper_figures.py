"""Make the paper's figures 3 and 4 from runs of this program, with what they show as a page.

Example: python tools/paper_figures.py --log ../shared/data/logs/intel.log.gz
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from amr_slam.recording import RecordingError
from amr_slam.studies import paper_figures
from amr_slam.studies.report import Effort, Section, write_page


def main() -> int:
    """Both figures, or without a recording the first of them."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--log", type=Path, help="recording of a real robot; without it, no figure 4")
    add("--seed", type=int, default=0, help="another laboratory")
    add("--out", type=Path, default=Path("docs/paper-figures.md"), help="the page (Markdown)")
    arguments = parser.parse_args()
    effort = Effort(seed=arguments.seed, progress=_say)
    sections: list[Section] = []
    if arguments.log is not None:
        try:
            sections.append(paper_figures.real(effort, arguments.log))
        except RecordingError as error:
            print(error, file=sys.stderr)
            return 1
    sections.insert(0, paper_figures.synthetic(effort))
    log = "" if arguments.log is None else f" --log {arguments.log}"
    preface = (
        f"Written by `python tools/paper_figures.py{log}`. The paper's figures 3 and 4 show what "
        "its algorithm made of the laboratory at Győr; these show what this program makes of the "
        "same kinds of drives. How the success of localization compares is in "
        "[evaluation.md](evaluation.md)."
    )
    write_page("The paper's figures 3 and 4, remade", preface, sections, arguments.out)
    return 0


def _say(text: str) -> None:
    print(text, flush=True)


if __name__ == "__main__":
    sys.exit(main())
