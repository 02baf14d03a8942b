"""Device drivers of amr-slam, and the emulators that stand in for the devices."""
