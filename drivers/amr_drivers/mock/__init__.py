"""A simulated robot in a simulated laboratory instead of hardware, in this process.

All mock devices with the same seed are on the same robot. It drives its tour by itself, in real
time, and moves on only when a device is read.
"""
