"""The page and its JSON, made as a user makes them."""

from __future__ import annotations

import json
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from labs import room, world_of
from locating import map_of

from amr_slam.cli import main
from amr_slam.commissioning.coverage import coverage
from amr_slam.commissioning.places import components, reachable, thinned
from amr_slam.map import MapParams, PointMap, save_map
from amr_slam.params import SlamParams


class Links(HTMLParser):
    """All that a browser may load, and whether tags are closed."""

    def __init__(self) -> None:
        super().__init__()
        self.targets: list[str] = []
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.targets += [
            value or "" for name, value in attrs if name in {"href", "src", "xlink:href"}
        ]
        assert tag not in {"script", "link", "iframe", "object"}
        if tag not in {"meta", "br", "image"}:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in {"meta", "br", "image"}:
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


CABINETS = np.array(
    [
        [6.4, 0.0, 6.4, 1.2], [6.4, 1.2, 8.0, 1.2],
        [0.0, 3.8, 0.8, 3.8], [0.8, 3.8, 0.8, 6.0],
    ]
)  # fmt: skip


def uneven_room(name: str = "a room") -> PointMap:
    """That looks like itself from nowhere else."""
    world = world_of(np.concatenate([room().segments_m, CABINETS]))
    known = map_of(world, [(2.0, 2.0), (6.0, 4.0)])
    known.name = name
    return known


def imported(known: PointMap) -> PointMap:
    """Walls and floor alone, as another program's picture gives them."""
    bare = known.copied()
    bare.name = "imported"
    for of_scans in (bare.path, bare.noises_m, bare.rays):
        of_scans.clear()
    bare.space.sums = np.minimum(bare.space.sums, 1.0)
    bare.revision = 1
    return bare


def test_the_page_loads_nothing_and_escapes_names(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    map_id = save_map(uneven_room("<script>alert('hall')</script>"), tmp_path / "a.amrmap")
    page, facts = tmp_path / "a.html", tmp_path / "a.json"
    arguments = ["map", "report", str(tmp_path / "a.amrmap"), "--poses", "10"]
    assert main([*arguments, "--out", str(page), "--json", str(facts)]) == 0
    assert "cold starts" in capsys.readouterr().err
    text = page.read_text("utf-8")
    links = Links()
    links.feed(text)
    assert not links.open
    assert all(one.startswith(("data:image/png;base64,", "#")) for one in links.targets)
    assert "url(" not in text
    assert "@import" not in text
    assert str(map_id) in text
    assert "&lt;script&gt;" in text
    told = json.loads(facts.read_text("utf-8"))
    assert told["about"]["map_id"] == str(map_id)
    assert told["cold_starts"]["shares"]["alike"] == 0.0
    assert not told["look_alikes"]
    assert told["precision"]["quantiles_m"]["0.5"] < 0.05
    again = tmp_path / "again.json"
    assert main([*arguments, "--out", str(page), "--json", str(again)]) == 0
    date = re.compile(r'"made_at": "[^"]*"')
    assert date.sub("", again.read_text()) == date.sub("", facts.read_text())


def test_a_map_without_rays_and_counts(tmp_path: Path) -> None:
    save_map(imported(uneven_room()), tmp_path / "a.amrmap")
    facts = tmp_path / "a.json"
    done = main(
        ["map", "report", str(tmp_path / "a.amrmap"), "--poses", "10", "--json", str(facts),
         "--out", str(tmp_path / "a.html")]
    )  # fmt: skip
    assert done == 0
    told = json.loads(facts.read_text("utf-8"))
    assert not told["coverage"]["counted"]
    assert told["coverage"]["floor_m2"] == pytest.approx(44.3, rel=0.1)
    assert "does not tell how often" in (tmp_path / "a.html").read_text("utf-8")


@pytest.mark.parametrize(
    ("arguments", "status", "said"),
    [
        ([], 1, "no floor was seen free"),
        (["--config", "missing.toml"], 2, "missing.toml"),
        (["--out", "nowhere/a.html"], 2, "there is no folder"),
    ],
)
def test_what_cannot_be_reported_is_one_line(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    arguments: list[str],
    status: int,
    said: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    save_map(PointMap(MapParams(), "nothing"), tmp_path / "a.amrmap")
    assert main(["map", "report", "a.amrmap", *arguments]) == status
    *_, last = capsys.readouterr().err.splitlines()
    assert last.startswith("amr-slam: error: ")
    assert said in last
    assert not (tmp_path / "report.html").exists()


def test_borders_are_where_nobody_looked() -> None:
    """A room 8 m wide of which the map ends after 5 m."""
    known = map_of(room(), [(2.0, 2.0)])
    whole = coverage(known, reachable(known, SlamParams()), 0.5, 3)
    assert not whole.borders
    assert whole.floor_m2 == pytest.approx(48.0, rel=0.1)
    cut = known.space.centres()[:, 0] < 5.0
    known.space.keys, known.space.sums = known.space.keys[cut], known.space.sums[cut]
    walls = known.walls.centres()[:, 0] < 5.0
    known.walls.keys, known.walls.sums = known.walls.keys[walls], known.walls.sums[walls]
    known.revision += 1
    (border,) = coverage(known, reachable(known, SlamParams()), 0.5, 3).borders
    assert border.middle_m[0] == pytest.approx(4.95, abs=0.11)
    assert border.length_m == pytest.approx(5.3, abs=0.6)


def test_places_are_thinned_evenly_and_parts_are_told_apart() -> None:
    x, y = np.meshgrid(np.arange(0.25, 20.0, 0.5), np.arange(0.25, 10.0, 0.5))
    places = np.column_stack([x.ravel(), y.ravel()])
    few, spacing_m = thinned(places, 50, 0.5)
    assert 35 <= len(few) <= 75
    assert spacing_m == pytest.approx(2.0, abs=0.1)
    halves = places[np.abs(places[:, 0] - 10.0) > 1.0]
    assert len(np.unique(components(halves, 0.8))) == 2
