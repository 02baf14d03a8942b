"""Drives that speak CANopen by the CiA 402 profile."""
