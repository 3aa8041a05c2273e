"""What the processes of a method can do to the memory of observations: read their own."""

from __future__ import annotations

import mmap
import os
import resource
from collections.abc import Callable
from dataclasses import fields
from multiprocessing import Pipe, reduction

import numpy as np
import pytest
from gcbench.benchmark.results import EstimateShape
from gcbench.benchmark.run.handover import Sender, receive_observation
from gcbench.renderer.types import Observation

SHAPE = EstimateShape(2, 1, 60, 80)


def observation(sender: Sender, value: int) -> Observation:
    """An observation whose arrays hold `value`; the depth does not come from the sender."""
    rgb = sender.allocate((2, 60, 80, 3), np.uint8)
    rgb[...] = value
    depth = np.full((2, 60, 80), value, np.float32)
    return Observation(rgb, depth, np.eye(3), np.arange(2.0), 1, ("revolute",))


def hand_over(sender: Sender, value: int) -> Observation:
    here, there = Pipe()
    with here, there:
        sender.send(here, sender.pack(observation(sender, value), SHAPE))
        received, shape = receive_observation(there)
    assert shape == SHAPE
    return received



def test_what_is_sent_arrives() -> None:
    sender = Sender(1)
    expected, received = observation(sender, 7), hand_over(sender, 7)
    for field in fields(Observation):
        a, b = getattr(expected, field.name), getattr(received, field.name)
        assert np.array_equal(a, b), field.name
        assert np.asarray(a).dtype == np.asarray(b).dtype


def test_memory_is_used_again_once_the_receiver_has_dropped_it() -> None:
    sender = Sender(1)
    size, kind = (2, 60, 80, 3), np.uint8
    kept = hand_over(sender, 1)
    second = sender.allocate(size, kind)
    second[...] = 2
    assert kept.rgb is not None and (kept.rgb == 1).all()  # not the memory of a receiver
    view = kept.rgb[1:, 5]
    del kept, second
    assert sender.allocate(size, kind)[0, 0, 0, 0] != 1
    assert (view == 1).all()
    sender = Sender(1)
    hand_over(sender, 3)
    assert (sender.allocate(size, kind) == 3).all()  # of the same size, and dropped
    assert (sender.allocate(size, kind) == 0).all()  # there is only one


def test_a_child_of_the_receiver_keeps_the_memory() -> None:
    sender = Sender(1)
    received = hand_over(sender, 4)
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        os.read(read, 1)
        os._exit(0 if received.rgb is not None and (received.rgb == 4).all() else 1)
    del received
    for _ in range(3):
        sender.allocate((2, 60, 80, 3), np.uint8)[...] = 5
    os.write(write, b"x")
    assert os.waitpid(child, 0)[1] == 0


def test_a_receiver_writes_to_its_copy_only() -> None:
    sender = Sender(1)
    sent = observation(sender, 6)
    here, there = Pipe()
    with here, there:
        sender.send(here, sender.pack(sent, SHAPE))
        received, _ = receive_observation(there)
    assert received.rgb is not None and sent.rgb is not None
    received.rgb[...] = 0
    assert (sent.rgb == 6).all()


ATTACKS: list[Callable[[int], object]] = [
    lambda file: os.pwrite(file, b"x", 0),
    lambda file: mmap.mmap(file, 0),
    lambda file: os.ftruncate(file, 0),
    lambda file: os.ftruncate(file, 2**20),
]


@pytest.mark.parametrize("attack", ATTACKS)
def test_nobody_else_can_write_to_the_memory(attack: Callable[[int], object]) -> None:
    sender = Sender(1)
    here, there = Pipe()
    with here, there:
        sender.send(here, sender.pack(observation(sender, 6), SHAPE))
        handles = [reduction.recv_handle(there) for _ in range(there.recv_bytes()[0])]
    again = os.open(f"/proc/self/fd/{handles[1]}", os.O_RDWR)
    with pytest.raises((OSError, ValueError)):
        attack(handles[1])
    with pytest.raises(PermissionError):
        attack(again)
    assert not (sender.allocate((2, 60, 80, 3), np.uint8) == 6).any()  # it is still open
    for handle in (*handles, again):
        os.close(handle)
    assert (sender.allocate((2, 60, 80, 3), np.uint8) == 6).all()


def test_small_arrays_take_no_memory_of_their_own() -> None:
    assert Sender(1).allocate((3, 3), np.float64).base is None


def test_missing_memory_is_an_error() -> None:
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2**16, limits[1]))
    try:
        with pytest.raises(OSError, match="File too large"):
            Sender(1).allocate((2**17,), np.uint8)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
