"""``amr-slam map report``."""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
from dataclasses import replace
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Final

from amr_slam.cli.outputs import UsageError, check_outputs, writing
from amr_slam.cli.progress import Steps
from amr_slam.commissioning import Eye, ReportError, ReportParams, make_report, usual_eyes
from amr_slam.commissioning.about import About
from amr_slam.commissioning.machine import facts
from amr_slam.commissioning.page import page
from amr_slam.config import Config, ConfigError, load
from amr_slam.map import MapError, load_map
from amr_slam.map.file import VERSION
from amr_slam.params import SlamParams
from amr_slam.simulation import SCANNERS

# What a driver's devices see; a configuration does not tell.
_MODELS: Final = {"sick_cola": "LMS111 0.5", "sick_safety": "microScan3 0.5"}


def report(arguments: argparse.Namespace) -> int:
    """Look at the map as its robot would; page and JSON. Raises what ``maps.FAILURES`` names."""
    check_outputs(arguments.out, arguments.json, source=arguments.map)
    config = _config(arguments.config)
    known, map_id = load_map(arguments.map)
    params = ReportParams(seed=arguments.seed)
    if arguments.poses is not None:
        params = replace(params, cold_starts=arguments.poses, suspects=arguments.poses // 3)
    slam = config.slam if config is not None else SlamParams()
    with Steps("report", elsewhere=True) as steps:
        try:
            found = make_report(known, _eyes(config), slam, params, steps.say)
        except ReportError as error:
            raise MapError(f"{arguments.map}: {error}") from error
        steps.say("page", None)
        about = About(
            map_id=str(map_id),
            file_name=arguments.map.name,
            file_sha256=hashlib.sha256(arguments.map.read_bytes()).hexdigest(),
            map_format=VERSION,
            software=version("amr-slam"),
            made_at=datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
            robot=_robot(config),
        )
        text = page(found, about)
    with writing(arguments.out) as out:
        out.write_text(text, encoding="utf-8")
    if arguments.json is not None:
        with writing(arguments.json) as out:
            out.write_text(json.dumps(facts(found, about), allow_nan=False) + "\n", "utf-8")
    sys.stdout.write(f"{arguments.out}\n")
    return 0


def _config(file: Path | None) -> Config | None:
    try:
        return None if file is None else load(file)
    except ConfigError as error:
        raise UsageError(str(error)) from error


def _eyes(config: Config | None) -> tuple[Eye, ...]:
    if config is None:
        return usual_eyes()
    eyes = []
    for scanner in config.scanners:
        model = SCANNERS[_MODELS.get(scanner.driver, "S300")]
        mounting = scanner.mounting.mounting
        model = replace(model, name=scanner.name, base_from_lidar=mounting.base_from_lidar)
        eyes.append(Eye(model=model, mounting=mounting))
    return tuple(eyes)


def _robot(config: Config | None) -> str:
    if config is None:
        return "two scanners of 270° at opposite corners (no --config was given)"
    count = len(config.scanners)
    return f"{config.robot.name}, {count} {'scanner' if count == 1 else 'scanners'}"
