"""The one owner of state: samples in, outcomes and pose estimates out.

No thread, no clock, no socket: the daemon, the replay and the tests feed it the same samples and
get the same result. Registration is somebody else's work: :meth:`Localizer.take_request` hands it
out, the result comes back as a sample like any other.

Its rooms: the fused pose (``fused.py``), what a registered scan makes of it (``placing.py``), what
people say (``commands.py``) and what is told to them (``estimates.py``).
"""

from amr_slam.localizer.localizer import Localizer, Sample
from amr_slam.mounting import Mounting
from amr_slam.trust import LocalizerParams

__all__ = ["Localizer", "LocalizerParams", "Mounting", "Sample"]
