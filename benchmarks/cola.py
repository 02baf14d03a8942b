"""How fast telegrams of LMS and TiM become scans: ``python benchmarks/cola.py``.

Bytes of the emulated devices through the driver's decoder, in pieces of a network packet. Processor
time; the share is that of one processor at the device's full rate.
"""

from __future__ import annotations

import time

import numpy as np

from amr_drivers.emulators.cola import MODELS
from amr_drivers.emulators.cola.device import ColaDevice
from amr_drivers.sick_cola.driver import Settings, scan_decoder
from amr_drivers.sick_cola.framing import Dialect

_SCANS = 300
_PACKET = 1460


def main() -> None:
    """Measure and print, a row a device and dialect."""
    print("| device | dialect | bytes a scan | MB/s | us a scan | CPU at full rate |")
    print("|---|---|---|---|---|---|")
    for name, model in MODELS.items():
        for dialect in Dialect:
            device = ColaDevice(model, dialect, started_us=0, no_return_m=None)
            stream = bytearray()
            for ranges in np.random.default_rng(1).uniform(0.5, 20.0, (_SCANS, model.beams)):
                device.measure(ranges)
                stream += device.scan("sSN")
            took_s = min(_decoded_s(bytes(stream)) for _ in range(5))
            rate, each_us = 1e-6 * len(stream) / took_s, 1e6 * took_s / _SCANS
            share = 1e-4 * each_us / model.period_s
            row = f"{len(stream) // _SCANS} | {rate:.0f} | {each_us:.0f} | {share:.2f} %"
            print(f"| {name} | CoLa {dialect.upper()} | {row} |")


def _decoded_s(stream: bytes) -> float:
    decoder = scan_decoder("bench", Settings(host="none", latency_limit_s=1.0), 0)
    begun_s = time.process_time()
    got = sum(
        len(decoder.received(stream[at : at + _PACKET], at))
        for at in range(0, len(stream), _PACKET)
    )
    took_s = time.process_time() - begun_s
    if got != _SCANS:
        raise RuntimeError(f"{got} of {_SCANS} scans came through")
    return took_s


if __name__ == "__main__":
    main()
