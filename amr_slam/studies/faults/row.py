"""A row of the fault table, and what was found."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass

from amr_slam.states import State
from amr_slam.studies.faults.settings import STANDARD, Setting
from amr_slam.studies.faults.stage import Stage, is_well
from amr_slam.studies.faults.witness import Message, Says


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One fault of a robot that drives, from its onset to its end."""

    number: str
    """In the catalogue of faults; a letter tells variants."""
    fault: str
    inject: Callable[[Stage], AbstractContextManager[None]]
    """Within it, there is the fault."""
    sign: str
    """What the robot must say, for people; '' where nothing is to be said."""
    says: Says | None = None
    """The same of a message."""
    within_s: float = 0.0
    """Deadline of the sign: so much,"""
    within_scans: int = 0
    """and so many scans."""
    lasts_s: float = 4.0
    """The fault lasts so long, and until there is the sign."""
    back: Says = is_well
    back_s: float = 5.0
    """Deadline, after the end of the fault, to be back: so much,"""
    back_scans: int = 2
    """and so many scans."""
    stays: frozenset[State] | None = None
    """The robot may claim nothing else meanwhile: it is expected to go on."""
    restarts: bool = False
    """The daemon ends by this fault: poses stop, and numbers begin anew."""
    setting: Setting = STANDARD
    elsewhere: str = ""
    """What of the row cannot be done here."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """A row that is no drive: it begins with a robot that is not running."""

    number: str
    fault: str
    sign: str
    within_s: float
    play: Callable[[Case, Callable[[Setting], Stage]], Finding]
    """Gets itself and a function that makes a stage of its own."""
    elsewhere: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """What became of a row. Times in s; None: not at all, or not to be had."""

    number: str
    fault: str
    sign: str
    detected_s: float | None
    deadline_s: float
    states: str
    """That were claimed one after another, from the onset on."""
    said: str
    """Fault text, health, or whatever else was the sign."""
    recovered_s: float | None
    worst_m: float | None
    """Greatest true error of a pose that was claimed localized."""
    unsaid_m: float | None
    """The same of those that came after the deadline of the sign, or without one."""
    beyond: float | None
    """Share of the claimed poses whose error was greater than their ``error95_m``."""
    gap_max_ms: float | None
    """Longest time between two poses,"""
    gap_p99_ms: float | None
    """and the one that 1 in 100 exceeds."""
    broken: tuple[str, ...]
    """Invariants, and deadlines."""
    notes: tuple[str, ...] = ()
    elsewhere: str = ""


def fault_says(*words: str) -> Says:
    """All these words stand in the fault text."""

    def says(message: Message) -> bool:
        return message.fault is not None and all(word in message.fault for word in words)

    return says


def state_is(*states: State) -> Says:
    """One of these is claimed."""
    return lambda message: message.state in states


def either(*ways: Says) -> Says:
    """Any of these is said."""
    return lambda message: any(says(message) for says in ways)
