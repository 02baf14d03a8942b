"""A view and a browser in front of it, for tests, pictures and benchmarks."""

from __future__ import annotations

import selectors
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Final

from playwright.sync_api import Browser, Page, sync_playwright

_READY_S: Final = 120.0  # processors may be busy
_NAMES: Final = ("chromium", "chromium-browser", "google-chrome")


def chromium_path() -> str | None:
    """Debian's browser; None where it is not installed."""
    return next((path for name in _NAMES if (path := shutil.which(name))), None)


@contextmanager
def browser() -> Iterator[Browser]:
    """Chromium without a window. Raises RuntimeError where there is none."""
    path = chromium_path()
    if path is None:
        raise RuntimeError("chromium is not installed: apt-get install chromium")
    with sync_playwright() as playwright:
        # In containers there is neither a sandbox nor much shared memory.
        arguments = ["--no-sandbox", "--disable-dev-shm-usage"]
        opened = playwright.chromium.launch(executable_path=path, args=arguments)
        try:
            yield opened
        finally:
            opened.close()


@dataclass(frozen=True, slots=True, kw_only=True)
class View:
    """``amr-slam view``, under way."""

    address: str
    """As it prints it: with the token for commands, where it made one."""
    process: subprocess.Popen[str]


@contextmanager
def view_process(endpoint: str, arguments: Sequence[str] = ()) -> Iterator[View]:
    """``amr-slam view`` on a free port."""
    command = [sys.executable, "-m", "amr_slam", "view", "--connect", endpoint, "--port", "0"]
    process = subprocess.Popen([*command, *arguments], stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        with selectors.DefaultSelector() as read:
            read.register(process.stdout, selectors.EVENT_READ)
            if not read.select(_READY_S):
                raise RuntimeError("amr-slam view: silent")
        address = process.stdout.readline().strip()
        if not address:
            raise RuntimeError("amr-slam view: ended")
        yield View(address=address, process=process)
    finally:
        process.terminate()
        try:
            process.wait(10.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        assert process.stdout is not None
        process.stdout.close()


def read(page: Page, expression: str) -> Any:
    """A value of the page's own state: ``v`` is what it lets be read (``main.js``)."""
    return page.evaluate(f"() => {{ const v = window.amrSlam; return {expression}; }}")


def wait_for(page: Page, expression: str, timeout_s: float = 120.0) -> None:
    """Until an expression of :func:`read` holds. (Playwright's own way of waiting evaluates text,
    which the page's policy forbids.) Raises TimeoutError."""
    deadline_s = time.monotonic() + timeout_s
    while not read(page, f"window.amrSlam && ({expression})"):
        if time.monotonic() > deadline_s:
            raise TimeoutError(f"not within {timeout_s:g} s: {expression}")
        page.wait_for_timeout(20.0)
