"""Many robots, one router, one controller, each in processes of their own on this machine.

``router``, ``robots`` and ``controller`` are programs (``python -m amr_slam.studies.fleet.robots``)
that run until their standard input ends and then say what they have seen in one line of JSON;
:mod:`.processes` starts them, :mod:`.measuring` measures, ``benchmarks/fleet.py`` prints. The tests
use the same programs.
"""
