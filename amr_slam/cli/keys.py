"""``amr-slam keys init|robot|fleet|camera|revoke|ros2|vda5050|list``."""

from __future__ import annotations

import argparse
import sys
from typing import Final

from amr_slam.keys import CredentialsError, KeysError, Member, create, load
from amr_slam.keys.site import expires_soon

FAILURES: Final[dict[type[Exception], int]] = {KeysError: 1, CredentialsError: 1}


def run(arguments: argparse.Namespace) -> int:
    """Do it, and say which folder goes where."""
    match arguments.action:
        case "init":
            return _init(arguments)
        case "robot":
            member = load(arguments.dir).add_robot(arguments.name, arguments.days)
            _say(f"copy {member.folder}/ to the robot, to /etc/amr-slam/keys/ say, and tell it so:")
            _say('[zenoh]\nkeys = "/etc/amr-slam/keys"\nconnect = ["tls/ROUTER:7447"]')
        case "fleet":
            site = load(arguments.dir)
            member = site.add_controller(
                arguments.name, arguments.days, commands=arguments.commands
            )
            rights = "may look and command" if arguments.commands else "may only look"
            _say(f"{member.folder}/ is for controller {member.name}: it {rights}")
        case "camera":
            site = load(arguments.dir)
            member = site.add_camera(arguments.name, arguments.days, key=arguments.key)
            _say(f"{member.folder}/ is for the camera system: it may publish {member.key} only")
            _say(f'robots compare with it by\n[shadow]\nkey = "{member.key}"')
        case "revoke":
            load(arguments.dir).revoke(arguments.kind, arguments.name)
        case "ros2":
            load(arguments.dir).allow_ros2(arguments.domain)
            said = "no" if arguments.domain is None else f"domain {arguments.domain} of"
            _say(f"robots may speak {said} ROS 2")
        case "vda5050":
            load(arguments.dir).allow_vda5050(arguments.interface)
            topics = f"{arguments.interface}/VERSION/MANUFACTURER/ROBOT/"
            _say(f"robots may speak {f'on {topics}' if arguments.interface else 'no VDA 5050'}")
        case _:
            for member in load(arguments.dir).members():
                _say(_line(member))
            return 0
    _say(f"then copy {arguments.dir}/router/ to the router and start it anew")
    return 0


def _init(arguments: argparse.Namespace) -> int:
    site = create(
        arguments.dir,
        arguments.site,
        arguments.router,
        prefix=arguments.prefix,
        auth=arguments.auth,
        days=arguments.days,
    )
    _say(f"site {site.name} in {arguments.dir}/: keep its authority/ secret, and back it up")
    _say(f"start the router where it is: zenohd --config {site.router_folder}/router.json5")
    return 0


def _line(member: Member) -> str:
    rights = " (commands)" if member.commands else "" if member.key is None else f" ({member.key})"
    until = "password" if member.expires is None else f"until {member.expires:%Y-%m-%d}"
    soon = ": renew it" if expires_soon(member) else ""
    return f"{member.kind} {member.name}{rights}: {until}{soon}"


def _say(text: str) -> None:
    sys.stdout.write(text + "\n")
