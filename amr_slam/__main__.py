"""``python -m amr_slam``: the same as ``amr-slam``."""

import sys

from amr_slam.cli import main

sys.exit(main())
