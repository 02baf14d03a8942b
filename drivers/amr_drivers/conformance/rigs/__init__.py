"""This package's drivers in front of their emulators, a module a driver."""
