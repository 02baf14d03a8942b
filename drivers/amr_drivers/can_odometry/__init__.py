"""Wheel encoders on CAN, described by a DBC file."""
