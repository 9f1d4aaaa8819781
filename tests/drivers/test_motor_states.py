"""What a drive that says only whether it is enabled counts as, by what it is asked for and has been."""

from __future__ import annotations

import pytest

from drivers.motor_kernels import wire_state
from drivers.signals import DriveMode, DriveState
from tests.drivers.test_no_reading import FAMILIES

MODES = list(DriveMode)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("power", [DriveState.RUN, DriveState.FAULT])
def test_an_enabled_and_a_faulted_drive_count_as_what_they_say_whatever_they_are_asked_for(power, mode):
    for set_up in (False, True):
        for ran in (False, True):
            assert wire_state(power, mode, set_up=set_up, ran=ran) == power


@pytest.mark.parametrize("mode", MODES)
def test_a_disabled_drive_that_is_not_set_up_has_just_booted(mode):
    for ran in (False, True):
        assert wire_state(DriveState.OFF, mode, set_up=False, ran=ran) == DriveState.BOOT


@pytest.mark.parametrize(
    ("mode", "ran", "state"),
    [
        (DriveMode.OFF, False, DriveState.OFF),
        (DriveMode.OFF, True, DriveState.OFF),
        (DriveMode.RESET, False, DriveState.OFF),
        (DriveMode.RESET, True, DriveState.OFF),
        (DriveMode.READY, False, DriveState.READY),
        (DriveMode.READY, True, DriveState.READY),
        (DriveMode.RUN, False, DriveState.READY),
        (DriveMode.RUN, True, DriveState.BOOT),
    ],
)
def test_a_disabled_drive_has_restarted_only_where_it_ran_and_is_asked_to_run_and_waits_before_it_has(
    mode, ran, state
):
    assert wire_state(DriveState.OFF, mode, set_up=True, ran=ran) == state


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("mini_cheetah", "never"),
        ("cubemars", "never"),
        ("damiao", "feedback"),
        ("robstride", "feedback"),
        ("moteus", "feedback"),
        ("odrive", "heartbeat"),
    ],
)
def test_each_family_says_by_what_its_drives_tell_that_they_are_enabled(name, told):
    assert FAMILIES[name].traits.power_told == told
    assert FAMILIES[name].traits.power_told == told
