"""The report as one HTML file that loads nothing: for reading, and for printing."""

from __future__ import annotations

import math

from jinja2 import Environment, PackageLoader, StrictUndefined

from amr_slam.commissioning.about import About
from amr_slam.commissioning.cold_starts import Outcome
from amr_slam.commissioning.figures import Drawing
from amr_slam.commissioning.making import Report
from amr_slam.commissioning.verdicts import judged, overall, percent


def page(report: Report, about: About) -> str:
    """HTML. Names come from outside: everything is escaped. Raises MapError for a map too large
    to be drawn."""
    environment = Environment(
        loader=PackageLoader("amr_slam.commissioning"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["percent"] = percent
    environment.filters["cm"] = centimetres
    environment.filters["degrees"] = lambda rad: f"{math.degrees(rad):.0f}"
    environment.filters["point"] = lambda at: f"x {at[0]:.1f}, y {at[1]:.1f}"
    answers, drawing = judged(report), Drawing(report)
    return environment.get_template("page.html.j2").render(
        report=report,
        about=about,
        answers=answers,
        overall=overall(answers),
        drawing=drawing,
        outcomes=Outcome,
    )


def centimetres(error_m: float) -> str:
    """Whole centimetres, metres where there are many of them."""
    if error_m >= 5.0:
        return "more than 5 m" if error_m > 20.0 else f"{error_m:.0f} m"
    return f"{error_m:.1f} m" if error_m >= 1.0 else f"{100.0 * error_m:.1f} cm"
