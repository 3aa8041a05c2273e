"""A real S3 server on this machine (moto's), which can be stopped and started again."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator
from contextlib import contextmanager
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


@contextmanager
def s3_server(folder: Any) -> Iterator[Server]:
    """Run a server with an empty bucket; the environment leads all processes to it."""
    pytest.importorskip("moto", reason="moto runs the S3 server of the tests")
    pytest.importorskip("s3fs", reason="s3fs is in the extra cloud")
    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    server = Server()
    server.start()
    with pytest.MonkeyPatch.context() as patch:
        for name, value in {
            "AWS_ENDPOINT_URL": f"http://127.0.0.1:{server.port}", "AWS_ACCESS_KEY_ID": "key",
            "AWS_SECRET_ACCESS_KEY": "secret", "AWS_DEFAULT_REGION": "us-east-1",
            "AWS_CONFIG_FILE": os.devnull, "AWS_SHARED_CREDENTIALS_FILE": os.devnull,
            "AWS_EC2_METADATA_DISABLED": "true", "GCBENCH_CACHE": str(folder),
        }.items():
            patch.setenv(name, value)
        import fsspec

        fsspec.filesystem("s3", skip_instance_cache=True).mkdir(BUCKET)
        object_store._file_system.cache_clear()
        try:
            yield server
        finally:
            server.stop()
