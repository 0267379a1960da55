"""Channel groups of a head's curves by region, for keys that Blender inserted itself, which has no groups for properties."""

from __future__ import annotations

import re

from ...grmm_core.controls.table import CONTROLS
from .actions import action_bag
from .avatar import Avatar

_PROPERTY = re.compile(r'^\["([^"]+)"\]$')


def group_channels(avatar: Avatar) -> None:
    """Put the curves of an avatar's controls that are in no group into that of their region."""
    bag = action_bag(avatar.object)
    if bag is None:
        return
    for curve in bag.fcurves:
        found = _PROPERTY.match(curve.data_path) if curve.group is None else None
        if found and found[1] in CONTROLS:
            name = CONTROLS[found[1]].group
            curve.group = bag.groups.get(name) or bag.groups.new(name)
