"""VDA 5050, versions 2.1 and 3.0: the localization's part of what a vehicle tells a fleet control.

``visualization`` as a whole, the position with its errors and maps for the vehicle controller's
``state``, and the instant action that sets the pose: docs/vda5050.md.
"""

from amr_slam.encodings.vda5050.encoder import Vda5050Encoder, encoders
from amr_slam.encodings.vda5050.rights import vda5050_keys
from amr_slam.encodings.vda5050.settings import Vda5050Settings, Version

__all__ = [
    "Vda5050Encoder",
    "Vda5050Settings",
    "Version",
    "encoders",
    "vda5050_keys",
]
