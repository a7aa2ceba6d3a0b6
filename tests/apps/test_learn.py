"""Facts about `fmp-drake learn`."""

import matplotlib.image
import numpy as np

from fmp_drake.primitives import load_skill


def test_skill_and_picture_are_written(command, make_npz, outputs):
    skill, plot = outputs / "skill.npz", outputs / "skill.png"
    result = command("learn", make_npz(), "--out", skill, "--plot", plot)
    assert result.code == 0
    assert result.err == ""
    assert f"wrote {skill}" in result.out
    assert f"wrote {plot}" in result.out
    learned = load_skill(skill)
    assert learned.n_steps == 120
    assert learned.channels_ == ("x", "y", "z")
    assert learned.frame_ == "board"
    assert np.ptp(matplotlib.image.imread(plot)[..., :3]) > 0.9
    assert len(list(outputs.iterdir())) == 2


def test_options_set_window_and_components(command, make_npz, outputs):
    skill = outputs / "skill.npz"
    options = ("--window", 2.0, "--components", 3)
    assert command("learn", make_npz(), "--out", skill, *options).code == 0
    learned = load_skill(skill)
    assert learned.n_steps == 40
    assert len(learned.components_) <= 3


def test_the_model_is_chosen_and_said(command, make_npz, outputs):
    skill = outputs / "skill.npz"
    said = {}
    for model in ("mixture", "phase"):
        result = command("learn", make_npz(), "--out", skill, "--model", model)
        assert result.code == 0
        assert load_skill(skill).model_ == model
        said[model] = " ".join(result.out.split())
    assert "model: mixture, because it was asked for" in said["mixture"]
    assert f"period {load_skill(skill).period_:.2f} s" in said["phase"]
    assert "cycles" in said["phase"]


def test_stretch_slows_the_skill_down(command, make_npz, outputs):
    demo = make_npz()
    windows = []
    for factor in (1, 2):
        skill = outputs / f"{factor}.npz"
        assert command("learn", demo, "--out", skill, "--stretch", factor).code == 0
        windows.append(load_skill(skill).n_windows_)
    # 20 s against 40 s, less a window of 6 s, every half second.
    assert windows[1] > 2 * windows[0]


def test_several_files_are_learned_together(command, make_npz, outputs):
    paths = [make_npz("one.npz"), make_npz("two.npz")]
    counts = []
    for files in (paths[:1], paths):
        skill = outputs / "skill.npz"
        assert command("learn", *files, "--out", skill).code == 0
        counts.append(load_skill(skill).n_windows_)
    assert counts[1] == 2 * counts[0]


def test_same_file_gives_the_same_skill(command, make_npz, outputs):
    demo = make_npz()
    skills = []
    for name in ("one.npz", "two.npz"):
        assert command("learn", demo, "--out", outputs / name).code == 0
        skills.append(load_skill(outputs / name))
    for one, two in zip(*(s.components_ for s in skills), strict=True):
        assert np.array_equal(one.mean, two.mean)


def test_failed_learning_keeps_the_older_skill(command, refused, make_npz, outputs):
    skill = outputs / "skill.npz"
    assert command("learn", make_npz(), "--out", skill).code == 0
    before = skill.read_bytes()
    refused("learn", make_npz("short.npz", seconds=1), "--out", skill)
    assert skill.read_bytes() == before


def test_demonstration_and_output_are_required(refused, make_npz):
    assert "DEMONSTRATIONS" in refused("learn", "--out", "skill.npz")
    assert "--out" in refused("learn", make_npz())
