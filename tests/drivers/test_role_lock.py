"""A role on a channel of hardware is one of the whole machine, whatever runtime folder a process has."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from drivers.can.runtime_folder import RoleLock, role_holder
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
            assert role_holder(interface, CHANNEL, role) == os.getpid()
            with pytest.raises(
                RunError, match=f"{interface}:{CHANNEL} already has a {role}, process {os.getpid()};"
            ):
                RoleLock(interface, CHANNEL, role)
        other = "plant" if role == "controller" else "controller"
        for free in ((interface, CHANNEL, other), (interface, CHANNEL + "b", role), ("pcan", CHANNEL, role)):
            assert role_holder(*free) is None
            RoleLock(*free).close()
    finally:
        held.close()
    assert role_holder(interface, CHANNEL, role) is None
    RoleLock(interface, CHANNEL, role).close()


@pytest.mark.parametrize(
    ("channel", "role"),
    [(f"{CHANNEL}plant", ""), (f"{CHANNEL}pl", "ant"), (CHANNEL[:-1], f"{CHANNEL[-1]}plant")],
    ids=["all in the channel", "a part of each", "more in the role"],
)
def test_words_that_run_together_to_those_of_a_role_name_another_one(elsewhere, channel, role):
    held = RoleLock("kvaser", CHANNEL, "plant")
    assert role_holder("kvaser", CHANNEL, "plant") == os.getpid()
    assert role_holder("kvaser", channel, role) is None
    held.close()


def test_one_whom_many_have_asked_still_has_its_role(elsewhere):
    held = RoleLock("kvaser", CHANNEL, "controller")
    for _ in range(300):
        with pytest.raises(RunError, match="already has a controller"):
            RoleLock("kvaser", CHANNEL, "controller")
    assert role_holder("kvaser", CHANNEL, "controller") is not None
    held.close()
    assert role_holder("kvaser", CHANNEL, "controller") is None


@pytest.mark.parametrize("interface", ["localcan", "kvaser"])
def test_a_role_of_a_killed_process_is_free(elsewhere, interface):
    code = (
        f"from drivers.can.runtime_folder import RoleLock; held = RoleLock({interface!r}, {CHANNEL!r}, 'plant')"
        "; print('held', flush=True); input()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as child:
        assert child.stdout is not None
        assert child.stdout.readline() == b"held\n"
        with pytest.raises(RunError, match=f"already has a plant, process {child.pid};"):
            RoleLock(interface, CHANNEL, "plant")
        child.kill()
    RoleLock(interface, CHANNEL, "plant").close()


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
