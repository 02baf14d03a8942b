"""What the robot must survive: each case breaks something and measures what became of it.

A case returns what it measured and raises NotMetError with it where that is not what must be. All
run in one machine, in this order; each leaves the robot localized.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from system.machine import SCANNERS
from system.robot import LOCALIZED, UNIT, Heard, Robot

MAP: Final = "/var/lib/amr-slam/maps/hall.amrmap"


class NotMetError(Exception):
    """The product did not do what it must; says what was measured."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """One row of the table."""

    name: str
    must: str
    run: Callable[[Robot], str]


def installed(robot: Robot) -> str:
    folder = "/opt/system-test/sources"
    again = robot.machine.run(f"python3 {folder}/tools/install.py --wheel {folder}/*.whl").output
    _hold("write" not in again and "pip" not in again, f"a second installation did: {again}")
    names = robot.machine.run("ls /dev/amr").output.split()
    _hold(names == ["scanner-front", "scanner-rear"], f"/dev/amr has {names}")
    bus = robot.machine.run("ip -d link show can0").output
    _hold("state UP" in bus and "restart-ms 100" in bus, f"can0: {bus}")
    _hold("bitrate 500000" in bus, f"can0: {bus}")
    return "a second run changes nothing; /dev/amr/scanner-front and -rear; can0 up at 500 kbit/s"


def service_starts(robot: Robot) -> str:
    for name in SCANNERS:
        robot.machine.unplug_scanner(name)
    robot.machine.until("modprobe -r ftdi_sio usbserial", limit_s=10.0)
    mark = robot.mark()
    robot.machine.run(f"systemctl start {UNIT}", limit_s=90.0)
    plugged_s = robot.machine.run("true").ended_s
    for name in SCANNERS:
        robot.machine.plug_scanner(name)
    localized_s = robot.hears(LOCALIZED, mark, 30.0)
    measured = f"READY after {robot.ready_s():.1f} s without a scanner"
    _hold(localized_s is not None, f"{measured}, not localized 30 s after they came")
    assert localized_s is not None
    return f"{measured}, localized {localized_s - plugged_s:.1f} s after they came"


def poses_flow(robot: Robot) -> str:
    mark = robot.mark()
    robot.machine.run("sleep 10")
    heard = robot.heard(mark)
    stamps = [pose.message["stamp"] for pose in heard if pose.kind == "pose"]
    gaps = sorted(b - a for a, b in itertools.pairwise(stamps))
    wheels = [status.message["wheels"] for status in heard if status.kind == "status"][-1]
    rate_hz = (len(stamps) - 1) / (stamps[-1] - stamps[0])
    measured = (
        f"{rate_hz:.1f} Hz, period p99 {1e3 * gaps[int(0.99 * len(gaps))]:.0f} ms, max"
        f" {1e3 * gaps[-1]:.0f} ms; wheels {wheels['rate_hz']:.1f} Hz, {wheels['errors']} errors"
    )
    _hold(rate_hz > 40.0 and wheels["link"] == "OK", measured)
    return f"{measured}; {_truthful(robot, heard)}"


def clock_is_stepped(robot: Robot) -> str:
    mark = robot.mark()
    robot.machine.run("date -s '+1 hour'")
    told_s = robot.hears('status .*"clock_steps": *1', mark, 10.0)
    _hold(told_s is not None, "no status tells of the step within 10 s")
    heard = robot.heard(mark)
    states = {pose.message["state"] for pose in heard if pose.kind == "pose"}
    measured = f"longest silence {1e3 * _longest_gap_s(heard):.0f} ms, states {sorted(states)}"
    _hold(states == {"localized"}, measured)
    return f"{measured}, told in status; {_truthful(robot, heard)}"


def interface_goes_down(robot: Robot) -> str:
    return _wheels_fail(robot, "ip link set can0 down", "ip link set can0 up")


def controller_is_bus_off(robot: Robot) -> str:
    # A controller that is off hears nothing until it is started again.
    off = "ip link set can1 down; cansend can0 20000040#0000000000000000"
    return _wheels_fail(robot, off, "ip link set can1 up")


def scanner_is_pulled(robot: Robot) -> str:
    mark, pid = robot.mark(), robot.property("MainPID")
    pulled_s = robot.machine.run("true").ended_s
    robot.machine.unplug_scanner("front")
    lost_s = robot.hears('status .*"front": *{"link": *"LOST"', mark, 10.0)
    _hold(lost_s is not None, "not told within 10 s")
    robot.machine.run("sleep 4")
    without = robot.heard(mark)
    mark = robot.mark()
    robot.machine.plug_scanner("front")
    linked_s = robot.machine.until("[ -e /dev/amr/scanner-front ]", limit_s=20.0).ended_s
    back_s = robot.hears('status .*"front": *{"link": *"OK"', mark, 20.0)
    _hold(back_s is not None, "not back within 20 s")
    assert lost_s is not None
    assert back_s is not None
    measured = (
        f"told after {lost_s - pulled_s:.1f} s, back {back_s - linked_s:.1f} s after its name"
    )
    _hold(robot.property("MainPID") == pid, f"{measured}, by a restart")
    _hold(back_s - linked_s <= 8.0, measured)
    return f"{measured}; {_truthful(robot, without + robot.heard(mark))}"


def slam_process_is_killed(robot: Robot) -> str:
    mark, pid = robot.mark(), robot.property("MainPID")
    at_s = robot.machine.run("kill -9 $(pgrep -f 'multiprocessing[.]spawn import')").ended_s
    told_s = robot.hears('pose .*"fault": *"slam', mark, 10.0)
    over_s = robot.hears('status .*"slam": *{"link": *"OK"', robot.mark(), 60.0)
    _hold(told_s is not None and over_s is not None, f"told {told_s}, over {over_s}")
    assert told_s is not None
    assert over_s is not None
    heard = robot.heard(mark)
    measured = f"told after {told_s - at_s:.1f} s, ready again after {over_s - at_s:.1f} s"
    measured += f", longest silence of poses {1e3 * _longest_gap_s(heard):.0f} ms"
    _hold(robot.property("MainPID") == pid, f"{measured}, by a restart")
    return f"{measured}; {_truthful(robot, heard)}"


def disk_is_full(robot: Robot) -> str:
    mark = robot.mark()
    run = robot.machine.run
    fingerprint = run(f"sha256sum {MAP}").output
    run("dd if=/dev/zero of=/var/lib/private/amr-slam/filler bs=64k 2>/dev/null", check=False)
    save = '/opt/amr-slam/bin/amr-slam call robot save_map \'{"name": "copy"}\''
    refused = run(save, limit_s=90.0, check=False)
    run("rm /var/lib/private/amr-slam/filler")
    saved = run(save, limit_s=90.0, check=False)
    heard = robot.heard(mark)
    measured = f"refused: {refused.output.strip()[-120:]!r}; with space again: {saved.status}"
    _hold(refused.status == 1 and "No space" in refused.output, measured)
    _hold(run(f"sha256sum {MAP}").output == fingerprint, "the map has changed")
    _hold(saved.status == 0, measured)
    states = {pose.message["state"] for pose in heard if pose.kind == "pose"}
    _hold(states == {"localized"}, f"states {sorted(states)}")
    return f"refused in words, saved when there was space; {_truthful(robot, heard)}"


def configuration_is_wrong(robot: Robot) -> str:
    robot.machine.run(
        "sed 's/radius_left_m/radius_lef_m/' /etc/amr-slam/robot.toml > /etc/amr-slam/wrong.toml"
    )
    robot.machine.run("systemctl start amr-slam@wrong", limit_s=60.0, check=False)
    robot.machine.run("sleep 3")
    state, status, restarts = (
        robot.property(name, "amr-slam@wrong")
        for name in ("ActiveState", "ExecMainStatus", "NRestarts")
    )
    said = robot.machine.run("journalctl -u amr-slam@wrong -o cat | grep error | tail -1").output
    measured = f"{state}, status {status}, {restarts} restarts: {said.strip()}"
    _hold((state, status, restarts) == ("failed", "2", "0"), measured)
    return measured


def restarts_are_a_storm(robot: Robot) -> str:
    robot.machine.run("cp /etc/amr-slam/robot.toml /etc/amr-slam/storm.toml")
    answer = robot.machine.run(
        """systemctl start --no-block amr-slam@storm
        until [ "$(systemctl show -P ActiveState amr-slam@storm)" = failed ]; do
          systemctl kill --kill-whom=main -s KILL amr-slam@storm 2>/dev/null; sleep 0.1; done""",
        limit_s=60.0,
    )
    restarts = robot.property("NRestarts", "amr-slam@storm")
    measured = f"failed after {restarts} restarts in {answer.ended_s - answer.began_s:.1f} s"
    _hold(int(restarts) <= 5, measured)
    return measured


def daemon_is_killed(robot: Robot) -> str:
    return _restarted(robot, "KILL")


def daemon_hangs(robot: Robot) -> str:
    measured = _restarted(robot, "STOP")
    said = robot.machine.run(f"journalctl -u {UNIT} -o cat | grep -c 'Watchdog timeout'").output
    _hold(int(said) == 1, f"{measured}; the journal tells of {said.strip()} watchdog time-outs")
    return measured


def _restarted(robot: Robot, signal: str) -> str:
    mark, pid = robot.mark(), robot.property("MainPID")
    at_s = robot.machine.run(f"kill -{signal} {pid}").began_s
    robot.machine.until(f'[ "$(systemctl show -P MainPID {UNIT})" != {pid} ]', limit_s=30.0)
    active_s = robot.until_active(90.0)
    after = robot.mark()
    localized_s = robot.hears(LOCALIZED, after, 30.0)
    measured = f"READY {active_s - at_s:.1f} s later ({robot.ready_s():.1f} s of it the start)"
    _hold(localized_s is not None, f"{measured}, not localized 30 s after that")
    assert localized_s is not None
    measured += f", localized {localized_s - active_s:.1f} s after that"
    _hold(localized_s - active_s <= 10.0, measured)
    return f"{measured}; {_truthful(robot, robot.heard(mark))}"


def _wheels_fail(robot: Robot, break_: str, mend: str) -> str:
    mark, pid = robot.mark(), robot.property("MainPID")
    broken_s = robot.machine.run(break_).ended_s
    told_s = robot.hears('status .*"wheels": *{"link": *"\\(LOST\\|STALE\\)\\|bus.off', mark, 10.0)
    _hold(told_s is not None, "not told within 10 s")
    robot.machine.run("sleep 2")
    robot.machine.run(mend)
    after = robot.mark()
    mended_s = robot.machine.run("true").began_s
    ok = 'status .*"wheels": *{"link": *"OK"[^}]*"detail": *null'
    back_s = robot.hears(ok, after, 20.0)
    localized_s = robot.hears(LOCALIZED, after, 30.0)
    _hold(back_s is not None and localized_s is not None, f"back {back_s}, {localized_s}")
    assert told_s is not None
    assert back_s is not None
    assert localized_s is not None
    measured = (
        f"told after {told_s - broken_s:.1f} s; wheels back {back_s - mended_s:.1f} s and localized"
        f" {max(0.0, localized_s - mended_s):.1f} s after its end"
    )
    _hold(robot.property("MainPID") == pid, f"{measured}, by a restart")
    return f"{measured}; {_truthful(robot, robot.heard(mark))}"


def _truthful(robot: Robot, heard: list[Heard]) -> str:
    excess_m = robot.worst_excess_m(heard)
    _hold(excess_m <= 0.0, f"a pose was {100 * excess_m:.0f} cm farther off than it said")
    return "no pose wrong without saying so"


def _longest_gap_s(heard: list[Heard]) -> float:
    times = [pose.at_s for pose in heard if pose.kind == "pose"]
    return max(b - a for a, b in itertools.pairwise(times))


def _hold(true: bool, measured: str) -> None:
    if not true:
        raise NotMetError(measured)


CASES: Final = (
    Case(name="installed", run=installed,
         must="tools/install.py again changes nothing; device names by udev, CAN up by networkd"),
    Case(name="start", run=service_starts,
         must="READY without scanners; adapters come, their driver not loaded yet: localized"),
    Case(name="poses", run=poses_flow,
         must="poses at 50 Hz; SocketCAN with real frames on a real driver (SJA1000)"),
    Case(name="clock", run=clock_is_stepped, must="clock + 1 h: stays localized, told once"),
    Case(name="interface", run=interface_goes_down,
         must="CAN down for 2 s and up: told, back by itself"),
    Case(name="bus-off", run=controller_is_bus_off,
         must="bus-off frame, then silence for 2 s: told, back by itself"),
    Case(name="serial", run=scanner_is_pulled,
         must="serial adapter out and in: goes on with one scanner, back within 8 s"),
    Case(name="disk", run=disk_is_full, must="disk full: map kept, said in words, goes on"),
    Case(name="configuration", run=configuration_is_wrong, must="status 2, no restart"),
    Case(name="storm", run=restarts_are_a_storm, must="failed after 5 starts within 60 s"),
    Case(name="slam-killed", run=slam_process_is_killed,
         must="kill -9 of the SLAM process: poses go on and say so"),
    Case(name="killed", run=daemon_is_killed,
         must="kill -9 of the daemon: READY by itself, localized within 10 s of it"),
    Case(name="hang", run=daemon_hangs, must="SIGSTOP: the watchdog (2 s) starts it anew"),
)  # fmt: skip
