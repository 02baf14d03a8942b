"""SICK microScan3, nanoScan3 and outdoorScan3: polled over CoLa 2 or streamed over UDP."""
