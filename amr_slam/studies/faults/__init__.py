"""Faults, one after another, on a whole robot: the table of docs/reliability.md.

A simulated robot drives through a known room. Its devices are emulated and reached through the real
drivers, the daemon is a process of its own, and a listener of the fleet records what it publishes.
Each row of :data:`amr_slam.studies.faults.rows.ROWS` lets something fail and compares what was said
with what was true. Where nothing was said, or something untrue, the row names it.
"""
