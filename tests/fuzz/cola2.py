"""CoLa 2 telegrams, and the values of variables in them."""

from __future__ import annotations

import contextlib
import zlib

from amr_drivers.errors import BadTelegram
from amr_drivers.sick_safety import variables
from amr_drivers.sick_safety.cola2 import (
    MAX_LENGTH,
    Command,
    Frame,
    FrameReader,
    call_method,
    close_session,
    decode_frame,
    encode_frame,
    error_code,
    error_text,
    open_session,
    read_variable,
)

_BY_BYTES = 64
"""Longest input that is also fed byte by byte."""


def target(data: bytes) -> None:
    """One input to the reader, to the decoder of one frame, and to what reads the values."""
    reader = FrameReader()
    frames = reader.feed(data)
    assert len(reader._buffer) <= 2 * MAX_LENGTH
    # Byte by byte costs most: a fourth of the inputs, and four times as many of them.
    if len(data) <= _BY_BYTES and zlib.crc32(data) & 3 == 0:
        single = FrameReader()
        assert [f for at in range(len(data)) for f in single.feed(data[at : at + 1])] == frames
        assert single.damaged == reader.damaged
    if not frames:
        with contextlib.suppress(BadTelegram):
            frames.append(decode_frame(data))
    for frame in frames:
        assert decode_frame(encode_frame(frame)) == frame
        _read_values(frame)


def _read_values(frame: Frame) -> None:
    with contextlib.suppress(BadTelegram):
        assert error_text(error_code(frame))
    for decode in (
        variables.decode_text,
        variables.decode_overview,
        variables.decode_configuration,
        variables.actions,
    ):
        with contextlib.suppress(BadTelegram):
            decode(frame.data)
    try:
        stream = variables.decode_stream(frame.data)
    except BadTelegram:
        return
    # Angles of a quarter million turns do not come back to the bit; no device means them.
    assert variables.decode_stream(variables.encode_stream(stream)).port == stream.port


def seeds() -> list[bytes]:
    """Each kind of question and answer."""
    session = 0x7361_CF5F
    stream = variables.Stream(
        channel=1, enabled=True, interface=4, receiver="192.168.1.100", port=6060
    )
    overview = variables.StatusOverview(
        version="R.1.0.0",
        device_state=3,
        configuration_state=1,
        application_state=1,
        power_on_count=17,
        time_ms=1,
        date=2,
        error_code=3,
    )

    def answer(command: Command, payload: bytes, address: bytes = b"") -> Frame:
        return Frame(session=session, request=3, command=command, payload=payload, address=address)

    frames = [
        open_session(1, 60),
        close_session(session, 9),
        read_variable(session, 2, variables.LATEST_TELEGRAM),
        call_method(session, 3, variables.CHANGE_STREAM, variables.encode_stream(stream)),
        answer(Command.OPENED, b""),
        answer(Command.FAILED, b"\x21\x00"),
        answer(Command.FAILED, b"\x00\x22"),
        answer(Command.VALUE, b"\x0d\x00" + variables.encode_text("NANS3-CAAZ30AN1")),
        answer(Command.VALUE, b"\x17\x00" + variables.encode_overview(overview)),
        answer(Command.VALUE, b"\x10\x00" + variables.encode_actions(0x81), b"\x01\x02\x03\x04"),
    ]
    raw = [encode_frame(frame) for frame in frames]
    return [*raw, raw[0] + raw[2], b"\x02\x02" + raw[4] + b"\x02\x02\x02\x02"]
