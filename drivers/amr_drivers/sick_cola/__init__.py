"""SICK LMS1xx, LMS5xx, TiM5xx and TiM7xx over TCP: CoLa A and CoLa B."""
