"""Facts about names, indices and roles of channels."""

import pytest

from fmp_drake.errors import SkillError
from fmp_drake.primitives.data.channels import (
    ChannelRoles,
    channel_indices,
    channel_roles,
)

NAMES = ("x", "y", "z", "force")
IDENTITY = (0.0, 0.0, 0.0, 1.0)


@pytest.mark.parametrize(
    ("channels", "indices"),
    [
        (None, [0, 1, 2, 3]),
        ("z", [2]),
        (["force", "x"], [3, 0]),
        ([3, 0], [3, 0]),
        (["y", 2], [1, 2]),
    ],
)
def test_channels_are_chosen_by_name_or_index(channels, indices):
    assert channel_indices(channels, NAMES) == indices


@pytest.mark.parametrize(
    ("channels", "message"),
    [
        (["w"], "no channel 'w'; the channels are x, y, z, force"),
        ([4], r"no channel 4; .* \(0 to 3\)"),
        ([-1], "no channel -1"),
        ([0.5], "no channel 0.5"),
        ([], "are empty or repeat"),
        (["x", 0], "are empty or repeat"),
        (3, "channels is 3; give a list"),
    ],
)
def test_channels_that_do_not_exist_or_repeat_are_refused(channels, message):
    with pytest.raises(SkillError, match=message):
        channel_indices(channels, NAMES)


@pytest.mark.parametrize(
    ("channels", "roles"),
    [
        (("x", "y", "z"), ChannelRoles(position=(0, 1, 2))),
        (("z", "x", "y"), ChannelRoles(position=(1, 2, 0))),
        (("force", "x", "y", "z"), ChannelRoles(position=(1, 2, 3), force=0)),
        (
            ("ry", "x", "y", "z", "rx", "rz"),
            ChannelRoles(position=(1, 2, 3), rotation=(4, 0, 5), reference=IDENTITY),
        ),
        (
            ("x", "y", "z", "rx", "ry", "rz", "force"),
            ChannelRoles(
                position=(0, 1, 2), rotation=(3, 4, 5), reference=IDENTITY, force=6
            ),
        ),
    ],
)
def test_every_channel_has_a_role(channels, roles):
    units = ["N" if c == "force" else "rad" if "r" in c else "m" for c in channels]
    found = channel_roles(channels, units, rotation_reference=IDENTITY)
    assert found == roles
    assert found.count == len(channels)


@pytest.mark.parametrize(
    ("channels", "units", "reference", "message"),
    [
        (("x", "y", "z"), "m mm m", None, "channel y is in mm; expected m"),
        (("x", "y", "z", "force"), "m m m m", None, "force is in m; expected N"),
        (("x", "y", "z", "c"), "m m m 1", None, "channel c has no role"),
        (("x", "z"), "m m", None, "a robot needs y as well"),
        (("x", "y", "z"), "m m", None, "there are 3 channels and 2 units"),
        (("x", "y", "z", "rx"), "m m m rad", IDENTITY, "rotation is given by rx; "),
        (
            ("x", "y", "z", "rx", "ry", "rz"),
            "m m m rad rad rad",
            None,
            "rotation is given by rx, ry, rz; .* with their reference",
        ),
    ],
)
def test_channels_without_a_role_are_refused(channels, units, reference, message):
    with pytest.raises(SkillError, match=message):
        channel_roles(channels, units.split(), rotation_reference=reference)
