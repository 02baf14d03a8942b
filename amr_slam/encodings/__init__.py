"""Further forms of what a robot says, for readers that have formats of their own.

Same estimate, same ``seq``, ``epoch`` and stamp as the JSON messages of :mod:`amr_slam.wire`; each
form is switched on in the configuration. Pure: an encoder makes bytes of messages, and commands of
bytes; :mod:`amr_slam.publishing` and :mod:`amr_slam.serving` carry them.
"""

from amr_slam.encodings.base import Encoded, Encoder, Inlet, Lane, MapPicture, Outlet, Request

__all__ = ["Encoded", "Encoder", "Inlet", "Lane", "MapPicture", "Outlet", "Request"]
