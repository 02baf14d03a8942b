"""Findings as a page, and as lines while they come in."""

from __future__ import annotations

import os
import platform
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from amr_slam.studies.faults.row import Finding
from amr_slam.studies.report import Table

BEGIN: Final = "<!-- faults: written by `make faults`, from here -->"
END: Final = "<!-- faults: to here -->"
_MAX_SAID: Final = 150


def line(finding: Finding) -> str:
    """One finding for people who wait for the next one."""
    broken = "; ".join(finding.broken) or "none broken"
    return (
        f"{finding.number:>4}  {finding.fault}: said after {_seconds(finding.detected_s)}, "
        f"back after {_seconds(finding.recovered_s)}, worst {_metres(finding.worst_m)} m, "
        f"{finding.states}; {broken}"
    )


def tables(findings: Sequence[Finding], scan_period_s: float, took_s: float) -> str:
    """Both tables, and what they were measured on, as Markdown."""
    load = os.getloadavg()[1]
    bad = [finding.number for finding in findings if finding.broken]
    said = Table(
        title="What the robot said",
        columns=("row", "fault", "wanted", "said after s (limit)", "states", "its words",
                 "back after s"),
        rows=tuple(
            (
                finding.number,
                finding.fault,
                finding.sign or "-",
                _detected(finding),
                finding.states,
                _cell(finding.said),
                _seconds(finding.recovered_s),
            )
            for finding in findings
        ),
    )  # fmt: skip
    true = Table(
        title="What was true, and what broke",
        columns=("row", "worst error m while `localized`", "of these after the limit",
                 "beyond `error95_m`", "pose gap ms: p99, longest", "broken", "also", "in the VM"),
        rows=tuple(
            (
                finding.number,
                _metres(finding.worst_m),
                _metres(finding.unsaid_m),
                "-" if finding.beyond is None else f"{finding.beyond:.1%}",
                _gaps(finding),
                _cell("; ".join(finding.broken)) or "none",
                _cell("; ".join(finding.notes)) or "-",
                finding.elsewhere or "-",
            )
            for finding in findings
        ),
    )  # fmt: skip
    machine = f"{platform.machine()}, {os.cpu_count()} processors (load average {load:.1f})"
    summary = (
        f"{len(findings)} rows in {took_s / 60.0:.0f} minutes, a scan each {scan_period_s:g} s; "
        f"{machine}, Python {platform.python_version()}. "
        f"Rows with something broken: {', '.join(bad) or 'none'}."
    )
    return "\n\n".join((summary, said.markdown(), true.markdown()))


def renew(page: Path, content: str) -> None:
    """Put ``content`` between the marks of a page. Raises ValueError where it has none."""
    before, begin, rest = page.read_text("utf-8").partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise ValueError(f"{page}: lacks the marks between which the tables belong")
    page.write_text(f"{before}{begin}\n{content}\n{end}{after}", encoding="utf-8")


def _detected(finding: Finding) -> str:
    if not finding.sign:
        return "-"
    return f"{_seconds(finding.detected_s)} ({finding.deadline_s:.2g})"


def _seconds(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def _metres(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"


def _gaps(finding: Finding) -> str:
    if finding.gap_p99_ms is None or finding.gap_max_ms is None:
        return "-"
    return f"{finding.gap_p99_ms:.0f}, {finding.gap_max_ms:.0f}"


def _cell(text: str) -> str:
    """Nothing that would end a cell; not for ever long."""
    plain = text.replace("|", "/").replace("\n", " ")
    return plain if len(plain) <= _MAX_SAID else plain[: _MAX_SAID - 1] + "…"
