"""Facts about dataclasses of settings whose numbers say their ranges."""

from dataclasses import dataclass, field

import pytest

from fmp_drake.errors import StationError
from fmp_drake.settings import bounded, check_settings


@dataclass
class Felt:
    friction: float = bounded(0.5, least=0, most=1)
    size: list[float] = bounded([0.1, 0.2], above=0)
    wear: float | None = bounded(None, above=0)
    seed: int = 0
    colour: str = "grey"


@dataclass
class Tool:
    felt: Felt = field(default_factory=Felt)
    spares: list[Felt] = field(default_factory=list)


def test_settings_in_their_ranges_pass():
    check_settings(Tool(spares=[Felt(0, [1, 1e-9], 3.0), Felt(1)]), StationError)


@pytest.mark.parametrize(
    ("tool", "message"),
    [
        (Tool(Felt(-0.1)), "tool.felt.friction is -0.1; it must be at least 0 and"),
        (Tool(Felt(1.1)), "tool.felt.friction is 1.1; .* and at most 1"),
        (Tool(Felt(float("nan"))), "tool.felt.friction is nan; it must be at least 0"),
        (Tool(Felt("much")), "tool.felt.friction is 'much'; it must be at least 0"),
        (Tool(Felt(size=[0.1, 0])), r"tool.felt.size\[1\] is 0; it must be positive"),
        (Tool(Felt(size=[0.1])), "tool.felt.size is .*; expected 2 numbers"),
        (Tool(Felt(size=[0.1, float("inf")])), r"size\[1\] is inf; it must be"),
        (Tool(Felt(wear=0)), "tool.felt.wear is 0; it must be positive"),
        (Tool(Felt(seed=None)), "tool.felt.seed is None; it must be a finite number"),
        (Tool(spares=[Felt(), Felt(2)]), r"tool.spares\[1\].friction is 2"),
    ],
)
def test_setting_out_of_its_range_is_named(tool, message):
    with pytest.raises(StationError, match=message):
        check_settings(tool, StationError, "tool.")


def test_no_two_settings_share_a_list():
    one, two = Felt(), Felt()
    one.size[0] = 9.0
    assert two.size == Felt().size == [0.1, 0.2]
