"""A real S3 server on this machine (moto's), which can be stopped and started again.

In this process (`Server`), or in processes of its own (`RemoteServer`).
"""

from __future__ import annotations

import logging
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from gcbench.renderer.runtime import object_store

BUCKET = "videos"


class Server:
    """Objects stay while it is stopped."""

    def __init__(self) -> None:
        self.port = 0
        self._running: Any = None

    def start(self) -> None:
        """Listen, at the same port as before."""
        from moto.server import ThreadedMotoServer

        self._running = ThreadedMotoServer("127.0.0.1", self.port, verbose=False)
        self._running.start()
        self.port = self._running.get_host_and_port()[1]

    def stop(self) -> None:
        self._running.stop()


class RemoteServer:
    """A server in a process of its own, behind a relay that stands for the network."""

    def __init__(self) -> None:
        code = ("import sys; from moto.server import ThreadedMotoServer as Server; "
                "server = Server('127.0.0.1', 0, verbose=False); server.start(); "
                "print(server.get_host_and_port()[1], flush=True); sys.stdin.read()")
        self._server = subprocess.Popen(
            [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL, text=True)
        self.port = _read_port(self._server)
        """Of the server itself."""
        self.relay_port = 0
        """Of the relay."""
        self.connect()

    def connect(self) -> None:
        """Start the relay, at the same port as before."""
        self._relay = subprocess.Popen(
            [sys.executable, str(Path(__file__).parent / "relay.py"), str(self.relay_port),
             str(self.port)], stdout=subprocess.PIPE, text=True)
        self.relay_port = _read_port(self._relay)

    def disconnect(self) -> None:
        """Kill the relay: connections break, and new ones are refused."""
        self._relay.kill()
        self._relay.wait()

    def freeze(self) -> None:
        """Stop the server's process: it accepts connections and does not answer."""
        self._server.send_signal(signal.SIGSTOP)

    def thaw(self) -> None:
        """Let it go on."""
        self._server.send_signal(signal.SIGCONT)

    def close(self) -> None:
        """End both processes."""
        for process in (self._relay, self._server):
            process.kill()
            process.wait()


def _read_port(process: subprocess.Popen[str]) -> int:
    assert process.stdout is not None
    return int(process.stdout.readline())


def server_variables(port: int, cache: Any) -> dict[str, str]:
    """The variables that lead a process to a server."""
    return {
        "AWS_ENDPOINT_URL": f"http://127.0.0.1:{port}", "AWS_ACCESS_KEY_ID": "key",
        "AWS_SECRET_ACCESS_KEY": "secret", "AWS_DEFAULT_REGION": "us-east-1",
        "AWS_CONFIG_FILE": os.devnull, "AWS_SHARED_CREDENTIALS_FILE": os.devnull,
        "AWS_EC2_METADATA_DISABLED": "true", "GCBENCH_CACHE": str(cache),
    }


@contextmanager
def s3_server(folder: Any) -> Iterator[Server]:
    """Run a server with an empty bucket; the environment leads all processes to it."""
    pytest.importorskip("moto", reason="moto runs the S3 server of the tests")
    pytest.importorskip("s3fs", reason="s3fs is in the extra cloud")
    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    server = Server()
    server.start()
    with pytest.MonkeyPatch.context() as patch:
        for name, value in server_variables(server.port, folder).items():
            patch.setenv(name, value)
        import fsspec

        store = fsspec.filesystem("s3", skip_instance_cache=True)
        if store.exists(BUCKET):  # the servers of one process share their objects
            store.rm(BUCKET, recursive=True)
        store.mkdir(BUCKET)
        object_store._file_system.cache_clear()
        try:
            yield server
        finally:
            server.stop()
