"""The key expressions that a site's access control is about where its robots speak VDA 5050, each
under its own name as serial number."""

from __future__ import annotations

from dataclasses import dataclass

from amr_slam.encodings.vda5050.editions import ACTIONS, STATE, VISUALIZATION


@dataclass(frozen=True, slots=True, kw_only=True)
class Vda5050Keys:
    """Of one robot, or of all."""

    says: tuple[str, ...]
    """What is published."""
    commands: tuple[str, ...]
    """Where instant actions come in, and the vehicle controller's state."""


def vda5050_keys(interface: str | None, robot: str | None = None) -> Vda5050Keys:
    """``interface`` None: nobody speaks VDA 5050, there are none. ``robot`` None: of all robots."""
    if interface is None:
        return Vda5050Keys(says=(), commands=())
    topics = f"{interface}/*/*/{robot or '*'}"
    return Vda5050Keys(
        says=(f"{topics}/{VISUALIZATION}",), commands=(f"{topics}/{ACTIONS}", f"{topics}/{STATE}")
    )
