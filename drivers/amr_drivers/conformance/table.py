"""Rigs by name: a literal table, and those of other distributions by entry point.

A third party names a function that gives its rigs under ``amr_slam.rigs``::

    [project.entry-points."amr_slam.rigs"]
    acme_lidar = "acme_amr.rig:rigs"
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterable
from importlib.metadata import entry_points
from typing import Final, cast

from amr_drivers.conformance.rig import MakeRig

_RIGS: Final = (
    "amr_drivers.conformance.rigs.sick_cola:rigs",
    "amr_drivers.conformance.rigs.sick_s300:rigs",
    "amr_drivers.conformance.rigs.sick_safety:rigs",
)
_GROUP: Final = "amr_slam.rigs"


def all_rigs() -> dict[str, MakeRig]:
    """Every rig that is known, by name."""
    return _collected([*_RIGS, *(point.value for point in entry_points(group=_GROUP))])


def rigs_named(names: Iterable[str]) -> dict[str, MakeRig]:
    """The rigs of these names; each is a rig's, the beginning of some, or ``module:function``.

    Raises ValueError for a name that is none of these.
    """
    chosen: dict[str, MakeRig] = {}
    known = all_rigs()
    for name in names:
        if ":" in name:
            chosen |= _collected([name])
            continue
        named = {full: make for full, make in known.items() if full.startswith(name)}
        if not named:
            raise ValueError(f"no rig is named {name!r}; known are {'; '.join(sorted(known))}")
        chosen |= named
    return chosen


def _collected(places: Iterable[str]) -> dict[str, MakeRig]:
    rigs: dict[str, MakeRig] = {}
    for place in places:
        module_name, _, function_name = place.partition(":")
        try:
            function = getattr(importlib.import_module(module_name), function_name)
        except (ImportError, AttributeError) as error:
            raise ValueError(f"rigs {place!r} cannot be loaded: {error}") from error
        rigs |= cast("Callable[[], dict[str, MakeRig]]", function)()
    return rigs
