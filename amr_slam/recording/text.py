"""Lines of text files from outside: bounded in length and number, plain or gzip."""

from __future__ import annotations

import gzip
import zlib
from collections.abc import Iterator
from io import BufferedReader
from pathlib import Path

from amr_slam.recording.values import RecordingError

# A ROBOTLASER line of 2,000 beams with remissions has 40 kB.
_LINE_BOUND_BYTES = 1 << 18
# Hours of one scanner at its full rate; what unpacks to more is no log but a bomb.
_TEXT_BOUND_BYTES = 1 << 30
_GZIP_MAGIC = b"\x1f\x8b"


def read_lines(path: Path) -> Iterator[tuple[int, str]]:
    """(line number from 1, line without its end) of every line that is not blank or a comment.

    Raises RecordingError when the file cannot be read, unpacked or decoded, or breaks a bound.
    """
    number = total = 0
    try:
        with _open(path) as stream:
            while line := stream.readline(_LINE_BOUND_BYTES + 1):
                number += 1
                total += len(line)
                _check_bounds(len(line), total)
                stripped = line.strip()
                if stripped and not stripped.startswith((b"#", b"//")):
                    yield number, stripped.decode("ascii")
    except UnicodeDecodeError:
        raise RecordingError(f"{path}:{number}: not plain ASCII text") from None
    except ValueError as error:
        raise RecordingError(f"{path}:{number}: {error}") from None
    except (OSError, EOFError, zlib.error) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else error
        raise RecordingError(f"{path}: cannot be read after line {number}: {reason}") from None


def _check_bounds(line_bytes: int, total_bytes: int) -> None:
    if line_bytes > _LINE_BOUND_BYTES:
        raise ValueError(f"line longer than {_LINE_BOUND_BYTES} bytes")
    if total_bytes > _TEXT_BOUND_BYTES:
        raise ValueError(f"the text is larger than {_TEXT_BOUND_BYTES} bytes")


def _open(path: Path) -> BufferedReader | gzip.GzipFile:
    with path.open("rb") as probe:
        packed = probe.read(len(_GZIP_MAGIC)) == _GZIP_MAGIC
    return gzip.open(path, "rb") if packed else path.open("rb")
