"""Localization of mobile robots from slow laser scanners and fast wheel odometry."""
