"""A role on a channel of hardware is one of the whole machine, whatever runtime folder a process has."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from drivers.can.runtime_folder import RoleLock, role_is_held, runtime_folder
from drivers.errors import RunError

CHANNEL = f"of-{os.getpid()}"
"""No other process of this machine has it."""


@pytest.fixture
def elsewhere(monkeypatch, tmp_path):
    """Go to another runtime folder, as another user or a service has it."""

    def go(name: str) -> None:
        folder = tmp_path / name
        folder.mkdir(exist_ok=True)
        monkeypatch.setenv("XDG_RUNTIME_DIR", str(folder))

    go("a")
    return go


@pytest.mark.parametrize("role", ["controller", "plant"])
@pytest.mark.parametrize("interface", ["socketcan", "kvaser", "udp_multicast"])
def test_a_role_on_hardware_is_refused_to_who_sees_another_runtime_folder(elsewhere, interface, role):
    held = RoleLock(interface, CHANNEL, role)
    elsewhere("b")
    try:
        for _ in range(2):
            assert role_is_held(interface, CHANNEL, role)
            with pytest.raises(RunError, match=f"{interface}:{CHANNEL} already has a {role}.*another user"):
                RoleLock(interface, CHANNEL, role)
        other = "plant" if role == "controller" else "controller"
        for free in ((interface, CHANNEL, other), (interface, CHANNEL + "b", role), ("pcan", CHANNEL, role)):
            assert not role_is_held(*free)
            RoleLock(*free).close()
    finally:
        held.close()
    assert not role_is_held(interface, CHANNEL, role)
    RoleLock(interface, CHANNEL, role).close()


@pytest.mark.parametrize(
    ("channel", "role"),
    [(f"{CHANNEL}plant", ""), (f"{CHANNEL}pl", "ant"), (CHANNEL[:-1], f"{CHANNEL[-1]}plant")],
    ids=["all in the channel", "a part of each", "more in the role"],
)
def test_words_that_run_together_to_those_of_a_role_name_another_one(elsewhere, channel, role):
    held = RoleLock("kvaser", CHANNEL, "plant")
    assert role_is_held("kvaser", CHANNEL, "plant")
    assert not role_is_held("kvaser", channel, role)
    held.close()


def test_who_sees_the_same_runtime_folder_is_told_the_process(elsewhere):
    held = RoleLock("kvaser", CHANNEL, "controller")
    with pytest.raises(RunError, match=f"already has a controller, process {os.getpid()}"):
        RoleLock("kvaser", CHANNEL, "controller")
    held.close()


def test_of_an_earlier_holder_whose_number_was_longer_no_digit_is_told(elsewhere):
    RoleLock("kvaser", CHANNEL, "controller").close()
    (lock,) = runtime_folder().glob("*.lock")
    lock.write_text(f"{os.getpid()}4194304 999\n")
    held = RoleLock("kvaser", CHANNEL, "controller")
    with pytest.raises(RunError, match=f"already has a controller, process {os.getpid()};"):
        RoleLock("kvaser", CHANNEL, "controller")
    held.close()


def test_a_role_that_is_refused_leaves_nothing_taken_in_the_own_folder(elsewhere):
    held = RoleLock("kvaser", CHANNEL, "plant")
    elsewhere("b")
    before = len(list(Path("/proc/self/fd").iterdir()))
    with pytest.raises(RunError):
        RoleLock("kvaser", CHANNEL, "plant")
    assert len(list(Path("/proc/self/fd").iterdir())) == before
    held.close()
    RoleLock("kvaser", CHANNEL, "plant").close()


def test_on_localcan_another_runtime_folder_has_another_bus_and_its_own_roles(elsewhere):
    here = RoleLock("localcan", CHANNEL, "controller")
    elsewhere("b")
    there = RoleLock("localcan", CHANNEL, "controller")
    for lock in (here, there):
        lock.close()
