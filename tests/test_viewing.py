"""Who a view lets in, and what it makes of maps and of the past: without a browser."""

from __future__ import annotations

import http.client
import json
import os
import ssl
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from messages import pose_of
from test_publishing import free_endpoint

from amr_slam.client import RobotView
from amr_slam.map import MapParams, PointMap, save_map
from amr_slam.map.layers import LayerKind, Layers
from amr_slam.samples import State
from amr_slam.studies.browsing import view_process
from amr_slam.viewing import ViewError, ViewSettings
from amr_slam.viewing.access import Right, grant, names_of, read_tokens, tls
from amr_slam.viewing.drawing import MAX_POINTS, drawn, thinned
from amr_slam.viewing.history import COLUMNS, PERIOD_S, SPAN_S, STATES, History
from amr_slam.watching import row_of

LOOK, COMMAND = "l" * 32, "c" * 32


@pytest.fixture
def tokens(tmp_path: Path) -> Path:
    path = tmp_path / "tokens"
    path.write_text(f"# the control room\nlook {LOOK}\n\ncommand {COMMAND}  # the foreman\n")
    path.chmod(0o600)
    return path


def test_tokens_give_their_right_and_no_other(tokens: Path) -> None:
    access, made = grant(ViewSettings(tokens=tokens, allow_commands=True))
    assert made is None
    assert access.right_of(LOOK) is Right.LOOK
    assert access.right_of(COMMAND) is Right.COMMAND
    for wrong in (None, "", LOOK[:-1], COMMAND.upper(), "\udcff"):
        assert access.right_of(wrong) is None
    looking, _ = grant(ViewSettings(tokens=tokens))
    assert looking.right_of(COMMAND) is Right.LOOK  # without --allow-commands


def test_this_computer_looks_without_a_token_and_commands_with_the_one_made() -> None:
    plain, made = grant(ViewSettings())
    assert (plain.right_of(None), made) == (Right.LOOK, None)
    commanding, made = grant(ViewSettings(allow_commands=True))
    assert made is not None
    assert len(made) >= 32
    assert (commanding.right_of(None), commanding.right_of(made)) == (Right.LOOK, Right.COMMAND)


@pytest.mark.parametrize(
    ("text", "mode", "complaint"),
    [
        (f"look {LOOK}\n", 0o644, "others may read the tokens in it; chmod 600"),
        ("look short\n", 0o600, ":1: a token has 24 to 256 characters"),
        (f"\nadmin {LOOK}\n", 0o600, ":2: should be 'look TOKEN' or 'command TOKEN'"),
        ("# none\n", 0o600, "no token in it"),
        ("x" * 70_000, 0o600, "more than 65536 bytes"),
    ],
)
def test_files_of_tokens_are_refused_in_one_line(
    tmp_path: Path, text: str, mode: int, complaint: str
) -> None:
    path = tmp_path / "tokens"
    path.write_text(text)
    path.chmod(mode)
    with pytest.raises(ViewError) as refused:
        read_tokens(path)
    assert complaint in str(refused.value)
    assert LOOK not in str(refused.value)


@pytest.mark.parametrize("host", ["0.0.0.0", "192.168.1.9", "::"])
def test_others_are_not_served_without_tokens_and_tls(host: str, tokens: Path) -> None:
    for given in ({}, {"tokens": tokens}, {"certificate": tokens, "key": tokens}):
        with pytest.raises(ViewError, match=r"--tokens FILE --cert FILE --key FILE$"):
            grant(ViewSettings(host=host, **given))  # type: ignore[arg-type]


def test_half_a_certificate_is_none(tokens: Path) -> None:
    with pytest.raises(ViewError, match="belong together"):
        tls(ViewSettings(certificate=tokens))
    with pytest.raises(ViewError, match="no certificate with its key"):
        tls(ViewSettings(certificate=tokens, key=tokens))


def test_only_its_own_names_mean_this_server() -> None:
    names = names_of(ViewSettings(), 8080)
    assert names == {"localhost:8080", "127.0.0.1:8080", "[::1]:8080"}
    assert "localhost" in names_of(ViewSettings(), 80)


def asked(
    address: str, method: str, path: str, headers: dict[str, str], body: str = ""
) -> tuple[int, str, dict[str, str]]:
    scheme, _, host = address.rstrip("/").partition("://")
    if scheme == "https":
        context = ssl.create_default_context()
        context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
        connection: http.client.HTTPConnection = http.client.HTTPSConnection(
            host, timeout=60.0, context=context
        )
    else:
        connection = http.client.HTTPConnection(host, timeout=60.0)
    connection.request(method, path, body, headers)
    answer = connection.getresponse()
    told = answer.status, answer.read().decode(errors="replace"), dict(answer.headers)
    connection.close()
    return told


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    """Of a view with nobody at its endpoint: it is there all the same, and says so."""
    with view_process(free_endpoint(), ["--allow-commands"]) as view:
        yield view.address.partition("#")[0]


@pytest.mark.parametrize(
    ("method", "path", "headers", "status"),
    [
        ("GET", "/", {}, 200),
        ("GET", "/main.js", {}, 200),
        ("GET", "/api/history", {}, 503),
        ("GET", "/", {"Host": "evil.example"}, 421),
        ("GET", "/", {"Host": "evil.example:80"}, 421),
        ("GET", "/api/history", {"Origin": "http://evil.example"}, 403),
        ("GET", "/ws", {}, 403),
        ("GET", "/ws", {"Origin": "null"}, 403),
        ("POST", "/api/command", {}, 403),
        ("POST", "/api/command", {"Origin": "http://evil.example"}, 403),
        ("GET", "/..%2f..%2fsettings.py", {}, 404),
        ("GET", "/nothing.js", {}, 404),
        ("DELETE", "/", {}, 403),
    ],
)
def test_what_is_not_from_its_own_page_is_refused(
    address: str, method: str, path: str, headers: dict[str, str], status: int
) -> None:
    found, _, told = asked(address, method, path, headers)
    assert found == status
    if status == 200:
        assert "default-src 'none'" in told["Content-Security-Policy"]
        assert told["X-Content-Type-Options"] == "nosniff"


def test_the_page_loads_nothing_from_elsewhere() -> None:
    folder = Path(__file__).parent.parent / "amr_slam/viewing/static"
    for path in folder.iterdir():
        text = path.read_text().replace("http://www.w3.org/2000/svg", "")
        assert "http:" not in text, path
        assert "https:" not in text.replace('"https:"', ""), path
        assert "innerHTML" not in text, path  # what robots say is no markup


def test_over_tls_nobody_looks_without_a_token(tmp_path: Path, tokens: Path) -> None:
    make_certificate(tmp_path)
    arguments = [
        "--host", "127.0.0.1", "--tokens", str(tokens),
        "--cert", str(tmp_path / "cert.pem"), "--key", str(tmp_path / "key.pem"),
    ]  # fmt: skip
    with view_process(free_endpoint(), arguments) as view:
        assert view.address.startswith("https://")
        assert asked(view.address, "GET", "/api/history", {})[0] == 401
        right = {"Authorization": f"Bearer {LOOK}"}
        assert asked(view.address, "GET", "/api/history", right)[0] == 503  # nobody at Zenoh
        port = view.address.rstrip("/").rpartition(":")[2]
        named = {"Host": f"view.hall3:{port}"}  # a name in the certificate
        assert asked(view.address, "GET", "/", named)[0] == 200


def make_certificate(folder: Path) -> None:
    openssl = (
        "openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -days 2 "
        f"-keyout {folder}/key.pem -out {folder}/cert.pem -subj /CN=view "
        "-addext subjectAltName=DNS:view.hall3,IP:127.0.0.1 2>/dev/null"
    )
    assert os.system(openssl) == 0


def unpacked(packed: bytes) -> tuple[dict[str, Any], np.ndarray[Any, Any]]:
    (length,) = struct.unpack_from("<I", packed)
    return json.loads(packed[4 : 4 + length]), np.frombuffer(packed[4 + length :], "<f4")


def test_the_past_is_kept_for_ten_minutes_and_no_longer() -> None:
    history = History()
    states = [State.LOCALIZED, State.LOST]
    for turn in range(round(2 * SPAN_S / PERIOD_S)):
        pose = pose_of(x=float(turn), state=states[turn % 200 == 199])
        view = RobotView(robot="amr7", alive=True, pose=pose, pose_received_s=np.inf)
        history.record([row_of(view)], PERIOD_S * turn)
        history.record([row_of(view)], PERIOD_S * turn + 0.1)  # too soon, and nothing new
    header, values = unpacked(history.packed(2 * SPAN_S))
    rows = values.reshape(-1, len(COLUMNS))
    assert header["robots"] == [{"robot": "amr7", "rows": len(rows)}]
    assert len(rows) == round(SPAN_S / PERIOD_S)
    assert rows[:, 0] == pytest.approx(PERIOD_S * np.arange(len(rows)), abs=1e-3)
    assert rows[-1, 1] == 2 * SPAN_S / PERIOD_S - 1
    assert {STATES[int(state)] for state in rows[:, -1]} == {"localized", "lost"}


def test_a_map_is_drawn_and_what_is_none_is_refused_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / "a.amrmap"
    empty = PointMap(MapParams(), "empty")
    triangle = np.array([[0.0, 0.0], [1.0, 0.0], [0.5, 2.0]])
    empty.edit(Layers().with_drawn([(LayerKind.ZONE, "racks", triangle)], "somebody", 0))
    save_map(empty, path)
    header, values = unpacked(drawn(path.read_bytes()))
    assert (header["name"], header["points"], len(values)) == ("empty", 0, 0)
    assert header["layers"] == [{"kind": "zone", "name": "racks", "points_m": triangle.tolist()}]
    for junk in (b"", b"AMRMAP\r\n", path.read_bytes()[:-1], np.random.default_rng(1).bytes(100)):
        with pytest.raises(ValueError, match=r"^[^\n]+$"):
            drawn(junk)


def test_a_huge_map_is_thinned_all_over() -> None:
    side = 600
    x, y = np.meshgrid(np.arange(side) * 0.05, np.arange(side) * 0.05)
    points = np.column_stack([x.ravel(), y.ravel()]).astype("<f4")
    kept = thinned(points)
    assert MAX_POINTS / 4 < len(kept) <= MAX_POINTS < len(points)
    corner = {tuple(cell) for cell in np.floor(kept / 1.0).astype(int)}
    assert len(corner) == 30 * 30  # each square metre still has some
    few = points[:1000]
    assert thinned(few) is few
