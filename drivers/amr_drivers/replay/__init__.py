"""A recorded log instead of hardware, played in real time from its beginning.

All devices that name the same file play it together. For a log as fast as it goes there is
``amr-slam replay``; this is for the daemon and what listens to it.
"""
