"""Facts about surfaces fitted to recordings, and poses and forces placed on them."""

import re
from dataclasses import asdict, replace

import numpy as np
import pytest
import yaml
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from fmp_drake.errors import DemonstrationError
from fmp_drake.primitives import Demonstration, ReadingOptions, add_orientation
from fmp_drake.primitives.data.channels import POSITION_CHANNELS, ROTATION_CHANNELS
from fmp_drake.primitives.data.orientation import as_rotation, skill_rotations
from fmp_drake.skills.contact import find_contact, touching_samples
from fmp_drake.skills.learning import learn_skill
from fmp_drake.skills.loading import load_as_recorded, load_on_board
from fmp_drake.skills.surface_fit import SHAPES, fit_surface
from fmp_drake.skills.surface_placement import (
    curved_surface_remark,
    place_on_fitted_surface,
)
from fmp_drake.station.scenario import Scenario
from fmp_drake.systems.surface.surface import Surface, place, rotations

SURFACES = {
    "plane": Surface(),
    "cylinder": Surface(kx=0.0, ky=1 / 0.3),
    "dome": Surface(kx=4.0, ky=4.0),
    "bowl": Surface(kx=-1 / 0.35, ky=-1 / 0.35),
}
RADII = {"cylinder": 0.3, "dome": 0.25, "bowl": 0.35}
R_DS = Rotation.from_rotvec([0.4, -0.5, 1.0])
P_DS = np.array([0.5, 0.2, 0.3])
# How the tool is mounted: nobody knows it.
MOUNT = Rotation.from_rotvec([2.0, 0.3, -0.4])


def wiping(shape, *, lift=0.0, approach=True, noise=0.001, size=1.0):
    """Return time, (u, v, h), contact, and points in D of a noisy wiping movement."""
    time = np.arange(0, 24, 0.02)
    uvh = np.zeros((len(time), 3))
    uvh[:, 0] = 0.12 * size * np.sin(np.pi * time)
    uvh[:, 1] = 0.10 * size * np.sin(2 * np.pi * time + 0.4)
    uvh[:, 2] = lift * np.clip(np.sin(np.pi * time / 2) - 0.5, 0, None)
    if approach:
        away = np.clip(2 - time, 0, None) + np.clip(time - 22, 0, None)
        uvh[:, 2] += 0.1 * away
    rng = np.random.default_rng(0)
    noisy = place(SURFACES[shape], uvh) + noise * rng.standard_normal(uvh.shape)
    return time, uvh, uvh[:, 2] == 0, R_DS.apply(noisy) + P_DS


def posed(shape, *, force="tool", tilt=0.1, **options):
    """Return a recording with orientation and force (about 12 N), and its truth."""
    time, uvh, on, points = wiping(shape, **options)
    phi = tilt * np.column_stack(
        [np.sin(np.pi * time), np.sin(2 * np.pi * time), 0 * time]
    )
    R_ST = Rotation.from_matrix(rotations(SURFACES[shape], uvh))
    R_DE = R_DS * R_ST * Rotation.from_rotvec(phi) * MOUNT
    contact_force = np.where(on, 12 + 3 * np.sin(np.pi * time), 0.0)
    normal = (R_DS * R_ST).apply([0.0, 0.0, 1.0])
    if force == "tool":
        vectors = contact_force[:, None] * MOUNT.inv().apply([0.0, 0.0, 1.0])
    elif force == "world":
        vectors = contact_force[:, None] * normal
    else:
        vectors = contact_force[:, None]
    names = ["force_x", "force_y", "force_z"] if vectors.shape[1] == 3 else ["force"]
    recording = Demonstration(
        time=time,
        values=np.concatenate([points, vectors], axis=1),
        channels=("x", "y", "z", *names),
        units=("m", "m", "m", *["N"] * len(names)),
    )
    return add_orientation(recording, R_DE), uvh, on, phi, contact_force


@pytest.mark.parametrize("lift", [0.0, 0.1])
@pytest.mark.parametrize("shape", SHAPES)
def test_shape_radius_and_pose_of_a_noisy_surface_are_found(shape, lift):
    _, uvh, on, points = wiping(shape, lift=lift)
    fit = fit_surface([points], [on])
    assert fit.shape == shape
    assert "the tool is never lifted" not in fit.describe()
    # 1 mm of noise over a patch of 0.24 m x 0.20 m: the radius to 3 %, the normal to 1
    # degree, the distance to 1 mm.
    if shape != "plane":
        assert fit.radius == pytest.approx(RADII[shape], rel=0.03)
    truth = R_DS.apply(place(SURFACES[shape], np.zeros((1, 3))))[0] + P_DS
    coordinates = fit.coordinates(truth[None])[0]
    assert abs(coordinates[2]) < 0.001
    normal = fit.rotation @ rotations(fit.curvature, coordinates[None])[0][:, 2]
    angle = np.arccos(np.clip(normal @ R_DS.apply([0.0, 0.0, 1.0]), -1, 1))
    assert np.degrees(angle) < 1
    assert fit.residual == pytest.approx(0.001, rel=0.15)
    heights = fit.coordinates(points)[:, 2]
    assert_allclose(heights, uvh[:, 2], atol=0.006)


@pytest.mark.parametrize("shape", SHAPES)
def test_lifts_without_a_force_do_not_move_the_surface(shape):
    time, _, _, points = wiping(shape, lift=0.1)
    in_movement = (time > 2) & (time < 22)
    fit = fit_surface([points], [in_movement])
    assert fit.shape == shape
    if shape != "plane":
        assert fit.radius == pytest.approx(RADII[shape], rel=0.05)


def test_plane_is_preferred_to_a_curvature_within_the_noise():
    *_, on, points = wiping("plane", noise=0.003)
    fit = fit_surface([points], [on])
    assert fit.shape == "plane"
    assert set(fit.residuals) == set(SHAPES)
    assert "residuals in mm: plane" in fit.describe()


@pytest.mark.parametrize("shape", ["cylinder", "dome", "bowl"])
def test_shapes_that_share_the_path_are_told_by_the_tool(shape):
    angle = np.arange(0, 24, 0.05) * np.pi
    uvh = np.column_stack([0.1 * np.cos(angle), 0.06 * np.sin(angle), 0 * angle])
    noise = np.random.default_rng(0).normal(0, 5e-4, uvh.shape)
    points = R_DS.apply(place(SURFACES[shape], uvh) + noise) + P_DS
    on = np.ones(len(points), dtype=bool)
    assert fit_surface([points], [on]).shape == "cylinder"
    turn = Rotation.from_rotvec(0.3 * np.sin(3 * angle)[:, None] * [0.0, 0.0, 1.0])
    tool = R_DS * Rotation.from_matrix(rotations(SURFACES[shape], uvh)) * turn * MOUNT
    fit = fit_surface([points], [on], tools=[tool])
    assert fit.shape == shape
    assert fit.tilt(points, tool) < np.radians(3)


@pytest.mark.parametrize("shape", ["cylinder", "dome", "bowl"])
@pytest.mark.parametrize("is_wall", [False, True])
def test_side_of_a_surface_without_lifts_is_upwards_or_that_of_the_tool(shape, is_wall):
    _, uvh, on, points = wiping(shape, approach=False)
    on = uvh[:, 0] < 0.08  # A weak force is not a lift.
    frame = Rotation.from_euler("yz", [np.pi / 2, 3.0]) if is_wall else R_DS
    points = frame.apply(R_DS.apply(points - P_DS, inverse=True))
    out_of = frame * Rotation.from_matrix(rotations(SURFACES[shape], uvh))
    into = out_of * Rotation.from_euler("x", np.pi)
    # A tracked tool may point upwards.
    for tool in [into] if is_wall else [into, out_of]:
        fit = fit_surface([points], [on], tools=[tool])
        assert fit.shape == shape
        assert fit.radius == pytest.approx(RADII[shape], rel=0.05)
        found = fit.describe()
        assert ("its z axis is taken to point into the surface" in found) == is_wall
        place = "a side" if is_wall else "above"
        assert f"taken to be touched from {place} (z of the recording)" in found
        assert ("--surface dome" in found) == (shape != "cylinder")
    if not is_wall:
        fit = fit_surface([points], [on])
        assert fit.shape == shape
        assert "taken to be touched from above" in fit.describe()
    if shape == "bowl":  # The sphere of a dome, from the other side.
        every = np.ones(len(points), dtype=bool)
        fit = fit_surface([points], [every], tools=[into], shape="dome")
        assert fit.residual < 0.002


@pytest.mark.parametrize("angle", [0.0, 3.1])
def test_shape_tells_the_side_of_a_wall_only(angle):
    *_, on, points = wiping("cylinder", approach=False)
    local = R_DS.apply(points - P_DS, inverse=True)
    wall = Rotation.from_euler("yz", [np.pi / 2, angle])
    fit = fit_surface([wall.apply(local)], [on])
    assert fit.shape == "cylinder"
    assert fit.rotation[:, 2] @ wall.apply([0.0, 0.0, 1.0]) > 0.99
    assert "touched from a side" in fit.describe()
    # A trough that is touched from above is no cylinder that is touched from below.
    fit = fit_surface([local * [1.0, 1.0, -1.0]], [on])
    assert fit.rotation[2, 2] > 0.99
    assert "touched from above" in fit.describe()


def test_weight_of_a_tool_is_no_contact():
    recording, *_ = posed("plane", force="world", lift=0.1)
    force = [name.startswith("force") for name in recording.channels]
    heavy = recording.values.copy()
    heavy[:, force] += [1.0, -2.0, -6.0]
    noise = np.random.default_rng(0).normal(0, 0.3, (len(heavy), 3))
    heavy[:, force] += noise
    found = []
    for values in (recording.values, heavy):
        placed, remarks = place_on_fitted_surface(
            [replace(recording, values=values)], scenario=Scenario(), extra=("force",)
        )
        found.append(placed[0].values)
        is_told = any("6.4 N subtracted from the force" in remark for remark in remarks)
        assert is_told == (values is heavy)
    light, corrected = found
    assert np.mean(light[:, 3] == 0) > 0.2  # It is lifted.
    assert np.mean((light[:, 3] > 0) == (corrected[:, 3] > 0)) > 0.98
    assert_allclose(corrected[:, 3].mean(), light[:, 3].mean(), atol=0.3)
    assert_allclose(corrected[:, 2], light[:, 2], atol=0.005)


def test_vibrations_hide_no_weight_and_are_not_limited():
    recording, _, on, _, force = posed("plane", force="world")
    vibration = 9 * np.sin(2 * np.pi * 13 * recording.time)
    values = recording.values.copy()
    # Along the normal, which is the mean direction of the force.
    values[:, 3:6] += R_DS.apply([0.0, 0.0, 1.0]) * vibration[:, None] + [0, 0, -5.0]
    scenario = Scenario()
    scenario.eraser.footprint = [0.06, 0.05]  # The felt bears 25 N.
    placed, remarks = place_on_fitted_surface(
        [replace(recording, values=values)], scenario=scenario, extra=("force",)
    )
    assert any("5.0 N subtracted from the force" in remark for remark in remarks)
    assert not any("limit of the felt" in remark for remark in remarks)
    played = np.concatenate([d.values[:, 3] for d in placed])
    assert played[played > 0].mean() == pytest.approx(force[on].mean(), abs=0.5)


def test_a_force_in_an_unknown_unit_is_refused():
    recording, *_ = posed("plane")
    units = tuple("V" if unit == "N" else unit for unit in recording.units)
    with pytest.raises(
        DemonstrationError, match=r"unit of force_x, .* is V; it must be"
    ):
        place_on_fitted_surface(
            [replace(recording, units=units)], scenario=Scenario(), extra=("force",)
        )


def strokes(shape, *, lift=0.04, mass=0.0, tilt=(0.0, 0.4, 0.2)):
    """Return a recording of strokes that go back in the air, and contact and R_DS.

    The tool is normal to the surface, and its sensor measures contact and weight in its frame.
    """
    time = np.arange(0, 20, 0.02)
    turn = 2 * np.pi * np.clip((time - 2.5) / 3, 0, 5)
    away = np.clip(2.5 - time, 0, None) + np.clip(time - 17.5, 0, None)
    uvh = np.zeros((len(time), 3))
    uvh[:, 0] = 0.06 * np.sin(turn) + 0.04 * np.sin(turn / 5)
    uvh[:, 1] = -0.1 * np.cos(turn)
    uvh[:, 2] = lift * np.clip(-np.sin(turn), 0, None) + 0.06 * away
    on = uvh[:, 2] < 1e-6
    R_DS = Rotation.from_euler("xyz", tilt)
    rng = np.random.default_rng(0)
    points = place(SURFACES[shape], uvh) + 0.001 * rng.standard_normal(uvh.shape)
    R_SN = Rotation.from_matrix(rotations(SURFACES[shape], uvh))
    R_DE = R_DS * R_SN * Rotation.from_euler("x", np.pi)
    normal = (R_DS * R_SN).apply([0.0, 0.0, 1.0])
    in_world = (10.0 * on)[:, None] * normal - [0.0, 0.0, 9.81 * mass]
    force = R_DE.inv().apply(in_world) + 0.2 * rng.standard_normal(uvh.shape)
    recording = Demonstration(
        time=time,
        values=np.column_stack([R_DS.apply(points) + P_DS, force]),
        channels=("x", "y", "z", "force_x", "force_y", "force_z"),
        units=("m",) * 3 + ("N",) * 3,
    )
    return add_orientation(recording, R_DE), on & (away == 0), R_DS


@pytest.mark.parametrize("tilt", [(0.0, 0.4, 0.2), (1.2, 0.0, 0.3)])
@pytest.mark.parametrize("shape", SHAPES)
def test_without_a_force_the_orientation_tells_lifts_from_contact(shape, tilt):
    recording, on, R_DS = strokes(shape, tilt=tilt)
    posed = recording.select([*POSITION_CHANNELS, *ROTATION_CHANNELS])
    contact = find_contact(posed)
    in_bout = contact.in_bout
    assert np.mean(contact.touching[in_bout] == on[in_bout]) > 0.85
    points = posed.values[:, :3]
    fit = fit_surface([points], [contact.touching])
    assert fit.shape == shape
    if shape != "plane":
        assert fit.radius == pytest.approx(RADII[shape], rel=0.15)
    normal = fit.rotation[:, 2] @ R_DS.apply([0.0, 0.0, 1.0])
    assert np.degrees(np.arccos(min(normal, 1.0))) < 7
    # Without the orientation, all samples of the movement are contact.
    assert np.array_equal(
        find_contact(posed.select(POSITION_CHANNELS)).touching, in_bout
    )


def test_orientation_of_a_real_recording_tells_its_lifts(real_demonstration_paths):
    reading = ReadingOptions(all_arrays=True)
    (recorded,), _ = load_as_recorded(
        [real_demonstration_paths["car_fender_3"]], stretch=1.0, reading=reading
    )
    with_force = find_contact(recorded)
    posed = recorded.select([*POSITION_CHANNELS, *ROTATION_CHANNELS])
    contact = find_contact(posed)
    found = touching_samples(contact, fit_of(posed, contact))
    known = touching_samples(with_force, fit_of(recorded, with_force))
    in_bout = contact.in_bout
    assert 0.5 < np.mean(known[in_bout]) < 0.65
    assert np.mean(found[in_bout] == known[in_bout]) > 0.9


@pytest.mark.parametrize("number", [1, 2, 3, 4])
def test_strokes_of_a_real_board_are_told_from_the_return_in_the_air(
    number, real_demonstration_paths
):
    # The board is level to 5 degrees, and half of the time the arm returns over it.
    path = real_demonstration_paths[f"panda_wiping_loop_increase_z_{number}"]
    (recorded,), _ = load_as_recorded([path], stretch=1.0, extra=["orientation"])
    contact = find_contact(recorded)
    points = recorded.values[:, :3]
    fit = fit_surface([points], [contact.touching])
    assert fit.rotation[2, 2] > np.cos(np.radians(5))
    touching = touching_samples(contact, fit_of(recorded, contact))
    assert 0.4 < np.mean(touching[contact.in_bout]) < 0.65
    (placed,), _ = load_on_board([path], scenario=Scenario())
    assert 0.4 < np.mean(np.abs(placed.values[:, 2]) < 0.01) < 0.8
    assert placed.values[:, 2].min() > -0.05
    assert placed.values[:, 2].max() > 0.15


def fit_of(recording, contact):
    """Return the heights over the surface that is fitted to a recording."""
    points = recording.select(POSITION_CHANNELS).values
    return fit_surface([points], [contact.touching]).coordinates(points)[:, 2]


@pytest.mark.parametrize("mass", [0.3, 0.8])
@pytest.mark.parametrize("shape", SHAPES)
def test_weight_that_turns_in_the_frame_of_the_tool_is_subtracted(shape, mass):
    recording, on, _ = strokes(shape, mass=mass)
    contact = find_contact(recording)
    assert contact.offset == pytest.approx(9.81 * mass, rel=0.05)
    magnitude = np.linalg.norm(contact.force, axis=1)
    assert_allclose(magnitude[on].mean(), 10.0, atol=0.3)
    assert magnitude[contact.in_bout & ~on].mean() < 0.6


@pytest.mark.parametrize("offset", [[0.0, 0.0, 9.0], [-3.0, 8.0, 2.0], [5.0]])
@pytest.mark.parametrize("shape", ["plane", "cylinder"])
def test_offset_of_the_force_is_that_of_the_lifts(shape, offset):
    kind = "tool" if len(offset) == 3 else "scalar"
    recording, *_ = posed(shape, force=kind, lift=0.2, approach=False)
    force = [name.startswith("force") for name in recording.channels]
    values = recording.values.copy()
    noise = np.random.default_rng(0).normal(0, 0.3, (len(values), len(offset)))
    values[:, force] += offset + noise
    scenario = Scenario()
    (placed,), remarks = place_on_fitted_surface(
        [replace(recording, values=values)], scenario=scenario, extra=("force",)
    )
    assert scenario.board.shape == shape
    size = float(re.match(r"(\S+) N subtracted", remarks[0])[1])
    assert size == pytest.approx(np.linalg.norm(offset), abs=0.15)
    (true,), _ = place_on_fitted_surface(
        [recording], scenario=Scenario(), extra=("force",)
    )
    assert_allclose(placed.values[:, 3].mean(), true.values[:, 3].mean(), atol=0.3)
    assert_allclose(placed.values[:, 2], true.values[:, 2], atol=0.005)


@pytest.mark.parametrize("lift", [0.0, 0.1, 0.2])
@pytest.mark.parametrize("shape", SHAPES)
def test_constant_force_in_contact_is_no_offset(shape, lift):
    recording, _, on, *_ = posed(shape, force="scalar", lift=lift, approach=False)
    values = recording.values.copy()
    column = recording.channels.index("force")
    values[:, column] = np.where(on, 12.0, 0.0)
    noise = np.random.default_rng(0).normal(0, 0.3, len(values))
    values[:, column] += noise
    (placed,), remarks = place_on_fitted_surface(
        [replace(recording, values=values)], scenario=Scenario(), extra=("force",)
    )
    assert not any("subtracted" in remark for remark in remarks)
    assert np.mean(placed.values[:, 3] > 0) == pytest.approx(np.mean(on), abs=0.05)


def test_eraser_is_shortened_on_a_strong_curvature():
    time, uvh, *_ = wiping("plane")
    points = place(Surface(kx=1 / 0.12, ky=1 / 0.12), 0.6 * uvh)
    recording = Demonstration(time=time, values=points, channels=("x", "y", "z"))
    scenario = Scenario()
    _, remarks = place_on_fitted_surface([recording], scenario=scenario)
    assert any("eraser shortened to" in remark for remark in remarks)
    assert scenario.board.radius == pytest.approx(0.12, rel=0.05)
    assert max(scenario.eraser.footprint) < 0.09
    assert remarks[-1] == "normal force lowered to 9 N, which the felt bears"
    assert scenario.press.force == 9.0


@pytest.mark.parametrize("radius", [0.08, 0.1])
def test_board_is_as_large_as_the_shortened_eraser_needs(radius):
    time, uvh, *_ = wiping("plane")
    surface = Surface(kx=1 / radius, ky=1 / radius)
    points = place(surface, 5 * radius * uvh)
    recording = Demonstration(time=time, values=points, channels=("x", "y", "z"))
    scenario = Scenario()
    _, remarks = place_on_fitted_surface([recording], scenario=scenario)
    assert any("eraser shortened to" in remark for remark in remarks)
    assert scenario.board.radius == pytest.approx(radius, rel=0.05)


def test_edge_along_a_cylinder_is_not_shortened():
    time, uvh, *_ = wiping("plane")
    points = place(Surface(kx=0.0, ky=1 / 0.1), 0.6 * uvh)
    recording = Demonstration(time=time, values=points, channels=("x", "y", "z"))
    scenario = Scenario()
    scenario.eraser.footprint = [0.12, 0.12]
    place_on_fitted_surface([recording], scenario=scenario)
    assert max(scenario.eraser.footprint) == 0.12
    assert min(scenario.eraser.footprint) < 0.1


def test_nearly_flat_surface_is_a_plane():
    uvh = wiping("plane")[1]
    noise = np.random.default_rng(0).normal(0, 1e-4, uvh.shape)
    points = place(Surface(kx=1 / 8, ky=1 / 8), uvh) + noise
    on = np.ones(len(points), dtype=bool)
    assert fit_surface([points], [on]).shape == "plane"


def test_shape_of_the_surface_may_be_given():
    *_, on, points = wiping("dome")
    assert fit_surface([points], [on], shape="plane").shape == "plane"
    with pytest.raises(DemonstrationError, match="choose one of: plane, cylinder"):
        fit_surface([points], [on], shape="torus")


def test_points_that_determine_no_surface_are_refused():
    line = np.outer(np.linspace(0, 1, 50), [1.0, 2.0, 3.0])
    with pytest.raises(DemonstrationError, match="its surface is not determined"):
        fit_surface([line], [np.ones(50, dtype=bool)])
    with pytest.raises(DemonstrationError, match="touches in 5 samples"):
        fit_surface([line], [np.arange(50) < 5])
    cloud = np.random.default_rng(0).uniform(-0.1, 0.1, (500, 3))
    with pytest.raises(DemonstrationError, match="no surface fits"):
        fit_surface([cloud], [np.ones(500, dtype=bool)])


@pytest.mark.parametrize("force", ["tool", "world", "scalar"])
@pytest.mark.parametrize("shape", SHAPES)
def test_pose_and_force_are_relative_to_the_local_normal(shape, force):
    recording, _, on, phi, contact_force = posed(shape, force=force, tilt=0.05)
    scenario = Scenario()
    (placed,), remarks = place_on_fitted_surface(
        [recording], scenario=scenario, extra=("orientation", "force")
    )
    board = scenario.board
    assert board.shape == shape
    if shape != "plane":
        assert board.radius == pytest.approx(RADII[shape], rel=0.03)
    scenario.check()
    assert placed.channels == ("x", "y", "z", "rx", "ry", "rz", "force")
    assert placed.units == ("m",) * 3 + ("rad",) * 3 + ("N",)
    assert placed.frame == "board"
    index = np.searchsorted(recording.time, placed.time)
    on = on[index]
    # In simulation 12 mm of felt bear 42 N, and 2.13 mm 10 N.
    depth = -placed.values[on, 2]
    assert np.ptp(depth) == 0
    borne = np.interp(depth[0], [0.0, 0.00213, 0.012], [0.0, 10.0, 42.0])
    assert borne == pytest.approx(np.mean(placed.values[on, 6]), rel=0.1)
    # About the normal the frame of the fit is the recording's, not that of the truth.
    assert np.ptp(placed.values[on, :2], axis=0).max() == pytest.approx(0.24, abs=0.05)
    tilt, expected = (
        np.linalg.norm(x[:, :2], axis=1) for x in (placed.values[:, 3:6], phi[index])
    )
    assert_allclose(tilt[on], expected[on], atol=np.radians(2))
    # The felt bears less on a sphere, where its edges lift: the force is scaled.
    highest, placed_highest = (
        np.percentile(f, 95) for f in (contact_force[index][on], placed.values[on, 6])
    )
    scale = placed_highest / highest
    assert (scale == pytest.approx(1.0, abs=0.02)) == (shape != "dome")
    force_error = placed.values[on, 6] - scale * contact_force[index][on]
    assert scale > 0.7
    assert np.sqrt(np.mean(force_error**2)) < 0.5
    nominal = scenario.eraser_orientation().matrix()
    mean = skill_rotations_of(placed)[on].mean().as_matrix()
    assert_allclose(mean, nominal, atol=0.02)
    assert any("residuals in mm" in remark for remark in remarks)


def skill_rotations_of(recording):
    """Return R_TE of a recording."""

    class Channels:
        channels_ = recording.channels
        rotation_reference_ = recording.rotation_reference

    return skill_rotations(Channels, recording.values)


def test_large_path_is_scaled_with_its_radius():
    recording, *_ = posed("cylinder", size=2.5)
    scenario = Scenario()
    (placed,), _ = place_on_fitted_surface([recording], scenario=scenario)
    scale = scenario.board.radius / 0.3
    # 0.36 m of 0.60 m are left beside the eraser and its border.
    assert scale == pytest.approx(0.6, abs=0.02)
    assert np.ptp(placed.values[:, 0]) <= 0.5
    scenario.check()


def test_only_the_bouts_of_the_given_part_are_placed():
    recording, *_ = posed("cylinder")
    (placed,), _ = place_on_fitted_surface(
        [recording], scenario=Scenario(), start_time=8.0, end_time=16.0
    )
    assert placed.time[0] >= 7.95
    assert placed.time[-1] <= 16.05
    assert placed.duration > 6


def test_missing_channels_and_forces_are_refused():
    recording, *_ = posed("plane")
    position = recording.select(["x", "y", "z"])
    for extra, message in (
        (
            "orientation",
            r"needs a quaternion .* a rotation vector .* \(roll, pitch, yaw\)",
        ),
        ("force", "a force needs force, .* --columns force=NAME$"),
        ("torque", "choose from: orientation, force"),
    ):
        with pytest.raises(DemonstrationError, match=message):
            place_on_fitted_surface([position], scenario=Scenario(), extra=[extra])
    flat = replace(position.select(["x", "y"]), channels=("x", "fz"))
    with pytest.raises(DemonstrationError, match="x, fz; a surface needs x, y and z: "):
        place_on_fitted_surface([flat], scenario=Scenario())
    along = recording.select([*"xyz", "force_y", "force_z"])
    for names, suggested in (
        (("target_force", "Fz"), "Fz"),
        (("target_force", "force_n"), "force_n"),
        (("target_force", "contact_force"), "contact_force"),
        (("force_x", "force_y"), "NAME"),
    ):
        named = replace(along, channels=(*"xyz", *names))
        with pytest.raises(DemonstrationError, match=rf"--columns force={suggested}$"):
            place_on_fitted_surface([named], scenario=Scenario(), extra=["force"])
    weak = Demonstration(
        time=recording.time,
        values=np.column_stack([position.values, np.full(len(recording.time), 0.1)]),
        channels=("x", "y", "z", "force"),
        units=("m", "m", "m", "N"),
    )
    with pytest.raises(DemonstrationError, match=r"at most 0\.1 N"):
        place_on_fitted_surface([weak], scenario=Scenario())


def test_force_is_limited_by_the_felt():
    recording, *_ = posed("plane")
    values = recording.values.copy()
    values[:, 3:6] *= 10
    strong = Demonstration(
        time=recording.time,
        values=values[:, :6],
        channels=recording.channels[:6],
        units=recording.units[:6],
    )
    (placed,), remarks = place_on_fitted_surface(
        [strong], scenario=Scenario(), extra=["force"]
    )
    # 150 N at most; the felt bears 42 N, to which the 95 % quantile is scaled.
    assert placed.values[:, 3].max() == pytest.approx(42)
    assert placed.values[placed.values[:, 3] > 0, 3].min() < 0.7 * 42
    assert any("the limit of the felt: 42 N" in remark for remark in remarks)


@pytest.mark.parametrize("factor", [0.1, 1.0, 10.0])
def test_friction_of_a_force_displaces_the_tool_by_3_mm_at_most(factor):
    recording, *_ = posed("plane", force="scalar")
    values = recording.values * np.array([1, 1, 1, factor, *[1] * 3])
    scenario, default = Scenario(), Scenario().impedance
    (placed,), remarks = place_on_fitted_surface(
        [replace(recording, values=values)], scenario=scenario, extra=["force"]
    )
    friction = 0.5 * np.percentile(placed.values[:, 3], 95)
    x, y, z = scenario.impedance.translational_stiffness
    assert x == y >= 1500
    assert z == default.translational_stiffness[2]
    assert friction / x < 0.0036
    assert any("stiffness raised" in remark for remark in remarks) == (x > 1500)
    # As before, at most 150 N where the tool is far from its target.
    assert x * scenario.impedance.max_translation_error == pytest.approx(150, rel=0.01)
    assert (x > 1500) == (factor > 0.1)


def test_the_fitted_board_can_be_written_as_yaml():
    scenario = Scenario()
    place_on_fitted_surface([posed("dome")[0]], scenario=scenario)
    board = yaml.safe_load(yaml.safe_dump(asdict(scenario.board)))
    assert board["radius"] == scenario.board.radius


def test_tilt_is_scaled_to_the_limit_of_the_felt():
    recording, *_ = posed("plane", tilt=0.3)
    (placed,), remarks = place_on_fitted_surface(
        [recording], scenario=Scenario(), extra=["orientation"]
    )
    on = placed.values[:, 2] == 0
    # Edges are 60 mm and 25 mm from the middle: half of the felt's 12 mm.
    lift = np.abs(placed.values[on, 3:5]) @ [0.025, 0.060]
    assert np.percentile(lift, 95) == pytest.approx(0.006)
    assert any("the limit of the felt; if it never" in remark for remark in remarks)


def test_contact_between_lifts_is_a_little_below_the_surface():
    recording, _, on, *_ = posed("plane", lift=0.2)
    (placed,), _ = place_on_fitted_surface([recording], scenario=Scenario())
    on = on[np.searchsorted(recording.time, placed.time)]
    heights = placed.values[:, 2]
    lift = np.percentile(heights, 95) - heights[on].max()
    assert np.ptp(heights[on]) == 0
    assert heights[on][0] == pytest.approx(-0.01 * lift)
    assert heights[on][0] < -0.0009


def test_smoothed_force_does_not_move_contact_into_the_air():
    recording, _, on, *_ = posed("plane", force="scalar", lift=0.2)
    values = recording.values.copy()
    # Half a second of smoothing: the force rises before the contact and falls after it.
    window = np.hanning(52)[1:-1]
    values[:, 3] = np.convolve(values[:, 3], window / window.sum(), mode="same")
    early = (values[:, 3] > 0.3 * np.percentile(values[:, 3], 95)) & ~on
    height = (values[:, :3] - P_DS) @ R_DS.as_matrix()[:, 2]
    assert np.max(height[early]) > 0.02
    (placed,), _ = place_on_fitted_surface(
        [replace(recording, values=values)], scenario=Scenario(), extra=["force"]
    )
    index = np.searchsorted(recording.time, placed.time)
    height, force = height[index], placed.values[:, 3]
    low = placed.values[:, 2].min()
    assert np.max(height[placed.values[:, 2] == low]) < 0.011
    assert np.all(force[height > 0.011] == 0)
    assert np.mean(force[on[index]] > 5) > 0.95


def test_weak_force_without_a_lift_is_contact():
    recording, *_ = posed("plane", force="scalar")
    values = recording.values.copy()
    weak = np.abs(recording.time % 2 - 1) < 0.2
    values[weak, 3] = 1.0
    (placed,), _ = place_on_fitted_surface(
        [replace(recording, values=values)], scenario=Scenario(), extra=["force"]
    )
    weak = weak[np.searchsorted(recording.time, placed.time)]
    # The tool is on the surface from 2 to 22 s.
    inner = (placed.time > 2.1) & (placed.time < 21.9)
    assert np.ptp(placed.values[inner, 2]) == 0
    assert_allclose(placed.values[inner & weak, 3], 1.0)


def test_controller_can_follow_placed_orientations_and_forces():
    recording, *_ = posed("plane")
    for extra, stiffness, has_control in (
        ([], [30.0, 30.0, 3.0], False),
        (["orientation"], [60.0, 60.0, 60.0], False),
        (["force"], [30.0, 30.0, 3.0], True),
    ):
        scenario = Scenario()
        place_on_fitted_surface([recording], scenario=scenario, extra=extra)
        assert scenario.impedance.rotational_stiffness == stiffness
        assert scenario.impedance.force_control.enabled == has_control


def test_extra_channels_need_a_surface(tmp_path):
    path = tmp_path / "recording.npz"
    posed("plane")[0].save(path)
    words = r"--surface fitted\); a movement in free space: .* --as-recorded"
    with pytest.raises(DemonstrationError, match=words):
        load_on_board(
            [path], scenario=Scenario(), transform=None, stretch=1.0, extra=["force"]
        )


@pytest.mark.parametrize("shape", SHAPES)
def test_flat_placement_recommends_a_fitted_surface_only_where_it_is_curved(
    tmp_path, shape
):
    path = tmp_path / "recording.npz"
    posed(shape)[0].save(path)
    _, remarks = load_on_board([path], scenario=Scenario(), transform=None, stretch=1.0)
    options = "--surface fitted --extra orientation --extra force"
    assert any(f"x, y and z ({options} learns more)" in remark for remark in remarks)
    advice = [remark for remark in remarks if "add --surface fitted" in remark]
    assert len(advice) == (shape != "plane")
    for remark in advice:
        assert remark.startswith("recording.npz: its contact is ")
        assert f"from a {shape} of radius {RADII[shape]:.1f}" in remark


def test_options_for_poses_and_forces_are_told_where_the_arrays_are_not_read(
    real_demonstration_paths,
):
    path = real_demonstration_paths["car_rim_1"]
    _, remarks = load_on_board([path], scenario=Scenario())
    options = "--surface fitted --extra orientation --extra force"
    assert f"{path.name}: to learn more of it: {options}" in remarks


def test_contact_far_from_every_surface_is_remarked():
    *_, on, points = wiping("plane", noise=0.015)
    fit = fit_surface([points], [on])
    assert fit.residual > 0.01
    assert "the contact may contain lifts" in fit.describe()


def test_surface_is_fitted_to_metres_only(tmp_path):
    path, recording = tmp_path / "recording.npz", posed("plane")[0]
    in_mm = [1e3 if unit == "m" else 1.0 for unit in recording.units]
    replace(recording, values=recording.values * in_mm).save(path)
    with pytest.raises(
        DemonstrationError, match=r"m wide: millimetres\? Give --unit mm"
    ):
        load_on_board([path], scenario=Scenario(), surface="fitted")


def test_a_transform_beside_a_fitted_surface_is_refused(tmp_path):
    path = tmp_path / "path.csv"
    path.write_text("time,x,y,z\n0,0,0,0\n1,0.1,0,0\n")
    with pytest.raises(DemonstrationError, match="leave out --transform or --surface"):
        load_on_board(path, scenario=Scenario(), transform=[0.0] * 6, surface="fitted")


def test_surface_is_fitted_to_the_path_and_orientation_of_joints(tmp_path):
    time = np.arange(0, 12, 0.02)
    angles = np.array([0, -0.8, 0, -2.4, 0, 1.6, 0.8]) + 0.2 * np.column_stack(
        [
            np.sin(2 * time),
            np.cos(2 * time),
            *[0 * time] * 3,
            np.sin(4 * time),
            0 * time,
        ]
    )
    joints = Demonstration(
        time=time,
        values=angles,
        channels=tuple(f"panda_joint{i}" for i in range(1, 8)),
        units=("rad",) * 7,
    )
    joints.save(tmp_path / "joints.npz")
    (placed, *_), remarks = load_on_board(
        [tmp_path / "joints.npz"],
        scenario=Scenario(),
        surface="plane",
        extra=["orientation"],
    )
    assert any("by the forward kinematics of panda" in remark for remark in remarks)
    assert placed.channels == (*POSITION_CHANNELS, *ROTATION_CHANNELS)
    # The tool turns about the vertical with the first joint, by 0.4 rad.
    assert 0.3 < np.ptp(placed.values[:, 5]) < 0.6


def test_flat_placement_needs_no_other_arrays_of_a_file(tmp_path):
    path, time = tmp_path / "recording.npz", np.arange(0, 20, 0.05)
    circles = 0.1 * np.column_stack([np.cos(3 * time), np.sin(3 * time), 0 * time])
    np.savez(path, time=time, position=circles, x=circles[:, 0])
    placed, _ = load_on_board([path], scenario=Scenario(), transform=None, stretch=1.0)
    assert placed[0].channels == ("x", "y", "z")


def test_a_recording_exactly_on_a_plane_is_not_called_curved():
    time = np.arange(0, 20, 0.05)
    circles = 0.1 * np.column_stack([np.cos(3 * time), np.sin(3 * time), 0 * time])
    assert curved_surface_remark([Demonstration(time=time, values=circles)]) == ""


def test_quaternions_of_the_car_recordings_are_scalar_first(real_demonstration_paths):
    """The tool does not move in the flange, whose rotation the joints tell."""
    for name in ("car_rim_1", "car_rim_4", "car_fender_3"):
        if name not in real_demonstration_paths:
            pytest.skip(f"there is no recording {name}")
        arrays = np.load(real_demonstration_paths[name])
        flange = Rotation.identity(len(arrays["joints"]))
        # A KUKA LWR: the even joints bend about y, the second and sixth backwards.
        for q, sign, axis in zip(
            arrays["joints"].T, [1, -1, 1, 1, 1, -1, 1], "zyzyzyz", strict=True
        ):
            flange *= Rotation.from_rotvec(
                np.outer(sign * q, np.eye(3)["xyz".index(axis)])
            )
        errors = []
        for order in ("wxyz", "xyzw"):
            tool = flange.inv() * as_rotation(arrays["quaternion"], order=order)
            errors.append(np.degrees(np.mean((tool * tool.mean().inv()).magnitude())))
        assert errors[0] < 0.8, name
        assert errors[1] > 5, name


@pytest.mark.parametrize(
    ("name", "residual", "force", "cycles"),
    [
        ("car_rim_1", 0.002, 23, 2.5),
        ("car_rim_4", 0.008, 18, 5.5),
        ("car_fender_3", 0.005, 14, 3.3),
    ],
)
def test_real_recordings_are_placed_and_learned(
    real_demonstration_paths, name, residual, force, cycles
):
    if name not in real_demonstration_paths:
        pytest.skip(f"there is no recording {name}")
    scenario = Scenario()
    placed, remarks = load_on_board(
        [real_demonstration_paths[name]],
        scenario=scenario,
        transform=None,
        stretch=1.0,
        surface="fitted",
        extra=("orientation", "force"),
    )
    assert placed[0].channels == ("x", "y", "z", "rx", "ry", "rz", "force")
    assert scenario.board.shape == "plane"
    (fit,) = (remark for remark in remarks if "residuals in mm" in remark)
    stated = float(fit.partition("mm: plane ")[2].partition(",")[0])
    assert stated < 1e3 * residual
    values = np.concatenate([d.values for d in placed])
    touching = values[:, 2] == values[:, 2].min()
    assert np.mean(values[touching, 6]) == pytest.approx(force, abs=1)
    tilt = np.degrees(np.linalg.norm(values[touching, 3:5], axis=1))
    assert np.median(tilt) < 10
    skill = learn_skill(placed, by_position=True)
    assert skill.channels_ == placed[0].channels
    assert skill.rhythm_.cycles > cycles
