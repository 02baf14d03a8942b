"""All parts looked at in turn, here or from afar."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

from amr_slam.client import FleetListener, SessionError, close_session, open_client
from amr_slam.config import Config
from amr_slam.service.doctor.computer import look_at_computer
from amr_slam.service.doctor.devices import look_at_devices, look_at_map
from amr_slam.service.doctor.findings import Finding
from amr_slam.service.doctor.running import look_at_robot

_CONNECT_S: Final = 3.0
_STATUS_S: Final = 5.0
"""Five status messages."""


def examine_robot(robot: str, endpoint: str, keys: Path | None) -> Iterator[Finding]:
    """Ask a robot that runs."""
    return _asked(robot, endpoint, keys, "amr")


def examine_config(config: Config, config_path: Path) -> Iterator[Finding]:
    """Look at everything that a configuration names, on this computer.

    A robot that runs here is asked, as its devices are in use; else they are opened.
    """
    yield Finding(part="configuration", what=f"{config_path}: robot {config.robot.name}")
    yield from look_at_computer(config, config_path)
    map_findings, known = look_at_map(config)
    yield from map_findings
    yield from _routers(config)
    running = _running_here(config)
    if running is not None:
        yield from running
    else:
        yield from look_at_devices(config, known)


def _running_here(config: Config) -> list[Finding] | None:
    for endpoint in config.zenoh.listen:
        local = endpoint.replace("/0.0.0.0:", "/127.0.0.1:").replace("/[::]:", "/[::1]:")
        findings = list(_asked(config.robot.name, local, config.zenoh.keys, config.zenoh.prefix))
        if findings[0].part != "network":
            return findings
    return None


def _asked(robot: str, endpoint: str, keys: Path | None, prefix: str) -> Iterator[Finding]:
    try:
        with FleetListener(
            endpoint, [robot], prefix=prefix, keys=keys, connect_timeout_s=_CONNECT_S
        ) as fleet:
            fleet.wait_for(
                lambda views: (
                    robot in views
                    and views[robot].status is not None
                    and views[robot].pose is not None
                ),
                _STATUS_S,
            )
            view = fleet.views().get(robot)
    except SessionError as error:
        do = "is the robot switched on and its service running (systemctl status)? Network, address"
        yield Finding(part="network", what=f"{endpoint}: {error}", do=do)
        return
    if view is None or view.status is None:
        yield Finding(
            part="network",
            what=f"{endpoint}: nothing comes from {robot}",
            do="the robot's name right (amr-slam watch shows all)? Its zenoh.prefix? Its service?",
        )
        return
    yield Finding(part="robot", what=f"{robot} at {endpoint}, amr-slam {view.status.version}")
    yield from look_at_robot(view)


def _routers(config: Config) -> Iterator[Finding]:
    for endpoint in config.zenoh.connect:
        try:
            close_session(open_client(endpoint, config.zenoh.keys, _CONNECT_S))
        except SessionError as error:
            yield Finding(
                part="network",
                what=f"router {endpoint}: {error}",
                do="the robot localizes without it, but the fleet does not see it: network cable "
                "or Wi-Fi, ping the router, its service, and the keys (docs/security.md)",
            )
        else:
            yield Finding(part="network", what=f"router {endpoint} answers")
