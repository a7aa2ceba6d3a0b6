"""Skills from the bundled demonstration; treat them as read-only."""

import pytest

from fmp_drake.primitives import Demonstration, FourierMovementPrimitive
from fmp_drake.station.models.model_files import models_dir
from fmp_drake.station.reach import feasibility
from fmp_drake.station.reach.feasibility import _Check as Check


@pytest.fixture(scope="session")
def bundled_demonstration():
    """Two minutes of wiping, in the frame of the board."""
    return Demonstration.load(models_dir() / "demonstrations" / "wiping.npz")


@pytest.fixture(scope="session")
def bundled_skill(bundled_demonstration):
    """What the command line learns from it: windows of 6 s, a re-mapping each 4.9 s."""
    return FourierMovementPrimitive().fit([bundled_demonstration])


@pytest.fixture(scope="session")
def restless_skill(bundled_demonstration):
    """A skill that is re-mapped every 0.75 s."""
    return FourierMovementPrimitive(n_steps=20, overlap=5, n_components=4).fit(
        [bundled_demonstration]
    )


@pytest.fixture(scope="module")
def skills_sampled_once():
    """Play and sample a skill once where only the board is another one.

    It is half of the time of a check.
    """
    known, sample = {}, feasibility.SampleSkillPaths

    def once(scenario, skill, roles, *, tempo, stride):
        tool = scenario.eraser_orientation().matrix()
        key = id(skill), repr((tempo, scenario.skill, scenario.start, tool))
        if key not in known:
            known[key] = (
                skill,
                sample(scenario, skill, roles, tempo=tempo, stride=stride),
            )
        return known[key][1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(feasibility, "SampleSkillPaths", once)
        yield


@pytest.fixture
def no_remedy(monkeypatch):
    """Look for no change that would help, which takes longer than the check."""
    monkeypatch.setattr(Check, "remedy", lambda _: ("not looked for", {}))
