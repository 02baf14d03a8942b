"""Halls mapped in two sessions and merged: is the map as good as one of it all, are others refused?

Usage: python benchmarks/merge.py [KIND:SEED:AREA_M2 ...] [--poses 40] [--pairs | --apart]
"""

from __future__ import annotations

import argparse
import itertools
import sys
import time

from amr_slam.simulation import mapping_poses
from amr_slam.studies import merging
from amr_slam.studies.merging import Localized, Outcome, Place

_PLACES = (
    "hall:3:400", "hall:4:1000", "offices:2:300", "corridors:1:200", "odd:1:200",
    "warehouse:1:1000", "symmetric:1:160",
)  # fmt: skip
_HEAD = (
    "world", "scans", "in common, m2", "witnesses", "next best", "bent maps, rms m",
    "ATE m: merged / one session", "from nowhere: merged / one", "wrong",
    "error median, p95 mm: merged / one", "false changes", "CPU s",
)  # fmt: skip


def main(argv: list[str]) -> int:
    """Prints the table, or what became of pairs that need not or must not be merged."""
    parser = argparse.ArgumentParser(description=__doc__, allow_abbrev=False)
    parser.add_argument("places", nargs="*", default=_PLACES, metavar="KIND:SEED:AREA_M2")
    parser.add_argument("--poses", type=int, default=40)
    parser.add_argument("--pairs", action="store_true", help="merge each hall with all others")
    parser.add_argument("--apart", action="store_true", help="merge parts driven only once")
    arguments = parser.parse_args(argv)
    places = [_place(text) for text in arguments.places]
    begun_s = time.process_time()
    if arguments.pairs:
        _pairs(places)
    elif arguments.apart:
        _apart(places)
    else:
        print(f"| {' | '.join(_HEAD)} |\n|{'---|' * len(_HEAD)}")
        for place in places:
            print(_row(merging.halves(place, arguments.poses)), flush=True)
    print(f"\n{time.process_time() - begun_s:.0f} s of CPU")
    return 0


def _place(text: str) -> Place:
    kind, seed, area_m2 = text.split(":")
    return kind, int(seed), float(area_m2)


def _apart(places: list[Place]) -> None:
    false = 0
    for place in places:
        off_m, why = merging.apart(place)
        false += why == "FALSE"
        print(
            f"{place}: {why if off_m is None else f'merged, {off_m:.2f} m off: {why}'}", flush=True
        )
    print(f"{false} of {len(places)} were merged wrongly")


def _pairs(places: list[Place]) -> None:
    sessions = {}
    for place in places:
        world = merging.world_of(place)
        sessions[place] = merging.session(world, mapping_poses(world, 0.8), 1, place[0])
    merged = 0
    for one, other in itertools.permutations(places, 2):
        why = merging.strangers(sessions[one], sessions[other])
        merged += why is None
        print(f"{one} and {other}: {why or 'MERGED'}", flush=True)
    print(f"{merged} of {len(places) * (len(places) - 1)} wrong pairs were merged")


def _row(one: Outcome) -> str:
    kind, seed, area_m2 = one.place
    cells = [f"{kind} {seed}, {area_m2:g} m²"]
    if one.found is None or one.merged is None or one.whole is None:
        return f"| {' | '.join([*cells, f'refused: {one.refused}'])} |"
    overlay, rival = one.found.overlay, one.found.rival
    cells += [
        f"{len(overlay.there)} + {len(overlay.back)}",
        f"{overlay.common_m2:.0f}",
        f"{one.found.witnesses} of {one.found.sought}",
        "none" if rival is None else f"{rival[1]:.0%}",
        f"{overlay.rms_m:.3f}",
        f"{one.ate_m:.3f} / {one.whole_ate_m:.3f}",
        f"{_share(one.merged)} / {_share(one.whole)}",
        f"{one.merged.wrong} / {one.whole.wrong}",
        f"{_errors(one.merged)} / {_errors(one.whole)}",
        f"{one.changes}",
        f"{one.cpu_s:.0f}",
    ]
    return f"| {' | '.join(cells)} |"


def _share(one: Localized) -> str:
    return f"{one.right} of {one.tried}"


def _errors(one: Localized) -> str:
    return f"{1e3 * one.median_m:.0f}, {1e3 * one.p95_m:.0f}"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
