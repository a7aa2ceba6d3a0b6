"""Facts about skill files."""

import json
import os
import stat

import numpy as np
import pytest
from sklearn.base import clone
from sklearn.exceptions import NotFittedError

from fmp_drake.errors import FmpError, SkillFileError
from fmp_drake.primitives import (
    Demonstration,
    FourierMovementPrimitive,
    Player,
    load_skill,
    save_skill,
)
from fmp_drake.primitives.model.skill_file import FORMAT


@pytest.fixture
def saved(tmp_path, small_skill):
    """A file with `small_skill` in it."""
    path = tmp_path / "skill.npz"
    save_skill(small_skill, path)
    return path


def rewritten(path, metadata=None, drop=(), **arrays):
    """Change a skill file: its metadata, its arrays, or leave some out."""
    with np.load(path) as file:
        content = {name: file[name] for name in file.files if name not in drop}
    old = json.loads(str(content["metadata"]))
    if callable(metadata):
        metadata(old)
        metadata = old
    if metadata is not None:
        content["metadata"] = np.array(json.dumps(metadata))
    np.savez(path, **{**content, **arrays})
    return path


def assert_same(one, two):
    assert one.get_params() == two.get_params()
    for name in ("n_channels_", "n_windows_", "channels_", "units_", "frame_"):
        assert getattr(one, name) == getattr(two, name)
    assert np.array_equal(one.proportions_, two.proportions_)
    assert np.array_equal(one.extent_, two.extent_)
    for a, b in zip(one.components_, two.components_, strict=True):
        assert np.array_equal(a.mean, b.mean)
        assert np.array_equal(a.basis, b.basis)
        assert np.array_equal(a.variances, b.variances)
        assert a.noise == b.noise


@pytest.mark.parametrize("fixture", ["small_skill", "odd_skill", "wiping_skill"])
def test_round_trip_is_exact(tmp_path, fixture, request):
    skill = request.getfixturevalue(fixture)
    path = tmp_path / "skill.npz"
    save_skill(skill, path)
    loaded = load_skill(str(path))
    assert_same(loaded, skill)
    start = skill.extent_.mean(axis=0)
    one, two = (Player(s, sample=True).rollout(start, 8.0) for s in (skill, loaded))
    assert np.array_equal(one, two)


def test_components_without_a_factor_survive(tmp_path):
    skill = FourierMovementPrimitive(n_steps=8, overlap=2).fit(np.zeros((4, 8, 1)))
    save_skill(skill, tmp_path / "s.npz")
    assert_same(load_skill(tmp_path / "s.npz"), skill)


def test_numpy_numbers_as_parameters_survive(tmp_path, small_skill):
    skill = clone(small_skill).set_params(
        n_components=np.int64(2), tolerance=np.float64(1e-7)
    )
    skill.fit(np.random.default_rng(0).standard_normal((9, 24, 2)))
    save_skill(skill, tmp_path / "s.npz")
    loaded = load_skill(tmp_path / "s.npz")
    assert loaded.get_params() == skill.get_params()


def test_saved_file_is_as_readable_as_any_other(saved, tmp_path):
    plain = tmp_path / "plain"
    plain.write_text("")
    assert stat.S_IMODE(saved.stat().st_mode) == stat.S_IMODE(plain.stat().st_mode)


def test_saving_leaves_nothing_else_behind(saved):
    assert os.listdir(saved.parent) == ["skill.npz"]


def test_unfitted_skill_is_not_saved(tmp_path):
    with pytest.raises(NotFittedError):
        save_skill(FourierMovementPrimitive(), tmp_path / "s.npz")
    assert os.listdir(tmp_path) == []


def test_file_survives_a_save_that_fails(saved, small_skill, odd_skill, monkeypatch):
    def run_out(_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", run_out)
    with pytest.raises(SkillFileError, match=r"cannot write .*: No space left"):
        save_skill(odd_skill, saved)
    assert_same(load_skill(saved), small_skill)
    assert os.listdir(saved.parent) == ["skill.npz"]


def test_parameter_that_cannot_be_written_leaves_the_file(saved, small_skill):
    odd = clone(small_skill).set_params(random_state=object())
    odd.__dict__.update({k: v for k, v in vars(small_skill).items() if k[-1] == "_"})
    with pytest.raises(TypeError, match="cannot be written"):
        save_skill(odd, saved)
    assert_same(load_skill(saved), small_skill)
    assert os.listdir(saved.parent) == ["skill.npz"]


def test_saving_into_a_missing_folder_is_an_error(tmp_path, small_skill):
    with pytest.raises(SkillFileError, match=r"cannot write .*No such file"):
        save_skill(small_skill, tmp_path / "nowhere" / "s.npz")


def test_saving_over_a_folder_is_an_error(tmp_path, small_skill):
    (tmp_path / "s.npz").mkdir()
    with pytest.raises(SkillFileError, match="cannot write"):
        save_skill(small_skill, tmp_path / "s.npz")
    assert os.listdir(tmp_path) == ["s.npz"]


@pytest.mark.parametrize("name", ["gone.npz", "."])
def test_missing_file_is_named(tmp_path, name):
    with pytest.raises(
        SkillFileError, match=r"there is no skill file .* `fmp-drake learn`"
    ):
        load_skill(tmp_path / name)


def test_newer_version_is_refused(saved):
    rewritten(saved, lambda m: m.update(version=FORMAT.version + 1))
    with pytest.raises(
        SkillFileError, match=rf"version {FORMAT.version + 1}; .* Update"
    ):
        load_skill(saved)


@pytest.mark.parametrize(
    "metadata",
    [
        [1],
        "text",
        3,
        {"version": 1},
        {"format": FORMAT.name},
        {"format": "x", "version": 1},
    ],
)
def test_foreign_metadata_is_refused(saved, metadata):
    rewritten(saved, metadata)
    with pytest.raises(SkillFileError, match="is not a skill file of fmp_drake"):
        load_skill(saved)


def test_demonstration_is_not_a_skill(tmp_path):
    path = tmp_path / "d.npz"
    Demonstration(time=np.arange(9), values=np.zeros((9, 2))).save(path)
    message = r"is not a skill file of fmp_drake \(its format is fmp-drake-demonstr"
    with pytest.raises(SkillFileError, match=message):
        load_skill(path)


def test_other_npz_is_not_a_skill(tmp_path):
    path = tmp_path / "other.npz"
    np.savez(path, time=np.arange(3))
    with pytest.raises(SkillFileError, match="is not a skill file of fmp_drake"):
        load_skill(path)


@pytest.mark.parametrize(
    "name", ["proportions", "extent", "means", "ranks", "bases", "variances", "noise"]
)
def test_skill_without_one_of_its_arrays_is_refused(saved, name):
    rewritten(saved, drop=(name,))
    with pytest.raises(SkillFileError, match=f"incomplete skill file: .*{name}"):
        load_skill(saved)


@pytest.mark.parametrize("name", ["parameters", "channels", "n_windows"])
def test_skill_without_some_metadata_is_refused(saved, name):
    rewritten(saved, lambda m: m.pop(name))
    with pytest.raises(SkillFileError, match=f"incomplete skill file: .*{name}"):
        load_skill(saved)


@pytest.mark.parametrize(
    "changes",
    [
        {"proportions": np.ones(2) / 2},
        {"noise": np.zeros(3)},
        {"means": np.zeros((3, 7))},
        {"ranks": np.array([1, 1])},
        {"extent": np.zeros(2)},
        {"extent": np.zeros((2, 5))},
    ],
)
def test_skill_with_arrays_that_do_not_fit_is_refused(saved, changes):
    rewritten(saved, **changes)
    with pytest.raises(SkillFileError, match="incomplete skill file"):
        load_skill(saved)


@pytest.mark.parametrize("proportions", [[0.5, 0.5, 0.5], [1.5, -0.25, -0.25]])
def test_skill_whose_proportions_are_not_probabilities_is_refused(saved, proportions):
    rewritten(saved, proportions=np.array(proportions))
    with pytest.raises(SkillFileError, match=r"not positive or do not add up to 1"):
        load_skill(saved)


@pytest.mark.parametrize(
    ("name", "value"),
    [("channels", ["x"]), ("channels", ["x", 2]), ("units", ["m", "m", "m"])],
)
def test_skill_without_a_name_and_a_unit_for_each_channel_is_refused(
    saved, name, value
):
    rewritten(saved, lambda metadata: metadata.update({name: value}))
    with pytest.raises(SkillFileError, match="a name and a unit for each channel"):
        load_skill(saved)


def test_skill_with_a_basis_that_is_not_orthonormal_is_refused(saved):
    with np.load(saved) as file:
        bases = file["bases"]
    rewritten(saved, bases=1.01 * bases)
    with pytest.raises(SkillFileError, match="a component is not orthonormal"):
        load_skill(saved)


@pytest.mark.parametrize("parameters", [{"n_steps": 30}, {"colour": 1}, {"overlap": 1}])
def test_skill_with_parameters_that_do_not_fit_is_refused(saved, parameters):
    rewritten(saved, lambda m: m["parameters"].update(parameters))
    with pytest.raises(SkillFileError, match="incomplete skill file"):
        load_skill(saved)


def test_truncated_file_is_refused(saved):
    whole = saved.read_bytes()
    for size in np.linspace(0, len(whole) - 1, 40).astype(int):
        saved.write_bytes(whole[:size])
        with pytest.raises(SkillFileError, match=r"not a readable \.npz"):
            load_skill(saved)


def test_file_with_any_byte_changed_is_refused_or_intact(saved, small_skill):
    whole = saved.read_bytes()
    for at in range(0, len(whole), 89):
        broken = bytearray(whole)
        broken[at] ^= 0xFF
        saved.write_bytes(broken)
        try:
            loaded = load_skill(saved)
        except FmpError as error:
            assert isinstance(error, SkillFileError)  # noqa: PT017
            continue
        assert_same(loaded, small_skill)


@pytest.mark.parametrize("content", [b"", b"hello", b"PK\x03\x04", b"\x80\x04K\x01."])
def test_foreign_bytes_are_refused(tmp_path, content):
    path = tmp_path / "s.npz"
    path.write_bytes(content)
    with pytest.raises(SkillFileError, match=r"not a readable \.npz"):
        load_skill(path)


def test_single_array_is_refused(tmp_path):
    path = tmp_path / "s.npz"
    with path.open("wb") as stream:
        np.save(stream, np.zeros((5, 3)))
    with pytest.raises(SkillFileError, match=r"not a readable \.npz"):
        load_skill(path)


class Trap:
    """Unpickling it would write a file."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return open, (str(self.path), "w")


def test_pickles_are_refused_and_never_run(saved, tmp_path):
    mark = tmp_path / "mark"
    rewritten(saved, means=np.array([Trap(mark)], dtype=object))
    with pytest.raises(SkillFileError, match="allow_pickle=False"):
        load_skill(saved)
    assert not mark.exists()


def test_file_with_parameters_of_an_earlier_version_is_read(saved, small_skill):
    def as_before(metadata):
        del metadata["overlap"], metadata["parameters"]["window"]
        metadata["parameters"].update(
            selection="evidence", n_components="bic", overlap=small_skill.overlap
        )

    loaded = load_skill(rewritten(saved, as_before))
    assert loaded.get_params()["n_components"] == len(small_skill.components_)
    assert loaded.overlap == small_skill.overlap
    assert np.array_equal(loaded.sample(2), small_skill.sample(2))


def test_file_of_version_1_has_scales_of_1_and_no_orientation(saved, small_skill):
    def older(metadata):
        metadata.pop("rotation_reference")
        metadata["version"] = 1

    rewritten(saved, older, drop=("scales",))
    loaded = load_skill(saved)
    assert np.array_equal(loaded.scales_, [1.0, 1.0])
    assert loaded.rotation_reference_ is None
    assert np.array_equal(loaded.sample(2, seed=1), small_skill.sample(2, seed=1))


@pytest.mark.parametrize("scales", [np.ones(3), np.zeros(2), np.full(2, np.nan)])
def test_scales_that_do_not_fit_are_refused(saved, scales):
    rewritten(saved, scales=scales)
    with pytest.raises(SkillFileError, match="incomplete skill file"):
        load_skill(saved)


def test_skill_without_its_scales_is_refused(saved):
    rewritten(saved, drop=("scales",))
    with pytest.raises(SkillFileError, match=r"incomplete skill file: .*scales"):
        load_skill(saved)


def test_scales_given_as_an_array_survive(tmp_path, small_skill):
    skill = clone(small_skill).set_params(scales=np.array([1.0, 2.0]))
    skill.fit(np.random.default_rng(0).standard_normal((9, 24, 2)))
    save_skill(skill, tmp_path / "s.npz")
    loaded = load_skill(tmp_path / "s.npz")
    assert np.array_equal(loaded.scales_, [1.0, 2.0])
    assert np.array_equal(loaded.sample(2, seed=1), skill.sample(2, seed=1))
