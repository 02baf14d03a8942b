"""Loops compiled to machine code where numba is there; the same results in numpy where it is not.

``AMR_SLAM_COMPILED=0`` in the environment chooses numpy. Why and what it gains:
``docs/adr/0009-compiled-loops.md``. numba is imported by the first loop that is called, for most
programs call none: ``docs/adr/0041-first-words-within-a-second.md``.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import update_wrapper
from importlib.util import find_spec
from typing import Any, Final, Generic, ParamSpec, TypeVar

_Args = ParamSpec("_Args")
_T = TypeVar("_T")

INSTALLED: Final = find_spec("numba") is not None
"""False where there is no wheel for this processor or Python."""
ENABLED: Final = INSTALLED and os.environ.get("AMR_SLAM_COMPILED", "1") != "0"
"""Whether callers should use the compiled loops."""


class Loop(Generic[_Args, _T]):
    """A function that becomes numba's with its first call."""

    def __init__(self, function: Callable[_Args, _T]) -> None:
        update_wrapper(self, function)
        self._function = function
        self._machine: Any = None

    def __call__(self, *args: _Args.args, **kwargs: _Args.kwargs) -> _T:
        result: _T = (self._machine or self.machine)(*args, **kwargs)
        return result

    @property
    def machine(self) -> Any:
        """Numba's dispatcher. Raises ImportError where numba is there, but broken."""
        if self._machine is None:
            import numba  # noqa: PLC0415  # half a second

            try:
                self._machine = numba.njit(cache=True, error_model="numpy")(self._function)
            except RuntimeError:  # no place to keep the code
                self._machine = numba.njit(error_model="numpy")(self._function)
        return self._machine

    @property
    def _numba_type_(self) -> Any:
        """By this numba knows the loop inside another one."""
        return self.machine._numba_type_


def load() -> None:
    """Have numba imported before the first loop asks for it."""
    if ENABLED:
        import numba  # noqa: F401, PLC0415


def jit(function: Callable[_Args, _T]) -> Callable[_Args, _T]:
    """Compile on first call and keep the machine code on disk for the next start.

    The code is kept beside the module, or in ``NUMBA_CACHE_DIR``; where neither can be written,
    each start compiles anew. Floating point stays exact (no fast-math): NaN and inf mean what
    they mean in numpy.
    """
    return Loop(function) if INSTALLED else function
