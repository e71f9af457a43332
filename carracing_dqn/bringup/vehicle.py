# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""What a profile says of the camera and the drive, held to the parameters of the policy."""
from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from carracing_dqn.simulation.profiles import profile_of
from dqn_policy_node.settings import PolicySettings
from msgs_bridge.errors import SettingsError
from msgs_bridge.settings import from_mapping


def policy_settings(name: str, vehicle: Mapping[str, Any]) -> PolicySettings:
    """
    Return the settings of the policy that the section `vehicle` of a profile makes.

    Args:
        name: of the profile, for the error.
        vehicle: parameters of the policy by name.

    Raises:
        SettingsError: it has none of such a name, or takes no such value.
    """
    try:
        return from_mapping(PolicySettings, dict(vehicle))
    except SettingsError as error:
        raise SettingsError(f'{name}: vehicle: {error}') from None


def vehicle_of(simulator: str) -> Mapping[str, Any]:
    """
    Return parameters of the policy for a simulator; none where it has no profile.

    Raises:
        SettingsError: the profile, or what it says of the vehicle, is wrong.
    """
    vehicle = profile_of(simulator).vehicle
    policy_settings(simulator, vehicle)
    return vehicle
