"""Targets for worker pools: what a task says happens to the process."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from multiprocessing.connection import Connection

from gcbench.renderer.runtime import receive_tasks


def obey(connection: Connection, first: str) -> None:
    """Report `first`, then do what each task asks for, and report the process that did it."""
    connection.send(first)
    for task in receive_tasks(connection, Connection.recv):
        print("task", task, flush=True)
        if task == "die":
            os.kill(os.getpid(), signal.SIGSEGV)
        if task == "exit":
            sys.exit(3)
        if task == "hang":
            connection.send("begun")
            time.sleep(600)
        if task == "spawn":
            child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
            connection.send(child.pid)
            time.sleep(600)
        if task == "shout":
            for _ in range(8):
                print("x" * 2**19, flush=True)
                time.sleep(0.3)  # the pool looks at what is printed
            task = "variable"
            os.environ["POOL_TEST"] = str(os.fstat(1).st_size)
        connection.send(os.environ["POOL_TEST"] if task == "variable" else os.getpid())
