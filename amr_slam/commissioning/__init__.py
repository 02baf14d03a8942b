"""The commissioning report: what a map is good for, found out before a robot relies on it."""

from amr_slam.commissioning.making import Report, ReportError, make_report
from amr_slam.commissioning.settings import ReportParams, usual_eyes
from amr_slam.commissioning.viewing import Eye

__all__ = ["Eye", "Report", "ReportError", "ReportParams", "make_report", "usual_eyes"]
