"""The other ends of devices: for the demo, the tests and people without hardware."""
