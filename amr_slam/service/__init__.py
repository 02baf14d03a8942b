"""The composition root: devices, SLAM process, fusion and Zenoh put together and kept running.

Nothing is imported here: the command line reads the configuration before it imports the daemon.
"""
