"""Writes config/default.toml from the parameters' own dataclasses, so that they cannot disagree.

Usage: python tools/default_config.py > config/default.toml
"""

from __future__ import annotations

import ast
import inspect
import itertools
import json
import re
import textwrap
from collections.abc import Iterator
from dataclasses import MISSING, Field, fields, is_dataclass
from typing import Any, cast, get_type_hints

from amr_drivers import registry
from amr_slam import config
from amr_slam.odometry import DifferentialDrive

HEAD = """Every key of the configuration with its default, unit and reason. Nothing here needs to be
copied: a robot's own file names what differs, and the keys that have no default (marked REQUIRED;
their values here are examples). Unknown keys are refused. Relative paths start at the working
directory. Written by tools/default_config.py."""
REQUIRED: dict[str, Any] = {
    "robot.name": "amr7",
    "drive.radius_left_m": 0.1,
    "drive.radius_right_m": 0.1,
    "drive.track_m": 0.5,
    "odometry.driver": "can",
    "odometry.options.dbc": "config/wheels.dbc",
    "odometry.options.left.signal": "LeftCount",
    "odometry.options.right.signal": "RightCount",
    "scanners.name": "front",
    "scanners.driver": "sick_s300",
    "scanners.mounting.x_m": 0.3,
    "scanners.mounting.y_m": 0.2,
    "scanners.mounting.theta_deg": 45.0,
    "scanners.options.port": "/dev/serial/by-id/usb-front",
    "map.mode": "mapping",
}
ABSENT = {
    "map.path": '"maps/hall.amrmap"',
    "zenoh.keys": '"/etc/amr-slam/keys"',
    "ros2.namespace": '"amr7"',
    "vda5050.manufacturer": '"acme"',
    "vda5050.serial_number": '"amr7"',
    "shadow.key": '"cameras/amr7/pose"',
    "shadow.clock_s": "-0.08",
    "odometry.options.drive": '{ message = "Traction", signal = "DriveCount" }',
    "odometry.options.steer": '{ message = "Steering", signal = "SteerAngle", unit = "deg" }',
}
CHOICES = {
    "drive": (
        "kind",
        "differential",
        "How wheel samples become motion: differential, tricycle or poses.",
    ),
    "slam": ("preset", "default", "The values that the others start from: default or paper."),
}


def render() -> str:
    """The whole file."""
    sections = get_type_hints(config.Config)
    sections |= {"drive": DifferentialDrive, "scanners": config.ScannerSettings}
    lines = itertools.chain.from_iterable(_section(name, cls) for name, cls in sections.items())
    return "\n".join([*_comment(HEAD), "", *lines]).rstrip() + "\n"


def _section(path: str, cls: type[Any], default: Any = MISSING, doc: str = "") -> Iterator[str]:
    """One table; nested dataclasses follow as tables of their own.

    ``default``: what the class around this one starts from, if that is not this one's own.
    """
    yield from _comment(doc or (inspect.getdoc(cls) or "").partition("\n\n")[0])
    yield f"[[{path}]]" if path == "scanners" else f"[{path}]"
    if path in CHOICES:
        key, value, doc = CHOICES[path]
        yield from [*_comment(doc), f"{key} = {json.dumps(value)}"]
    docs, hints = _field_docs(cls), get_type_hints(cls)
    tables: list[Iterator[str]] = []
    for field in fields(cls):
        key, hint, about = f"{path}.{field.name}", hints[field.name], docs.get(field.name, "")
        if field.name == "options":
            tables.append(_section(key, _settings(path)))
            continue
        value = _own_default(field) if default is MISSING else getattr(default, field.name)
        if is_dataclass(hint):
            tables.append(_section(key, cast("type[Any]", hint), value, about))
        else:
            yield from _key(key, REQUIRED[key] if value is MISSING else value, about)
    yield ""
    yield from itertools.chain.from_iterable(tables)


def _settings(path: str) -> type[Any]:
    module = registry.scanner_module if path == "scanners" else registry.odometry_module
    return module(REQUIRED[f"{path}.driver"]).Settings


def _key(path: str, value: Any, doc: str) -> Iterator[str]:
    yield from _comment(f"REQUIRED. {doc}" if path in REQUIRED else doc)
    key = path.rpartition(".")[2]
    shown = ABSENT.get(path) or json.dumps(value, default=str)
    yield f"# {key} = {shown}" if path in ABSENT else f"{key} = {shown}"


def _comment(text: str) -> list[str]:
    plain = re.sub(r"``|:\w+:`[~.]?|`", "", " ".join(text.split()))
    return [f"# {line}" for line in textwrap.wrap(plain, 97)]


def _own_default(field: Field[Any]) -> Any:
    """MISSING where there is none."""
    if field.default_factory is not MISSING:
        return field.default_factory()
    return field.default


def _field_docs(cls: type[Any]) -> dict[str, str]:
    """The string literal under each field, also of the classes that it inherits from."""
    sources = [inspect.getsource(base) for base in cls.__mro__ if is_dataclass(base)]
    tree = ast.parse("".join(map(textwrap.dedent, sources)))
    body = [ast.unparse(node) for cls_node in tree.body for node in ast.iter_child_nodes(cls_node)]
    return {
        field.partition(":")[0]: ast.literal_eval(doc)
        for field, doc in itertools.pairwise(body)
        if doc.startswith(("'", '"'))
    }


if __name__ == "__main__":
    print(render(), end="")
