"""Pictures of ``amr-slam view`` for the documentation: real robots' messages in a real browser.

Example: python tools/view_pictures.py docs/images
"""

from __future__ import annotations

import argparse
import socket
import sys
import tempfile
from pathlib import Path
from typing import Any

from playwright.sync_api import Browser, Page

from amr_slam.studies.browsing import browser, read, view_process, wait_for
from amr_slam.studies.fleet.processes import program

PICTURES: dict[str, dict[str, Any]] = {
    "view-light": {"color_scheme": "light", "viewport": {"width": 1440, "height": 900}},
    "view-dark": {"color_scheme": "dark", "viewport": {"width": 1440, "height": 900}},
    "view-tablet": {
        "color_scheme": "light", "viewport": {"width": 834, "height": 1112},
        "has_touch": True, "device_scale_factor": 1.5,
    },
}  # fmt: skip


def main() -> int:
    """Start everything, take the pictures, stop everything."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out", type=Path, help="folder for view-*.png")
    parser.add_argument("--seconds", type=float, default=70.0, help="driven before the first one")
    arguments = parser.parse_args()
    with socket.create_server(("127.0.0.1", 0)) as free:
        endpoint = f"tcp/127.0.0.1:{free.getsockname()[1]}"
    scene = ["--scene", "--count", "7", "--area", "500", "--seed", "5"]
    with (
        tempfile.TemporaryDirectory() as folder,
        program("router", endpoint),
        program("driving", endpoint, folder, *scene),
        view_process(endpoint, ["--allow-commands"]) as view,
        browser() as opened,
    ):
        pages = {name: _open(opened, view.address, options) for name, options in PICTURES.items()}
        first = next(iter(pages.values()))
        first.wait_for_timeout(1000.0 * arguments.seconds)
        for name, page in pages.items():
            _pose_for(page, name)
            page.screenshot(path=arguments.out / f"{name}.png")
            print(arguments.out / f"{name}.png")
        _ask(first)
        first.screenshot(path=arguments.out / "view-set-pose.png")
        print(arguments.out / "view-set-pose.png")
    return 0


def _open(opened: Browser, address: str, options: dict[str, Any]) -> Page:
    page = opened.new_context(**options).new_page()
    page.goto(address)
    wait_for(page, "v.layer.map")
    return page


def _pose_for(page: Page, name: str) -> None:
    robot = {"view-dark": "amr03", "view-tablet": "amr02"}.get(name, "amr01")
    read(page, f"v.choose('{robot}')")
    page.keyboard.press("0")
    page.wait_for_timeout(1500.0)
    # On a busy computer robots come late, and are shown so.
    wait_for(page, "v.store.shown().every(({ state }) => state !== 'stale')")


def _ask(page: Page) -> None:
    """Set a pose by dragging, up to the question."""
    page.locator("[data-action=set_pose]").click()
    box = page.locator("#canvas").bounding_box()
    assert box is not None
    x, y = box["x"] + 0.4 * box["width"], box["y"] + 0.45 * box["height"]
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 60, y - 40, steps=4)
    page.mouse.up()
    page.wait_for_timeout(300.0)


if __name__ == "__main__":
    sys.exit(main())
