from __future__ import annotations

import dataclasses
import inspect
import subprocess
import sys
from importlib.metadata import EntryPoint
from types import UnionType
from typing import Annotated, Literal, get_args, get_origin, get_type_hints

import pytest

from amr_drivers import registry


def test_every_driver_of_the_table_can_be_opened_by_its_contract() -> None:
    for name in registry.scanner_names():
        module = registry.scanner_module(name)
        assert dataclasses.is_dataclass(module.Settings)
        assert callable(module.open_scanner)
    for name in registry.odometry_names():
        odometry = registry.odometry_module(name)
        assert dataclasses.is_dataclass(odometry.Settings)
        assert callable(odometry.open_odometry)
    assert "sick_s300" in registry.scanner_names()
    assert "can" in registry.odometry_names()


def plain(kind: object) -> bool:
    """Whether the configuration can check a setting of this type generically."""
    if get_origin(kind) is Annotated:
        return plain(get_args(kind)[0])
    if isinstance(kind, type) and dataclasses.is_dataclass(kind):
        return all(plain(hint) for hint in get_type_hints(kind, include_extras=True).values())
    if get_origin(kind) in {UnionType, tuple}:  # absent tables, lists
        return all(plain(of) or of in {type(None), ...} for of in get_args(kind))
    return kind in (str, int, float, bool) or get_origin(kind) is Literal


@pytest.mark.parametrize("name", registry.scanner_names() + registry.odometry_names())
def test_settings_are_plain_frozen_and_explained(name: str) -> None:
    modules = []
    if name in registry.scanner_names():
        modules.append(registry.scanner_module(name).Settings)
    if name in registry.odometry_names():
        modules.append(registry.odometry_module(name).Settings)
    for settings in modules:
        assert plain(settings)
        assert settings.__dataclass_params__.frozen
        bases = [base for base in settings.__mro__ if dataclasses.is_dataclass(base)]
        source = "".join(inspect.getsource(base) for base in bases)
        assert source.count('"""') >= 2 * (len(dataclasses.fields(settings)) - 1)


def test_unknown_names_get_one_clear_error() -> None:
    with pytest.raises(ValueError, match="'sick_s30'; did you mean 'sick_s300'"):
        registry.scanner_module("sick_s30")
    with pytest.raises(ValueError, match="no odometry driver is named 'gps'; known are can"):
        registry.odometry_module("gps")


def test_a_plug_in_is_found_and_checked(monkeypatch: pytest.MonkeyPatch) -> None:
    points = [
        EntryPoint("acme", "amr_drivers.sick_s300.driver", "amr_slam.scanners"),
        EntryPoint("hollow", "amr_drivers.errors", "amr_slam.scanners"),
        EntryPoint("broken", "amr_drivers.absent", "amr_slam.scanners"),
    ]
    monkeypatch.setattr(registry, "entry_points", lambda **_: points)
    assert registry.scanner_module("acme").Settings.__name__ == "Settings"
    with pytest.raises(ValueError, match=r"'hollow': amr_drivers\.errors has no Settings"):
        registry.scanner_module("hollow")
    with pytest.raises(ValueError, match="'broken' cannot be loaded"):
        registry.scanner_module("broken")


def test_drivers_are_loaded_only_when_asked_for() -> None:
    code = (
        "import sys; from amr_drivers import registry; registry.scanner_names();"
        "assert not {'serial', 'can', 'cantools'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)
