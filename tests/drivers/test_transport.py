from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator

import pytest

from amr_drivers.emulators.pty_line import PtyLine
from amr_drivers.errors import DriverError, LinkLost, LinkTimeout
from amr_drivers.transport import ByteStream

DEADLINE_S = 10.0


@pytest.fixture
def line() -> Iterator[PtyLine]:
    line = PtyLine()
    yield line
    line.unplug()


def read_all(stream: ByteStream, count: int) -> bytes:
    data = b""
    deadline = time.monotonic() + DEADLINE_S
    while len(data) < count:
        assert time.monotonic() < deadline
        data += stream.read(0.1)
    return data


def test_every_byte_passes_a_serial_line(line: PtyLine) -> None:
    stream = ByteStream(line.port, 500_000)
    sent = bytes(range(256)) * 8
    assert line.write(sent) == len(sent)
    assert read_all(stream, len(sent)) == sent
    assert stream.read(0.0) == b""
    stream.close()


def test_discarded_bytes_are_gone(line: PtyLine) -> None:
    stream = ByteStream(line.port, 500_000)
    line.write(b"old" * 100)
    assert stream.read(DEADLINE_S)
    stream.discard_input()
    line.write(b"new")
    assert read_all(stream, 3) == b"new"
    stream.close()


def test_hang_up_is_link_lost(line: PtyLine) -> None:
    stream = ByteStream(line.port, 500_000)
    line.unplug()
    for _ in range(2):
        with pytest.raises(LinkLost):
            stream.read(DEADLINE_S)
    stream.close()
    with pytest.raises(LinkLost, match="closed"):
        stream.discard_input()


@pytest.mark.parametrize("port", ["/dev/does-not-exist", "socket://127.0.0.1:1"])
def test_what_cannot_be_opened_is_link_lost(port: str) -> None:
    with pytest.raises(LinkLost, match=port):
        ByteStream(port, 500_000)


def test_a_converter_that_does_not_answer_is_a_time_out(monkeypatch: pytest.MonkeyPatch) -> None:
    def no_answer(*_: object, **__: object) -> socket.socket:
        raise TimeoutError("timed out")

    monkeypatch.setattr(socket, "create_connection", no_answer)
    with pytest.raises(LinkTimeout, match="timed out"):
        ByteStream("socket://192.0.2.1:4001", 500_000)


def test_an_impossible_port_is_a_mistake_in_the_settings() -> None:
    with pytest.raises(ValueError, match="gopher") as caught:
        ByteStream("gopher://scanner", 500_000)
    assert not isinstance(caught.value, DriverError)


def test_a_tcp_converter_passes_bytes_and_hangs_up() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        stream = ByteStream(f"socket://127.0.0.1:{server.getsockname()[1]}", 500_000)
        peer, _ = server.accept()
        with peer:
            sent = bytes(range(256)) * 40
            peer.sendall(sent)
            assert read_all(stream, len(sent)) == sent
            assert stream.read(0.0) == b""
        with pytest.raises(LinkLost):
            stream.read(DEADLINE_S)
        stream.close()


def test_close_ends_a_read_on_tcp() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        stream = ByteStream(f"socket://127.0.0.1:{server.getsockname()[1]}", 500_000)
        peer, _ = server.accept()
        ended: list[LinkLost] = []

        def wait() -> None:
            try:
                stream.read(60.0)
            except LinkLost as error:
                ended.append(error)

        reader = threading.Thread(target=wait)
        reader.start()
        stream.close()
        reader.join(DEADLINE_S)
        peer.close()
        assert len(ended) == 1
