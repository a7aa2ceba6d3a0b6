"""Facts about dataclasses of settings that declare the ranges of their numbers."""

import time
from dataclasses import dataclass, field

import numpy as np
import pytest

from fmp_drake.errors import StationError, SystemsError
from fmp_drake.settings import bounded, check_settings, check_yaml
from fmp_drake.systems import ImpedanceConfig


@dataclass
class Felt:
    friction: float = bounded(0.5, least=0, most=1)
    size: list[float] = bounded([0.1, 0.2], above=0)
    wear: float | None = bounded(None, above=0)
    seed: int = 0
    joints: list[float] = bounded([], least=0, hint="as many as the arm has")
    colour: str = "grey"


@dataclass
class Tool:
    felt: Felt = field(default_factory=Felt)
    spares: list[Felt] = field(default_factory=list)

    def inconsistency(self):
        return "a tool has 3 spares." if len(self.spares) == 3 else ""


def test_settings_in_their_ranges_pass():
    felts = [Felt(0, [1, 1e-9], 3.0), Felt(1, joints=[0, 1, 2])]
    check_settings(Tool(spares=felts), StationError)


@pytest.mark.parametrize(
    ("tool", "message"),
    [
        (Tool(None), "tool.felt is None; its type must be Felt."),
        (Tool({"size": 1}), "tool.felt is {'size': 1}; its type must be Felt."),
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
        (Tool(Felt(joints=[1, -1])), r"joints\[1\] is -1; .* 0 \(as many as the arm"),
        (Tool(Felt(joints=1)), "tool.felt.joints is 1; expected a list"),
        (Tool(spares=[Felt()] * 3), "a tool has 3 spares"),
    ],
)
def test_setting_out_of_its_range_is_named(tool, message):
    with pytest.raises(StationError, match=message):
        check_settings(tool, StationError, "tool.")


def test_an_assignment_to_a_name_that_is_not_a_setting_is_refused_with_the_settings():
    config = ImpedanceConfig()
    config.tank.capcity = 0.3
    with pytest.raises(
        SystemsError,
        match=r"there is no tank\.capcity: tank has initial_energy, capacity",
    ):
        config.stiffness()
    config = ImpedanceConfig()
    config.damping = 0.7
    with pytest.raises(SystemsError, match=r"no damping: ImpedanceConfig has trans"):
        config.stiffness()


def test_settings_of_a_users_own_may_have_a_state():
    tool = Tool()
    tool.felt.count = 1
    check_settings(tool, StationError)


def test_no_two_settings_share_a_list():
    one, two = Felt(), Felt()
    one.size[0] = 9.0
    assert two.size == Felt().size == [0.1, 0.2]


TEN = ", ".join(["*{0}"] * 10)
MILLIONS = "\n".join(
    ["a: &a [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]"]
    + [f"{b}: &{b} [{TEN.format(a)}]" for a, b in zip("abcdef", "bcdefg", strict=True)]
)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("tempo: " + "1" * 400, "contains 11111.*, an integer of 400 digits"),
        ("tempo: -0x" + "f" * 9000, "an integer of 9003 digits"),
        ("a: " + "[" * 1000 + "]" * 1000, "nested deeper than 50 levels"),
        (MILLIONS, "more than 20000 values with its aliases expanded"),
        ("a: [" + "1, " * 20_000 + "]", "more than 20000 values"),
        ("a: &a [*a]", r"it contains itself, by its alias \*a"),
        ("a: " + "x" * 2**20, "it is 1048579 bytes long; at most 1048576"),
        ("a: {", "it cannot be read as YAML: .*line"),
        ("a: \0", "it cannot be read as YAML"),
        (b"a: \xff\xfe", "it cannot be read as YAML"),
        ("a: 1\nb: {c: [{d: 1, d: 2}]}", "has the key 'd' twice in one place"),
    ],
)
def test_yaml_without_bounds_is_refused_at_once(text, message):
    start = time.monotonic()
    with pytest.raises(StationError, match=message) as refusal:
        check_yaml(text, "it", StationError)
    assert len(str(refusal.value)) < 300
    assert time.monotonic() - start < 2


def test_an_array_becomes_a_list():
    felt = Felt(size=np.array([0.1, 0.3]))
    check_settings(felt, StationError)
    assert felt.size == [0.1, 0.3]
    with pytest.raises(StationError, match=r"size is \[0.1\]; expected 2 numbers"):
        check_settings(Felt(size=np.array([0.1])), StationError)
    for wrong in (np.zeros((2, 1)), [[0.1], [0.2]]):
        with pytest.raises(StationError, match="size"):
            check_settings(Felt(size=wrong), StationError)


def test_yaml_of_common_size_passes_with_its_aliases():
    check_yaml("a: &a [1, 2]\nb: [*a, *a]\nc: {d: *a}", "it", StationError)
    check_yaml("a: " + "[" * 49 + "]" * 49, "it", StationError)
    check_yaml("a: {n: 1}\nb: {n: 1}", "it", StationError)
    check_yaml("n: 1234567890123456789012345678901234567890", "it", StationError)
