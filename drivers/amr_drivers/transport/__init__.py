"""Serial lines, TCP streams and UDP ports with time-outs, and nothing else.

The only part with pyserial or sockets. Traps that it covers are listed in the protocol fact sheet,
section F. An open line is read by one thread; ``close`` may come from any other.
"""

from amr_drivers.transport.serial_line import ByteStream
from amr_drivers.transport.tcp import TcpStream
from amr_drivers.transport.udp import DatagramPort

__all__ = ["ByteStream", "DatagramPort", "TcpStream"]
