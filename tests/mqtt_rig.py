"""The MQTT side: a real broker in a process of its own, and a bridge as zenoh-bridge-mqtt is."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from typing import Self

import paho.mqtt.client as mqtt
import zenoh
from paho.mqtt.enums import CallbackAPIVersion

DEADLINE_S = 30.0
BROKER = """
import asyncio, sys
from amqtt.broker import Broker

CONFIG = {
    "listeners": {"default": {"type": "tcp", "bind": f"127.0.0.1:{sys.argv[1]}"}},
    "plugins": {
        "amqtt.plugins.authentication.AnonymousAuthPlugin": {"allow_anonymous": True}
    },
}

async def main():
    broker = Broker(CONFIG)
    await broker.start()
    print("ready", flush=True)
    await asyncio.get_running_loop().run_in_executor(None, sys.stdin.read)
    await broker.shutdown()

asyncio.run(main())
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Message:
    topic: str
    payload: bytes


@contextmanager
def broker() -> Iterator[int]:
    """Its port."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
    command = [sys.executable, "-c", BROKER, str(port)]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "ready\n"
            yield port
        finally:
            process.kill()


class Client:
    """Subscribed to some filters of topics, from the start."""

    def __init__(self, port: int, filters: Sequence[str], hear: Callable[[Message], None]) -> None:
        """``hear``: on the client's own thread."""
        subscribed = threading.Event()
        self._client = mqtt.Client(CallbackAPIVersion.VERSION2)
        self._client.on_connect = lambda client, *_: client.subscribe([(f, 0) for f in filters])
        self._client.on_subscribe = lambda *_: subscribed.set()
        self._client.on_message = lambda _c, _u, message: hear(
            Message(topic=message.topic, payload=bytes(message.payload))
        )
        self._client.connect("127.0.0.1", port)
        self._client.loop_start()
        assert subscribed.wait(DEADLINE_S)

    def publish(self, topic: str, payload: bytes) -> None:
        self._client.publish(topic, payload)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self._client.disconnect()
        self._client.loop_stop()


@contextmanager
def bridge(endpoint: str, port: int, interface: str) -> Iterator[None]:
    """What zenoh-bridge-mqtt does: an MQTT topic is a Zenoh key, one to one, payloads as they are.

    Each topic goes one way, so that nothing comes back around.
    """
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    to_robots = [f"{interface}/+/+/+/{topic}" for topic in ("instantActions", "state")]
    with (
        closing(zenoh.open(config)) as session,  # callbacks may still put
        Client(port, to_robots, lambda heard: session.put(heard.topic, heard.payload)) as client,
    ):
        session.declare_subscriber(
            f"{interface}/*/*/*/visualization",
            lambda sample: client.publish(str(sample.key_expr), sample.payload.to_bytes()),
        )
        yield
