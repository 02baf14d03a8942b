"""Loops compiled to machine code where numba is there; the same results in numpy where it is not.

``AMR_SLAM_COMPILED=0`` in the environment chooses numpy. Why and what it gains:
``docs/adr/0009-compiled-loops.md``.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from types import ModuleType
from typing import Final, ParamSpec, TypeVar

_Args = ParamSpec("_Args")
_T = TypeVar("_T")

numba: ModuleType | None
try:
    import numba
except ImportError:  # no wheel for this processor or Python
    numba = None

ENABLED: Final = numba is not None and os.environ.get("AMR_SLAM_COMPILED", "1") != "0"
"""Whether callers should use the compiled loops."""


def jit(function: Callable[_Args, _T]) -> Callable[_Args, _T]:
    """Compile on first call and keep the machine code on disk for the next start.

    The code is kept beside the module, or in ``NUMBA_CACHE_DIR``; where neither can be written,
    each start compiles anew. Floating point stays exact (no fast-math): NaN and inf mean what
    they mean in numpy.
    """
    if numba is None:
        return function
    try:
        return _njit(function, cache=True)
    except RuntimeError:  # no place to keep the code
        return _njit(function, cache=False)


def _njit(function: Callable[_Args, _T], *, cache: bool) -> Callable[_Args, _T]:
    assert numba is not None
    compiled: Callable[_Args, _T] = numba.njit(cache=cache, error_model="numpy")(function)
    return compiled
