"""What can go wrong at a device, as one family.

::

    DriverError
     +-- LinkLost     (ConnectionError)  the device or its line is gone: close, wait, open anew
     +-- LinkTimeout  (TimeoutError)     the other end exists and does not answer in time
     +-- BadTelegram  (ValueError)       bytes that are not what the protocol says

A setting that can never work (an unknown name in the DBC file, say) is not a device fault: drivers
raise a plain ``ValueError`` for it when they are opened, and the service refuses to start.
"""

from __future__ import annotations


class DriverError(Exception):
    """Any fault of a device or its line. Example: ``except DriverError`` in the reconnect loop."""


class LinkLost(DriverError, ConnectionError):  # noqa: N818 - says what happened
    """The device or its line is gone.

    Example: the USB adapter of a scanner is pulled, a CAN interface is set down.
    """


class LinkTimeout(DriverError, TimeoutError):  # noqa: N818 - says what happened
    """The other end exists but does not answer in time.

    Example: a serial-to-Ethernet converter that is switched off leaves ``connect`` without answer.
    """


class BadTelegram(DriverError, ValueError):  # noqa: N818 - says what happened
    """A telegram or frame that breaks its protocol.

    Example: a scan of 536 values from a scanner that is configured for 541.
    """
