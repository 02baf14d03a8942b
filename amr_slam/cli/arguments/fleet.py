"""Commands that listen to robots on Zenoh or command them, and a site's keys."""

from __future__ import annotations

from pathlib import Path

from amr_slam.cli.arguments.base import Parser, Subparsers, add_command, add_session
from amr_slam.cli.arguments.values import days, domain, port, seconds


def add_watch(commands: Subparsers[Parser]) -> None:
    """``amr-slam watch``."""
    watch = add_command(
        commands,
        "watch",
        "live table of the robots on Zenoh, until Ctrl-C",
        "amr-slam watch --connect tcp/192.168.1.20:7447 amr7",
        "Red is not to be driven by: a robot whose poses stop is stale after half a second. One "
        "line a second and robot where standard output is no terminal.",
    )
    add_session(watch)
    watch.add_argument(
        "--sort",
        choices=("name", "state", "error", "age"),
        default="name",
        help="by name (default), or with what needs a look first",
    )
    watch.add_argument("--once", action="store_true", help="show what there is, and end")
    watch.add_argument("--json", action="store_true", help="lines of JSON: all that is known")
    watch.add_argument("robots", metavar="ROBOT", nargs="*", help="only these (default: all)")


def add_foxglove(commands: Subparsers[Parser]) -> None:
    """``amr-slam foxglove``."""
    live = add_command(
        commands,
        "foxglove",
        "the robots on Zenoh, live in Foxglove on this computer, until Ctrl-C",
        "amr-slam foxglove --connect tcp/192.168.1.20:7447 amr7",
        "In Foxglove: Open connection, Foxglove WebSocket, ws://localhost:8765. Only this computer "
        "can connect, and only to look. Needs foxglove-sdk: the extra 'foxglove'.",
    )
    add_session(live)
    live.add_argument("--port", type=port, default=8765, help="default 8765; 0: any free one")
    live.add_argument("robots", metavar="ROBOT", nargs="*", help="only these (default: all)")


def add_view(commands: Subparsers[Parser]) -> None:
    """``amr-slam view``."""
    view = add_command(
        commands,
        "view",
        "the robots on their map in a browser, until Ctrl-C",
        "amr-slam view --connect tcp/192.168.1.20:7447",
        "Pages are for looking, and for this computer. With --allow-commands and no --tokens, the "
        "address that is printed has a token for commands in it, for this run.",
    )
    add_session(view)
    view.add_argument("--port", type=port, default=8080, help="of the pages (default 8080)")
    view.add_argument(
        "--host",
        metavar="ADDRESS",
        default="127.0.0.1",
        help="address of the pages (default: this computer only); others need --tokens and --cert",
    )
    view.add_argument(
        "--allow-commands", action="store_true", help="pages with a token for it command robots"
    )
    view.add_argument(
        "--tokens",
        metavar="FILE",
        type=Path,
        help="lines 'look TOKEN' and 'command TOKEN': nobody looks without one",
    )
    view.add_argument("--cert", metavar="FILE", type=Path, help="certificate for TLS, PEM")
    view.add_argument("--key", metavar="FILE", type=Path, help="its private key, PEM")
    view.add_argument(
        "--full-rate",
        action="store_true",
        help="listen to every pose: for robots that publish no fleet_pose",
    )
    view.add_argument("robots", metavar="ROBOT", nargs="*", help="only these (default: all)")


def add_call(commands: Subparsers[Parser]) -> None:
    """``amr-slam call``."""
    call = add_command(
        commands,
        "call",
        "sends a command to a robot and prints the reply",
        """amr-slam call amr7 set_pose '{"x": 1.5, "y": 2.0, "theta": 0.0, "radius": 3.0}'""",
        "Commands: set_pose {x, y, theta, radius} (m, rad; searched), resume_pose {x, y, theta} "
        "(taken as is), relocalize, start_mapping {name}, save_map {name}, load_map {name}, "
        "save_recording {reason}. Status 1 when the robot refuses or does not answer.",
    )
    add_session(call)
    call.add_argument(
        "--timeout",
        metavar="S",
        type=seconds,
        default=10.0,
        help="how long to wait for the reply (default 10)",
    )
    call.add_argument("robot", metavar="ROBOT")
    call.add_argument("what", metavar="COMMAND")
    call.add_argument("arguments", metavar="JSON", nargs="?", default="{}", help="default {}")


def add_keys(commands: Subparsers[Parser]) -> None:
    """``amr-slam keys``."""
    keys = add_command(
        commands,
        "keys",
        "keys and access rules of a site: its router, robots and controllers",
        "amr-slam keys init --site hall3 --router 192.168.1.5",
    )
    actions = keys.add_subparsers(dest="action", metavar="ACTION", required=True)
    init = add_command(
        actions,
        "init",
        "a new site",
        "amr-slam keys init --site hall3 --router 192.168.1.5",
    )
    init.add_argument("--site", metavar="NAME", required=True, help="what certificates call it")
    init.add_argument(
        "--router",
        metavar="HOST",
        nargs="+",
        required=True,
        help="names or addresses under which robots find the router",
    )
    init.add_argument("--prefix", default="amr", help="first part of all keys (default amr)")
    init.add_argument(
        "--auth",
        choices=("tls", "password"),
        default="tls",
        help="certificates on both sides, encrypted (default), or user and password in the clear",
    )
    robot = add_command(
        actions,
        "robot",
        "keys for a robot: it may publish its own keys, nothing else",
        "amr-slam keys robot amr7",
    )
    fleet = add_command(
        actions,
        "fleet",
        "keys for a controller: it may look, and with --commands command",
        "amr-slam keys fleet controller --commands",
    )
    fleet.add_argument("--commands", action="store_true", help="it may call commands")
    camera = add_command(
        actions,
        "camera",
        "keys for a camera system that robots compare with: it may publish its key, nothing else",
        "amr-slam keys camera ceiling --key 'cameras/*/pose'",
    )
    camera.add_argument(
        "--key", metavar="KEY", required=True, help="key expression, as [shadow] key has it"
    )
    revoke = add_command(
        actions,
        "revoke",
        "a member's keys open nothing any more",
        "amr-slam keys revoke robot amr7",
    )
    revoke.add_argument("kind", choices=("robot", "fleet", "camera"))
    for parser in (robot, fleet, camera, revoke):
        parser.add_argument("name", metavar="NAME")
    ros2 = add_command(
        actions,
        "ros2",
        "robots may also speak ROS 2, each in the namespace of its name; those who may command may "
        "also send initial poses",
        "amr-slam keys ros2 0",
    )
    ros2.add_argument(
        "domain", metavar="DOMAIN|off", type=domain, help="ROS_DOMAIN_ID, 0 to 232, or off"
    )
    vda5050 = add_command(
        actions,
        "vda5050",
        "robots may also speak VDA 5050, each under its name as serial number; those who may "
        "command may also send instant actions",
        "amr-slam keys vda5050 uagv",
    )
    vda5050.add_argument(
        "interface",
        metavar="INTERFACE|off",
        type=lambda text: None if text == "off" else text,
        help="first level of the topics, or off",
    )
    listed = add_command(
        actions, "list", "members and when their keys expire", "amr-slam keys list"
    )
    for parser in (init, robot, fleet, camera, revoke, ros2, vda5050, listed):
        parser.add_argument(
            "--dir", type=Path, default=Path("keys"), help="the site's folder (default keys)"
        )
    for parser in (init, robot, fleet, camera):
        parser.add_argument(
            "--days", type=days, default=730, help="certificates are valid for (default 730)"
        )
