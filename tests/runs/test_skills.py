"""Facts about the skills that the commands read."""

from fmp_drake.primitives import modulate_skill, save_skill
from fmp_drake.runs import scenario_skill
from fmp_drake.station.scenario import Scenario


def test_skill_that_does_not_hold_its_paths_is_said_to_be_unbounded(
    tmp_path, wiping_skill
):
    file = tmp_path / "skill.npz"
    without_paths = modulate_skill(wiping_skill, harmonics=[1], gain=1.0)
    for skill, remarked in ((wiping_skill, False), (without_paths, True)):
        save_skill(skill, file)
        loaded, _, remarks = scenario_skill(Scenario(), skill_file=file)
        assert bool(loaded.paths_) != remarked
        said = "skill.npz does not say where it was demonstrated" in "\n".join(remarks)
        assert said == remarked
