"""A robot's computer in qemu: started, asked, unplugged, put back to an earlier instant, cut off.

Guest time is virtual (-icount): a nanosecond for each instruction, whatever else the host does. So
time limits mean on any host what they mean on a computer that executes 10^9 instructions a second.
"""

from __future__ import annotations

import json
import os
import selectors
import shutil
import socket
import subprocess
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Self

SCANNERS: Final = ("front", "rear")
_ANSWER_S: Final = 3600.0
"""Of the host: a guest second may take a minute where others want the processors, too."""
_KERNEL_ARGUMENTS: Final = (
    "console=ttyS0 tsc_early_khz=1000000 tsc=reliable panic=-1 quiet mitigations=off nokaslr"
    " audit=0 random.trust_cpu=on net.ifnames=0 systemd.show_status=0"
)


class MachineError(Exception):
    """qemu or the agent in the guest did not do what they were told."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """What a command in the guest came to."""

    status: int | None
    """None: it was not done within its limit."""
    output: str
    began_s: float
    ended_s: float
    """On the guest's CLOCK_MONOTONIC."""


class Machine:
    """One virtual computer. A context manager; leaving it cuts the power."""

    def __init__(self, image: Path, folder: Path, *, accelerator: str, fresh: bool = True) -> None:
        """``image``: what image.sh made. ``folder``: for disks and sockets; with ``fresh`` the
        disks are the image's, otherwise those that an earlier machine left there."""
        self._folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        for disk in ("root", "state") if fresh else ():
            _run("qemu-img", "create", "-q", "-f", "qcow2", "-F", "raw", "-b",
                 image.resolve() / f"{disk}.ext4", folder / f"{disk}.qcow2")  # fmt: skip
        for stale in folder.glob("*.sock"):
            stale.unlink()
        self._cables = {name: _Cable(folder, name) for name in SCANNERS}
        command = [*_qemu(image, accelerator), *self._devices()]
        self._log = (folder / "qemu.log").open("w")
        self._process = subprocess.Popen(
            command, cwd=folder, stdin=subprocess.DEVNULL, stdout=self._log, stderr=self._log
        )
        try:
            self._control = _Line(folder / "control.sock", self._process)
            self._control.read()  # the greeting
            self._tell("qmp_capabilities")
            self._agent = _Line(folder / "agent.sock", self._process)
        except BaseException:
            self.cut_power()
            raise

    def _devices(self) -> list[str]:
        words = ["-chardev", "socket,id=control,path=control.sock,server=on,wait=off"]
        words += ["-mon", "chardev=control,mode=control"]
        for disk in ("root", "state"):
            words += ["-drive", f"id={disk},if=none,format=qcow2,file={disk}.qcow2"]
            words += ["-device", f"virtio-blk-pci,drive={disk}"]
        words += ["-device", "virtio-serial-pci"]
        for port in ("agent", *SCANNERS):
            words += ["-chardev", f"socket,id={port},path={port}.sock,server=on,wait=off"]
            words += ["-device", f"virtserialport,chardev={port},name={port}"]
        # Two controllers on one bus: the robot's (can0), and that of the emulated drives (can1).
        words += ["-object", "can-bus,id=bus"]
        words += 2 * ["-device", "kvaser_pci,canbus=bus"]
        return [*words, "-device", "qemu-xhci,id=usb"]

    # -- commands in the guest -------------------------------------------------------------

    def run(self, command: str, *, limit_s: float = 60.0, check: bool = True) -> Answer:
        """Run a shell command; ``limit_s`` in guest time. Raises MachineError where it fails."""
        request = json.dumps({"run": command, "limit_s": limit_s})
        self._agent.write(request.encode() + b"\n")
        answer = Answer(**json.loads(self._agent.read()))
        if check and answer.status != 0:
            raise MachineError(f"{command!r}: status {answer.status}: {answer.output.strip()}")
        return answer

    def until(self, command: str, *, limit_s: float, every_s: float = 0.1) -> Answer:
        """Repeat a command in the guest until it succeeds; the answer's times span all attempts."""
        loop = f"until {{ {command}\n}}; do sleep {every_s}; done"
        return self.run(loop, limit_s=limit_s)

    # -- what is done to it from outside -----------------------------------------------------

    def plug_scanner(self, name: str) -> None:
        """Its serial adapter comes into its socket: a USB device with its serial number."""
        self._cables[name].connect()
        address = {"type": "unix", "data": {"path": f"{name}-usb.sock"}}
        backend = {"type": "socket", "data": {"addr": address, "server": False}}
        self._tell("chardev-add", id=f"{name}-usb", backend=backend)
        self._tell(
            "device_add", driver="usb-serial", id=f"scanner-{name}", bus="usb.0",
            chardev=f"{name}-usb", serial=f"A9-{name.upper()}",
        )  # fmt: skip

    def unplug_scanner(self, name: str) -> None:
        """Pulled out of its socket."""
        self._tell("device_del", id=f"scanner-{name}")
        deadline_s = time.monotonic() + 60.0
        while True:
            try:
                self._tell("chardev-remove", id=f"{name}-usb")
            except MachineError:  # still in use by the device that is on its way out
                if time.monotonic() > deadline_s:
                    raise
                time.sleep(0.1)
            else:
                return

    def keep(self, name: str) -> None:
        """Remember this instant: disks, memory, devices. No scanner may be plugged in."""
        said = self._tell("human-monitor-command", **{"command-line": f"savevm {name}"})
        if said:
            raise MachineError(f"savevm: {said}")

    def return_to(self, name: str) -> None:
        """Put everything back to a kept instant."""
        said = self._tell("human-monitor-command", **{"command-line": f"loadvm {name}"})
        if said:
            raise MachineError(f"loadvm: {said}")

    def cut_power(self) -> None:
        """The disks are as they were at that instant: what was not yet written is lost."""
        self._process.kill()
        self._process.wait()
        for line in ("_control", "_agent"):
            if hasattr(self, line):
                getattr(self, line).close()
        for cable in self._cables.values():
            cable.close()
        self._log.close()

    def _tell(self, execute: str, **arguments: Any) -> Any:
        self._control.write(json.dumps({"execute": execute, "arguments": arguments}).encode())
        while True:
            said = json.loads(self._control.read())
            if "error" in said:
                raise MachineError(f"{execute}: {said['error']['desc']}")
            if "return" in said:  # anything else is an event
                return said["return"]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.cut_power()


class _Line:
    """Lines of JSON to and from a socket of qemu."""

    def __init__(self, path: Path, process: subprocess.Popen[bytes]) -> None:
        self._process = process
        self._socket = socket.socket(socket.AF_UNIX)
        self._socket.settimeout(_ANSWER_S)
        self._rest = b""
        deadline_s = time.monotonic() + 30.0
        while True:
            try:
                # Sockets' paths may have 108 bytes at most.
                self._socket.connect(os.path.relpath(path))
            except OSError as error:
                if process.poll() is not None or time.monotonic() > deadline_s:
                    raise MachineError(f"{path.with_name('qemu.log')}: no qemu: {error}") from error
                time.sleep(0.05)
            else:
                return

    def write(self, data: bytes) -> None:
        self._socket.sendall(data)

    def read(self) -> bytes:
        while b"\n" not in self._rest:
            data = self._socket.recv(65536)
            if not data:
                raise MachineError(f"qemu has ended with status {self._process.wait()}")
            self._rest += data
        line, _, self._rest = self._rest.partition(b"\n")
        return line

    def close(self) -> None:
        self._socket.close()


class _Cable:
    """From an emulated scanner's port in the guest to the USB adapter that the guest sees.

    Passes bytes on while the adapter is in its socket; otherwise they are lost, as on a real cable.
    """

    def __init__(self, folder: Path, name: str) -> None:
        self._scanner = folder / f"{name}.sock"
        self._closed = threading.Event()
        self._usb: socket.socket | None = None
        self._server = socket.socket(socket.AF_UNIX)
        self._server.bind(os.path.relpath(folder / f"{name}-usb.sock"))
        self._server.listen(1)
        self._thread = threading.Thread(target=self._pass_on, daemon=True)

    def connect(self) -> None:
        """qemu may come for the adapter's end from now on."""
        if not self._thread.is_alive() and not self._closed.is_set():
            self._thread.start()

    def close(self) -> None:
        self._closed.set()
        if self._thread.is_alive():
            self._thread.join()
        self._server.close()

    def _pass_on(self) -> None:
        with socket.socket(socket.AF_UNIX) as scanner, selectors.DefaultSelector() as ready:
            scanner.connect(os.path.relpath(self._scanner))
            ready.register(scanner, selectors.EVENT_READ)
            ready.register(self._server, selectors.EVENT_READ)
            while not self._closed.is_set():
                for key, _ in ready.select(0.1):
                    if key.fileobj is self._server:
                        self._unplugged()
                        self._usb, _ = self._server.accept()
                    elif not self._carry(scanner):
                        return
            self._unplugged()

    def _carry(self, scanner: socket.socket) -> bool:
        try:
            data = scanner.recv(4096)
            if self._usb is not None and data:
                self._usb.send(data, socket.MSG_DONTWAIT)
        except BlockingIOError:
            return True  # the adapter takes no more: lost
        except (BrokenPipeError, ConnectionResetError):
            self._unplugged()
            return True
        return bool(data)

    def _unplugged(self) -> None:
        if self._usb is not None:
            self._usb.close()
            self._usb = None


def _qemu(image: Path, accelerator: str) -> list[str]:
    timing = ["-cpu", "host"]
    if accelerator == "tcg":
        timing = ["-cpu", "Nehalem-v1", "-icount", "shift=0,sleep=on", "-rtc", "clock=vm"]
    return [
        *(
            "setpriv",
            "--pdeathsig",
            "KILL",
            "nice",
            "-n",
            "10",
            "qemu-system-x86_64",
            "-accel",
            accelerator,
            *timing,
        ),
        *("-M", "pc", "-smp", "1", "-m", "1024", "-nodefaults", "-no-user-config"),
        *("-display", "none", "-no-reboot", "-serial", "file:console.log"),
        *(
            "-kernel",
            str(image.resolve() / "vmlinuz"),
            "-initrd",
            str(image.resolve() / "initrd.gz"),
        ),
        *("-append", _KERNEL_ARGUMENTS, "-device", "virtio-rng-pci"),
    ]


def _run(*command: str | Path) -> None:
    subprocess.run(command, check=True, stdin=subprocess.DEVNULL)


def missing() -> str | None:
    """What this host lacks for a machine, or None."""
    for program in ("qemu-system-x86_64", "qemu-img"):
        if shutil.which(program) is None:
            return f"needs {program}"
    return None
