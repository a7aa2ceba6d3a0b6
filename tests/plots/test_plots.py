"""Facts about the pictures of skills and runs."""

import subprocess
import sys
from dataclasses import replace
from itertools import combinations, pairwise
from types import SimpleNamespace

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.collections import PolyCollection, QuadMesh
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from fmp_drake.errors import DemonstrationError, RunError, SkillError
from fmp_drake.plots import (
    draw_demonstrations_in_plane,
    draw_rollout_in_plane,
    draw_samples_in_plane,
    plot_demonstrations,
    plot_run,
    plot_skill,
    run_page,
    skill_page,
)
from fmp_drake.plots.demonstrations import (
    draw_demonstrations_over_time,
    draw_spectra,
    draw_windows_in_plane,
)
from fmp_drake.plots.learned import (
    density,
    draw_component_in_plane,
    draw_component_over_time,
    draw_heatmaps,
    draw_phase,
    draw_rollout_over_time,
    grid_edges,
)
from fmp_drake.plots.skill_page import draw_skill
from fmp_drake.plots.style import Channels, component_color, legend_above, series_style
from fmp_drake.primitives import (
    Demonstration,
    FourierMovementPrimitive,
    Player,
    Rhythm,
)
from fmp_drake.primitives.data.channels import ChannelRoles
from fmp_drake.primitives.model.phase.rhythm import Part
from fmp_drake.runs.events import RunEvent
from fmp_drake.station.scenario_parts import BoardConfig

SIX = ("x", "y", "z", "force", "roll", "pitch")
UNITS = ("m", "m", "m", "N", "rad", "rad")


def waves(channels, *, seconds=20.0, rate=10.0, seed=0):
    """Return a demonstration of noisy sines, its first channels of those of SIX."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(seconds * rate)) / rate
    phase = 2 * np.pi * 0.4 * time + 0.3 * np.cumsum(rng.standard_normal(len(time))) / 9
    scale = np.array([0.1, 0.2, 0.01, 5.0, 0.3, 0.4])[:channels]
    values = scale * np.sin(phase[:, None] + np.arange(channels))
    return Demonstration(
        time=time, values=values, channels=SIX[:channels], units=UNITS[:channels]
    )


def learn(demonstrations):
    return FourierMovementPrimitive(
        n_steps=24, rate=10.0, overlap=4, n_components=3, stride=3
    ).fit(demonstrations)


@pytest.fixture(scope="module")
def shown():
    """Demonstrations with 1, 2, 3 and 6 channels."""
    return {d: waves(d) for d in (1, 2, 3, 6)}


@pytest.fixture(scope="module")
def skills(shown):
    """Skill learned from them: T = 24 at 10 Hz, M = 3."""
    return {d: learn(demonstration) for d, demonstration in shown.items()}


@pytest.fixture
def two(skills, shown):
    return skills[2], shown[2]


def start_outside(skill):
    low, high = skill.extent_
    return high + 0.5 * (high - low)


def stack(count):
    """Return axes of a new figure, one below the other."""
    return list(Figure().subplots(count, 1, squeeze=False)[:, 0])


def single():
    return Figure(figsize=(3, 2)).subplots()


# Every function, as called with a skill, a demonstration and axes.
OVER_TIME = {
    "demonstrations": lambda _, d, axes: draw_demonstrations_over_time(d, axes),
    "spectra": draw_spectra,
    "component": lambda s, _, axes: draw_component_over_time(s, 0, axes),
    "rollout": lambda s, _, axes: draw_rollout_over_time(
        Player(s), start_outside(s), axes, duration=5.0
    ),
}
IN_PLANE = {
    "demonstrations": lambda _, d, ax: draw_demonstrations_in_plane(d, ax=ax),
    "windows": draw_windows_in_plane,
    "samples": lambda s, d, ax: draw_samples_in_plane(s, demonstrations=d, ax=ax),
    "component": lambda s, d, ax: draw_component_in_plane(s, 0, ax, demonstrations=d),
    "rollout": lambda s, d, ax: draw_rollout_in_plane(
        Player(s), start_outside(s), duration=5.0, demonstrations=d, ax=ax
    ),
}
over_time = pytest.mark.parametrize("draw", OVER_TIME.values(), ids=OVER_TIME)
in_plane = pytest.mark.parametrize("draw", IN_PLANE.values(), ids=IN_PLANE)


def draw_over_time(draw, skill, demonstration):
    """Draw into axes of a new figure, with one more where there is a strip."""
    count = len(skill.channels_) + (draw is OVER_TIME["rollout"])
    return draw(skill, demonstration, stack(count))


EVERYTHING = [
    *(
        pytest.param(
            lambda s, d, draw=draw: draw_over_time(draw, s, d), id=f"{name} over time"
        )
        for name, draw in OVER_TIME.items()
    ),
    *(
        pytest.param(lambda s, d, draw=draw: draw(s, d, single()), id=name)
        for name, draw in IN_PLANE.items()
    ),
    pytest.param(
        lambda s, d: draw_heatmaps(s, d, Figure().subplots(1, 2)), id="heatmaps"
    ),
]
everything = pytest.mark.parametrize("draw", EVERYTHING)


class TestEveryPicture:
    @pytest.mark.parametrize("channels", [1, 6])
    @over_time
    def test_over_time_draws_each_channel_into_its_axes(
        self, draw, channels, skills, shown
    ):
        axes = draw_over_time(draw, skills[channels], shown[channels])
        assert len(axes) == channels + (draw is OVER_TIME["rollout"])
        assert all(ax.has_data() for ax in axes)
        labels = [f"{n} ({u})" for n, u in zip(SIX, UNITS, strict=True)][:channels]
        assert [ax.get_ylabel() for ax in axes[:channels]] == labels
        assert axes[-1].get_xlabel().endswith(("(s)", "(Hz)"))
        assert axes[0].get_title(loc="left")
        axes[0].figure.canvas.draw()

    @pytest.mark.parametrize("channels", [2, 6])
    @in_plane
    def test_in_plane_x_is_up_and_y_to_the_left(self, draw, channels, skills, shown):
        ax = single()
        assert draw(skills[channels], shown[channels], ax) is ax
        assert ax.has_data()
        assert tuple(ax.figure.get_size_inches()) == (3, 2)
        assert (ax.get_ylabel(), ax.get_xlabel()) == ("x (m)", "y (m)")
        assert ax.get_aspect() == 1.0
        assert ax.xaxis_inverted()
        assert not ax.yaxis_inverted()
        assert ax.get_title(loc="left")
        ax.figure.canvas.draw()

    @pytest.mark.parametrize("name", ["demonstrations", "samples", "rollout"])
    def test_public_pictures_make_a_figure_of_their_own(self, name, two):
        ax = IN_PLANE[name](*two, None)
        width, height = ax.figure.get_size_inches()
        assert 1.0 < height < 1.6 * width

    @in_plane
    def test_channels_of_different_units_are_not_drawn_to_one_scale(self, draw):
        recording = waves(6).select(["x", "force"])
        ax = draw(learn(recording), recording, single())
        assert ax.get_aspect() == "auto"
        assert ax.get_xlabel() == "force (N)"
        ax.figure.canvas.draw()

    @everything
    def test_the_skill_and_the_demonstration_stay_as_they_are(self, draw, two):
        skill, demonstration = two

        def numbers():
            arrays = [demonstration.time, demonstration.values]
            arrays += [skill.proportions_, skill.extent_]
            for c in skill.components_:
                arrays += [c.mean, c.basis, c.variances, np.array(c.noise)]
            return [np.array(a) for a in arrays], skill.get_params()

        arrays, parameters = numbers()
        components = skill.components_
        draw(skill, demonstration)
        for before, after in zip(arrays, numbers()[0], strict=True):
            np.testing.assert_array_equal(before, after)
        assert skill.components_ is components
        assert skill.get_params() == parameters

    @everything
    def test_pyplot_is_not_touched(self, draw, two):
        mine = plt.figure()
        current = plt.gca()
        settings = dict(plt.rcParams)
        try:
            draw(*two)
            assert plt.get_fignums() == [mine.number]
            assert plt.gca() is current
            assert not current.has_data()
            assert dict(plt.rcParams) == settings
        finally:
            plt.close(mine)

    @in_plane
    def test_one_channel_has_no_plane(self, draw, skills, shown):
        with pytest.raises(RunError, match=r"only the channel x; .* needs two"):
            draw(skills[1], shown[1], single())

    @pytest.mark.parametrize("name", ["samples", "component", "windows", "rollout"])
    def test_a_demonstration_of_other_channels_is_an_error(self, name, skills, shown):
        with pytest.raises(RunError, match=r"channels x, y, z; .* have x, y"):
            IN_PLANE[name](skills[2], shown[3], single())


class TestDemonstrations:
    @pytest.mark.parametrize("axis", [0, 1])
    def test_labels_of_a_narrow_path_do_not_overlap(self, axis):
        values = np.zeros((200, 2))
        values[:, axis] = np.linspace(-0.2, 0.2, 200)
        narrow = Demonstration(time=np.arange(200) / 20, values=values)
        ax = draw_demonstrations_in_plane(narrow)
        ax.figure.draw_without_rendering()
        low, high = np.sort(ax.get_xlim())
        boxes = [
            label.get_window_extent()
            for label, at in zip(ax.get_xticklabels(), ax.get_xticks(), strict=True)
            if low <= at <= high
        ]
        boxes.sort(key=lambda box: box.x0)
        assert len(boxes) > 1
        assert all(a.x1 < b.x0 for a, b in pairwise(boxes))

    @pytest.mark.parametrize(("count", "named"), [(1, []), (3, [1, 2, 3]), (6, [1, 6])])
    def test_the_shades_of_several_recordings_are_named(self, count, named):
        axes = stack(2)
        draw_demonstrations_over_time([waves(2, seed=i) for i in range(count)], axes)
        legend = axes[0].get_legend()
        texts = [text.get_text() for text in legend.get_texts()] if legend else []
        assert texts == [f"recording {n}" for n in named]

    def test_labels_of_axes_below_each_other_are_aligned(self):
        recording = waves(2)
        values = recording.values * [100.0, 1e-2]  # The second has longer numbers.
        axes = draw_demonstrations_over_time(
            replace(recording, values=values), stack(2)
        )
        axes[0].figure.draw_without_rendering()
        left, other = (ax.yaxis.label.get_window_extent().x0 for ax in axes)
        assert left == pytest.approx(other, abs=1.0)

    def test_every_recording_is_a_line(self):
        recordings = [waves(2, seed=i) for i in range(3)]
        for ax, i in zip(
            draw_demonstrations_over_time(recordings, stack(2)), (0, 1), strict=True
        ):
            for line, recording in zip(ax.lines, recordings, strict=True):
                np.testing.assert_array_equal(line.get_xdata(), recording.time)
                np.testing.assert_array_equal(line.get_ydata(), recording.values[:, i])
        ax = draw_demonstrations_in_plane(recordings)
        for line, recording in zip(ax.lines, recordings, strict=True):
            np.testing.assert_array_equal(line.get_ydata(), recording.values[:, 0])
            np.testing.assert_array_equal(line.get_xdata(), recording.values[:, 1])
        assert len({line.get_color() for line in ax.lines}) == 3
        assert "3 recordings, 60 s" in ax.get_title(loc="left")

    @pytest.mark.parametrize(("channels", "titled"), [(1, 1), (2, 2)])
    def test_a_plane_is_written_where_there_are_two_channels(
        self, channels, titled, shown, tmp_path
    ):
        path = tmp_path / "shown.svg"
        plot_demonstrations(shown[channels], path)
        text = path.read_text()
        assert text.count("<!-- demonstrated: 20 s -->") == 1
        assert text.count("<!-- in the plane -->") == titled - 1

    def test_cycles_and_omitted_parts_of_one_recording_are_marked(
        self, shown, tmp_path
    ):
        approach = Part(recording=0, start=0.0, end=2.0, kind="approach")
        bout = Part(
            recording=0, start=2.0, end=20.0, kind="bout", cycle_ends=(8.0, 14.0)
        )
        rhythm = Rhythm(period=6.0, cycles=3.0, bouts=(bout,), left_out=(approach,))
        path = tmp_path / "shown.svg"
        plain = tmp_path / "plain.svg"
        plot_demonstrations(shown[2], path, rhythm=rhythm)
        plot_demonstrations(shown[2], plain)
        text = path.read_text()
        assert text.count("<!-- approach -->") == 1
        # Three lines and an area for each of two channels, and glyphs.
        marks = text.count("<path") - plain.read_text().count("<path")
        assert marks >= 2 * (3 + 1)

    @pytest.mark.parametrize(
        "draw",
        [
            draw_demonstrations_in_plane,
            lambda d: draw_demonstrations_over_time(d, stack(2)),
        ],
    )
    def test_none_or_unlike_recordings_are_an_error(self, draw, shown):
        with pytest.raises(RunError, match="no demonstration"):
            draw([])
        with pytest.raises(RunError, match="demonstration 2 has the channels"):
            draw([shown[2], shown[3]])


class TestWindows:
    def test_every_window_is_a_line(self, two):
        skill, demonstration = two
        ax = draw_windows_in_plane(skill, demonstration, single())
        assert len(ax.lines) == skill.n_windows_
        for k, line in enumerate(ax.lines):
            first = k * skill.stride
            window = demonstration.values[first : first + skill.n_steps]
            np.testing.assert_allclose(line.get_xydata(), window[:, ::-1])

    def test_a_window_has_the_colour_of_its_most_probable_component(self, skills):
        # Windows near to the mean of a component belong to it.
        skill = skills[2]
        for j, component in enumerate(skill.components_):
            window = skill.synthesize(component.mean)
            one = Demonstration(time=np.arange(24) / 10, values=window)
            (line,) = draw_windows_in_plane(skill, one, single()).lines
            assert line.get_color() == component_color(j)

    def test_many_windows_are_thinned_and_the_title_states_it(self, skills):
        ax = draw_windows_in_plane(skills[2], waves(2, seconds=30.0), single())
        assert len(ax.lines) == 60
        assert "60 of 93 windows" in ax.get_title(loc="left")

    def test_a_recording_shorter_than_a_window_is_an_error(self, two):
        with pytest.raises(DemonstrationError, match="give no windows"):
            draw_windows_in_plane(two[0], waves(2, seconds=2.0), single())


class TestSpectra:
    def test_points_are_the_amplitudes_of_the_sines(self):
        # Two whole periods and five in a window of 2.4 s.
        time = np.arange(120) / 10
        values = np.column_stack(
            [
                3 + 0.1 * np.sin(2 * np.pi * 2 / 2.4 * time),
                0.02 * np.cos(2 * np.pi * 5 / 2.4 * time + 1),
            ]
        )
        steady = Demonstration(time=time, values=values)
        axes = draw_spectra(learn(steady), steady, stack(2))
        for ax, k, amplitude in zip(axes, (2, 5), (0.1, 0.02), strict=True):
            frequency, height = ax.lines[0].get_data()
            np.testing.assert_allclose(frequency, np.arange(1, 13) / 2.4)
            expected = np.where(np.arange(1, 13) == k, amplitude, 0)
            np.testing.assert_allclose(height, expected, atol=1e-9)

    def test_the_nyquist_harmonic_is_an_amplitude_too(self):
        time = np.arange(100) / 10
        values = 0.1 * (-1.0) ** np.arange(100)
        values = np.column_stack([values, np.sin(time)])
        steady = Demonstration(time=time, values=values)
        ax, _ = draw_spectra(learn(steady), steady, stack(2))
        frequency, height = ax.lines[0].get_data()
        assert frequency[-1] == pytest.approx(5.0)
        assert height[-1] == pytest.approx(0.1)

    def test_rounding_of_a_constant_channel_is_not_drawn_as_harmonics(self):
        time = np.arange(120) / 10
        rounding = 1e-17 * (-1.0) ** np.arange(120)
        values = np.column_stack([np.sin(2 * np.pi * 2 / 2.4 * time), rounding])
        steady = Demonstration(time=time, values=values)
        axes = draw_spectra(learn(steady), steady, stack(2))
        assert len(axes[0].lines[0].get_xdata()) == 12
        assert axes[1].get_ylim() == (0, 1e-9)

    def test_bars_hold_nine_of_ten_windows(self, two):
        skill, demonstration = two
        ax = draw_spectra(skill, demonstration, stack(2))[0]
        (bars,) = ax.collections
        heights = np.array([bar[:, 1] for bar in bars.get_segments()])
        middle = ax.lines[0].get_ydata()
        assert np.all((heights[:, 0] <= middle) & (middle <= heights[:, 1]))
        windows = np.stack(
            [
                demonstration.values[i : i + 24, 0]
                for i in range(0, len(demonstration.values) - 23, 3)
            ]
        )
        amplitude = np.abs(np.fft.rfft(windows))[:, 1] * 2 / 24
        np.testing.assert_allclose(heights[0], np.percentile(amplitude, [5, 95]))


class TestLearned:
    def test_samples_are_those_of_the_skill(self, two):
        skill, demonstration = two
        ax = draw_samples_in_plane(skill, n=5, seed=3, demonstrations=demonstration)
        grey, *lines = ax.lines
        np.testing.assert_array_equal(grey.get_ydata(), demonstration.values[:, 0])
        samples = skill.sample(5, seed=3, with_noise=False)
        for line, sample in zip(lines, samples, strict=True):
            np.testing.assert_allclose(line.get_xydata(), sample[:, ::-1])
        with pytest.raises(RunError, match="n is 0"):
            draw_samples_in_plane(skill, n=0)

    @pytest.mark.parametrize("channels", [1, 3, 6])
    def test_the_band_is_two_standard_deviations(self, channels, skills):
        skill = skills[channels]
        # Of samples with their noise, which the skill draws by itself.
        gaussian = skill.components_[1]
        weights = gaussian.sample(np.random.default_rng(0), 4000)
        samples = skill.synthesize(weights)
        for i, ax in enumerate(draw_component_over_time(skill, 1, stack(channels))):
            mean = ax.lines[0].get_ydata()
            np.testing.assert_allclose(mean, skill.synthesize(gaussian.mean)[:, i])
            (band,) = ax.collections
            edge = band.get_paths()[0].vertices
            for t in (0, 11, 23):
                at = np.isclose(edge[:, 0], t / 10)
                width = np.ptp(edge[at, 1])
                assert width == pytest.approx(4 * samples[:, t, i].std(), rel=0.06)
            assert to_rgb(ax.lines[0].get_color()) == to_rgb(component_color(1))

    @pytest.mark.parametrize("plane", [("x", "y"), ("x", "force")])
    def test_an_ellipse_holds_its_fraction_of_the_component(self, plane):
        skill = learn(waves(6).select(plane))
        ax = draw_component_in_plane(skill, 0, single())
        tube, outlines = ax.collections
        assert isinstance(tube, PolyCollection)
        assert len(tube.get_paths()) == skill.n_steps - 1
        assert len(outlines.get_paths()) == 12
        weights = skill.components_[0].sample(np.random.default_rng(1), 4000)
        samples = skill.synthesize(weights)[:, :, [1, 0]]
        for k, t in enumerate(range(0, 24, 2)):
            inside = outlines.get_paths()[k].contains_points(samples[:, t])
            assert inside.mean() == pytest.approx(0.95, abs=0.03)
            # The tube contains the ellipses of both of its ends.
            for end in (t, t + 1):
                part = tube.get_paths()[t].contains_points(samples[:, end])
                assert part.mean() >= 0.92
        np.testing.assert_allclose(
            ax.lines[0].get_xydata(),
            skill.synthesize(skill.components_[0].mean)[:, [1, 0]],
        )


class TestHeatmaps:
    def test_the_density_of_all_positions_is_one(self, two):
        recording = two[1]
        edges = grid_edges(recording.values, square=True)
        cells = [np.diff(edge) for edge in edges]
        assert cells[0][0] == pytest.approx(cells[1][0])
        values = density([recording.values], [np.diff(recording.time)], edges)
        area = cells[0][0] * cells[1][0]
        assert np.sum(values) * area == pytest.approx(1.0)

    def test_density_counts_time_not_samples(self):
        # One second at x = 0 and three at x = 1, recorded ten times as often at 0.
        time = np.concatenate([np.linspace(0, 0.99, 100), 1 + np.linspace(0, 3, 31)])
        x = (time >= 1).astype(float)
        edges = [np.array([-0.5, 0.5, 1.5]), np.array([-1.0, 0.0, 1.0])]
        values = density([np.column_stack([x, 0.1 * x])], [np.diff(time)], edges)
        here, there = values.sum(axis=1)
        assert there / here == pytest.approx(3.0, rel=0.05)

    def test_a_visited_place_is_drawn_where_it_is(self, skills):
        time = np.arange(50) / 10
        still = np.column_stack([np.full(50, 0.35), np.full(50, -0.15)])
        recording = Demonstration(time=time, values=still)
        ax, other = Figure().subplots(1, 2)
        draw_heatmaps(skills[2], recording, [ax, other])
        mesh = ax.collections[0]
        ((row, column),) = np.argwhere(mesh.get_array().filled(0) > 0)
        (x0, y0), (x1, y1) = (
            mesh.get_coordinates()[row, column],
            mesh.get_coordinates()[row + 1, column + 1],
        )
        assert x0 <= -0.15 <= x1
        assert y0 <= 0.35 <= y1

    def test_cells_of_different_units_are_as_many_both_ways(self):
        recording = waves(6).select(["x", "force"])
        axes = Figure().subplots(1, 2)
        draw_heatmaps(learn(recording), recording, axes)
        assert axes[0].collections[0].get_array().shape == (60, 60)
        assert axes[1].child_axes[0].get_ylabel() == "density (1/(m N))"

    def test_both_heatmaps_can_be_compared(self, two):
        axes = Figure().subplots(1, 2)
        draw_heatmaps(*two, axes)
        a, b = (ax.collections[0] for ax in axes)
        assert isinstance(a, QuadMesh)
        np.testing.assert_array_equal(a.get_coordinates(), b.get_coordinates())
        assert a.get_clim() == b.get_clim()
        ends = [np.percentile(m.get_array().compressed(), 99) for m in (a, b)]
        assert a.get_clim() == (0, pytest.approx(max(ends)))
        assert axes[1].child_axes[0].get_ylabel() == "density (1/m²)"
        for ax in axes:
            assert (ax.get_ylabel(), ax.get_xlabel()) == ("x (m)", "y (m)")

    def test_no_demonstration_is_an_error(self, two):
        with pytest.raises(RunError, match="no demonstration"):
            draw_heatmaps(two[0], [], Figure().subplots(1, 2))


class TestPlayed:
    def test_a_rollout_in_the_plane_is_that_of_the_player_coloured_by_time(self, two):
        skill, _ = two
        player, start = Player(skill), start_outside(skill)
        ax = draw_rollout_in_plane(player, start, duration=4.0)
        (lines,) = ax.collections
        path_values = player.rollout(start, 4.0)[:, 0, ::-1]
        segments = np.array(lines.get_segments())
        np.testing.assert_allclose(segments[:, 0], path_values[:-1])
        np.testing.assert_allclose(segments[:, 1], path_values[1:])
        np.testing.assert_allclose(lines.get_array(), np.arange(40) / 10)
        assert lines.get_clim() == (0, 4.0)
        (ring,) = ax.lines
        np.testing.assert_allclose(ring.get_xydata(), [start[::-1]])
        assert ax.child_axes[0].get_ylabel() == "time (s)"

    def test_several_starts_are_drawn_at_once(self, two):
        skill, _ = two
        starts = start_outside(skill) * np.array([[1.0], [-1.0], [0.5]])
        ax = draw_rollout_in_plane(Player(skill), starts, duration=2.0)
        assert len(ax.collections[0].get_segments()) == 3 * 20
        np.testing.assert_allclose(ax.lines[0].get_xydata(), starts[:, ::-1])

    @pytest.mark.parametrize("sample", [False, True])
    def test_a_rollout_over_time_is_that_of_the_player(self, sample, skills):
        skill = skills[3]
        player = Player(skill, sample=sample, seed=4)
        start = start_outside(skill)
        *axes, _ = draw_rollout_over_time(player, start, stack(4), duration=9.0)
        path_values = player.rollout(start, 9.0)[:, 0]
        for i, ax in enumerate(axes):
            time, value = ax.lines[0].get_data()
            np.testing.assert_allclose(time, np.arange(91) / 10)
            np.testing.assert_allclose(value, path_values[:, i], atol=1e-9)

    def test_remap_instants_and_components_are_those_of_the_player(self, two):
        skill, _ = two
        player, start = Player(skill), start_outside(skill)
        ax, _, strip = draw_rollout_over_time(player, start, stack(3), duration=9.0)
        # Every T - K = 20 ticks of 0.1 s.
        instants = [line.get_xdata()[0] for line in ax.lines[1:]]
        np.testing.assert_allclose(instants, [2.0, 4.0, 6.0, 8.0])
        boxes = [p for p in strip.patches if isinstance(p, Rectangle)]
        np.testing.assert_allclose([b.get_x() for b in boxes], [0, 2, 4, 6, 8])
        np.testing.assert_allclose([b.get_width() for b in boxes], [2, 2, 2, 2, 1])
        state, components = player.start(start), []
        for _ in range(5):
            components.append(state.component)
            remaps = state.remaps
            while state.remaps == remaps:
                state = player.advance(state, player.tick_seconds)
        assert [text.get_text() for text in strip.texts] == [str(j) for j in components]
        for box, component in zip(boxes, components, strict=True):
            assert to_rgb(box.get_facecolor()[:3]) == to_rgb(component_color(component))

    def test_the_band_is_that_of_the_tracked_component(self, two):
        skill, _ = two
        player, start = Player(skill), start_outside(skill)
        ax, *_ = draw_rollout_over_time(player, start, stack(3), duration=1.0)
        edge = ax.collections[0].get_paths()[0].vertices
        width = np.ptp(edge[np.isclose(edge[:, 0], 0.0), 1])
        variance = player.covariance(player.start(start))[0, 0]
        assert width == pytest.approx(4 * np.sqrt(variance))

    def test_bad_starts_and_durations_are_errors(self, two):
        player = Player(two[0])

        def over_time(player, start, **duration):
            draw_rollout_over_time(player, start, stack(3), **duration)

        for draw in (draw_rollout_in_plane, over_time):
            with pytest.raises(SkillError):
                draw(player, [0.0, 0.0, 0.0])
            with pytest.raises(SkillError):
                draw(player, [np.nan, 0.0])
            for duration in (0.0, -1.0, np.inf, np.nan):
                with pytest.raises(RunError, match="duration is"):
                    draw(player, [0.0, 0.0], duration=duration)


class TestPhase:
    def drawn(self, demonstration):
        """Return a phase model of a demonstration, and its three pictures."""
        skill = FourierMovementPrimitive(
            model="phase", n_steps=24, rate=10.0, overlap=4
        ).fit(demonstration)
        axes = Figure().subplots(1, 3)
        draw_phase(skill, axes)
        return skill, axes

    def test_a_mixture_has_no_phase(self, shown):
        mixture = FourierMovementPrimitive(
            model="mixture", n_steps=24, rate=10.0, overlap=4, n_components=2
        ).fit(shown[1])
        with pytest.raises(RunError, match="no phase model: it was requested"):
            draw_phase(mixture, Figure().subplots(1, 3))

    def test_the_cycle_of_one_channel_is_drawn_over_its_phase(self, shown):
        _, (cycle, _, spread) = self.drawn(shown[1])
        assert cycle.get_xlabel() == spread.get_xlabel() == "phase (rad)"
        assert cycle.get_ylabel() == "x (m)"
        (line,) = cycle.lines
        phase, value = line.get_data()
        assert np.ptp(phase) == pytest.approx(2 * np.pi)
        assert value[0] == pytest.approx(value[-1])
        assert np.ptp(value) == pytest.approx(0.2, rel=0.1)

    def test_residuals_of_several_units_are_in_percent_of_their_range(self, shown):
        skill, (*_, spread) = self.drawn(shown[6])
        assert spread.get_ylabel() == "standard deviation (% of the range)"
        # Of channels with one unit that of the largest range counts.
        ranges = np.ptp(skill.extent_, axis=0)
        assert ranges[1] > 10 * ranges[2]
        factor = (
            skill.phase_model_.residual.factor(np.zeros(1)) * skill.scales_[:, None]
        )
        for i, largest in ((1, 1), (2, 1), (3, 3)):
            drawn = spread.lines[i].get_ydata()[0]
            expected = 100 * np.linalg.norm(factor[0, i]) / ranges[largest]
            assert drawn == pytest.approx(expected)


def test_names_of_channels_are_short_and_no_formulas():
    names = ("x", "_y", "left/gripper/force_0", "a$b_{$")
    channels = Channels(names, ("m", "1", "N", "m"))
    assert channels.short_names == ["x", " _y", "…per/force_0", r"a\$b_{\$"]
    assert channels.labels[:3] == ["x (m)", " _y", "…per/force_0 (N)"]
    ax = single()
    for name in channels.short_names:
        ax.plot([0, 1], label=name)
    legend_above(ax)
    ax.figure.canvas.draw()
    assert len(ax.get_legend().get_texts()) == len(names)


class TestPages:
    @pytest.mark.parametrize(("channels", "count"), [(1, 4), (2, 8), (3, 8), (6, 8)])
    def test_the_page_of_a_skill_shows_everything(self, channels, count, skills, shown):
        figure = draw_skill(skills[channels], shown[channels])
        titled = [ax for ax in figure.axes if ax.get_title(loc="left")]
        spectra_and_rollout = 2 if channels > 1 else 0
        assert len(titled) == count + spectra_and_rollout

    def test_page_of_a_skill_is_read_at_800_pixels(self, two):
        figure = draw_skill(*two)
        figure.draw_without_rendering()
        # A letter of 10 points is 9 pixels high.
        assert 800 / figure.get_figwidth() * 10 / 72 > 9
        above = [
            text.get_window_extent()
            for ax in figure.axes
            for text in (
                ax._left_title,
                *(ax.get_legend().get_texts() if ax.get_legend() else ()),
            )
            if text.get_text()
        ]
        assert not any(a.overlaps(b) for a, b in combinations(above, 2))
        for ax in figure.axes:
            if ax.get_aspect() == 1.0:
                low, high = np.sort(ax.get_ylim())
                ticks = ax.get_yticks()
                assert np.sum((low <= ticks) & (ticks <= high)) > 1

    def test_an_approach_from_afar_does_not_widen_the_pictures_of_what_was_learned(
        self,
    ):
        time = np.arange(0, 34, 0.05)
        phase = 2 * np.pi * np.maximum(time - 6, 0) / 2.2
        near = np.clip((time - 1) / 5, 0, 1)
        path = 0.1 * np.column_stack([np.cos(phase), np.sin(phase)])
        path[:, 0] += 0.9 * (1 - 3 * near**2 + 2 * near**3)
        recording = Demonstration(time=time, values=path)
        skill = FourierMovementPrimitive(window=6.0).fit(recording)
        figure = draw_skill(skill, recording)
        tops = [ax.get_ylim()[1] for ax in figure.axes if ax.get_xlabel()[:1] == "y"]
        # Only the picture of the recordings shows the approach.
        assert len(tops) == 9
        assert sum(top > 0.4 for top in tops) == 1

    def test_wide_tubes_do_not_make_the_learned_paths_small(self):
        time = np.arange(0, 9.6, 0.05)
        phase = 2 * np.pi * time / 4.8 + 0.1 * np.sin(time)
        path = 0.07 * np.column_stack([np.sin(phase), np.sin(4 * phase)])
        path += np.random.default_rng(0).normal(scale=5e-4, size=path.shape)
        recording = Demonstration(time=time, values=path)
        skill = FourierMovementPrimitive(model="phase").fit(recording)
        figure = draw_skill(skill, recording)
        in_plane = [ax for ax in figure.axes if ax.get_xlabel()[:1] == "y"]
        widths = [float(np.ptp(ax.get_xlim())) for ax in in_plane]
        # Demonstrations, samples and two pictures of what is visited.
        assert max(np.abs(widths[:4])) < 0.3
        assert max(np.abs(widths)) > 0.5

    def test_a_skill_of_one_component_leaves_places_empty(self, shown):
        skill = FourierMovementPrimitive(
            n_steps=24, rate=10.0, overlap=4, n_components=1, stride=3
        ).fit(shown[2])
        figure = draw_skill(skill, shown[2])
        titles = [ax.get_title(loc="left") for ax in figure.axes]
        assert sum(title.startswith("component") for title in titles) == 1

    @pytest.mark.parametrize("ending", ["png", "pdf", "svg"])
    def test_a_page_is_written_by_its_ending(self, ending, two, tmp_path):
        path = tmp_path / f"page.{ending}"
        plot_skill(*two, str(path))
        start = {"png": b"\x89PNG", "pdf": b"%PDF", "svg": b"<?xml"}[ending]
        assert path.read_bytes().startswith(start)
        assert path.stat().st_size < 3_000_000

    def test_a_page_that_cannot_be_written_is_an_error(self, two, tmp_path):
        for path in (tmp_path / "page.xyz", tmp_path / "no" / "page.png"):
            with pytest.raises(RunError, match="cannot write"):
                plot_skill(*two, path)

    def test_the_page_of_a_run_shows_path_ink_force_and_error(self, skills, tmp_path):
        run = fake_run(skills[3])
        path, ink, _, force, error = run_axes(run)
        np.testing.assert_allclose(
            path.lines[-1].get_xydata(),
            run.log("measured_position")[::4, [1, 0]],
        )
        # The wiped corner has the least x and the greatest y: below, at the left.
        mesh = ink.collections[0]
        ((row, column),) = np.argwhere(mesh.get_array() == 0)
        x, y = mesh.get_coordinates()[row, column]
        assert y == pytest.approx(-0.2)
        assert x == pytest.approx(0.3 - 0.6 / 12)
        # Both show the board, as it is seen from behind the robot.
        for ax in (path, ink):
            assert ax.get_xlim() == (0.3, -0.3)
            assert ax.get_ylim() == (-0.2, 0.2)
        assert force.get_ylabel() == "normal force (N)"
        np.testing.assert_allclose(force.lines[0].get_ydata(), 10.0)
        band = force.patches[0]
        low, high = band.get_y(), band.get_y() + band.get_height()
        assert (low, high) == (5.0, 15.0)
        assert error.get_ylabel() == "error (mm)"
        assert [line.get_label() for line in error.lines[:3]] == ["x", "y", "z"]
        np.testing.assert_allclose(error.lines[2].get_ydata(), 2.0)
        assert (path.get_xlabel(), ink.get_ylabel()) == ("y (m)", "x (m)")
        plot_run(run, tmp_path / "run.png")
        assert (tmp_path / "run.png").read_bytes().startswith(b"\x89PNG")

    def test_the_page_of_a_run_that_has_not_started_is_refused(self, skills, tmp_path):
        run = fake_run(skills[3], measured_position=np.zeros((0, 3)))
        run.log_times = lambda name: np.zeros(len(run.log(name)))
        with pytest.raises(RunError, match=r"not started; call its advance_to first"):
            plot_run(run, tmp_path / "run.png")
        assert not list(tmp_path.iterdir())

    def test_the_page_of_a_run_on_a_curved_board_names_u_v_and_h(self, skills):
        run = fake_run(skills[3], board=BoardConfig(shape="dome"))
        path, ink, *_, error = run_axes(run)
        for ax in (path, ink):
            assert (ax.get_xlabel(), ax.get_ylabel()) == ("v (m)", "u (m)")
        assert [line.get_label() for line in error.lines[:3]] == ["u", "v", "h"]

    def test_titles_and_legends_of_a_narrow_board_do_not_overlap(self, skills):
        run = fake_run(skills[3])
        run.grid.size = (0.4, 0.2)
        figure = run_page.draw_run(run)
        figure.draw_without_rendering()
        for ax in figure.axes[:2]:
            # The title has a second line for the legend.
            title = ax._left_title.get_window_extent()
            names = [t.get_window_extent() for t in ax.get_legend().get_texts()]
            assert max(name.y1 for name in names) < (title.y0 + title.y1) / 2

    def test_the_page_of_a_run_shows_when_the_board_got_clean(self, skills):
        run = fake_run(skills[3], clean=np.arange(10) / 10)
        cleaned = run_axes(run)[2]
        board, demonstrated, *marks = cleaned.lines
        np.testing.assert_allclose(board.get_ydata(), 25.0)
        np.testing.assert_allclose(
            demonstrated.get_ydata(), 100 * run.cleaned_by(demonstrated.get_xdata())
        )
        # Half of them at 0.5 s; never 90 %.
        dots = [mark for mark in marks if mark.get_marker() == "o"]
        assert len(dots) == 1
        np.testing.assert_allclose(dots[0].get_xydata(), [[0.5, 50.0]], atol=0.02)
        assert [text.get_text() for text in cleaned.texts] == ["50 % after 0.5 s"]
        assert "83.3 %" in cleaned.get_title(loc="left")

    @pytest.mark.parametrize("covers", [False, True])
    def test_a_demonstrated_area_without_an_outline_has_no_legend(self, covers, skills):
        run = fake_run(skills[3])
        run.demonstrated_area[:] = covers
        assert run_axes(run)[1].get_legend() is None

    def test_the_page_of_a_run_marks_re_mappings_and_disturbances(self, skills):
        time = np.linspace(0, 2, 200)
        run = fake_run(
            skills[3],
            remaps=np.column_stack([1.0 * (time > 0.5) + (time > 1.5), time > 1.5]),
            disturbance=np.column_stack(
                [0 * time, 30.0 * (abs(time - 1) < 0.2), time * 0]
            ),
        )
        for ax in run_axes(run)[2:]:
            marks = {
                line.get_linestyle(): line.get_xdata()[0]
                for line in ax.lines
                if line.get_linestyle() in (":", "--")
            }
            assert marks == {
                ":": pytest.approx(0.5, abs=0.02),
                "--": pytest.approx(1.5, abs=0.02),
            }
            (disturbed,) = ax.collections[-1].get_paths()
            start, end = disturbed.vertices[:, 0].min(), disturbed.vertices[:, 0].max()
            assert start == pytest.approx(0.8, abs=0.02)
            assert end == pytest.approx(1.2, abs=0.02)
        # Where nothing was pushed nothing is shaded.
        calm = fake_run(skills[3], disturbance=np.zeros((200, 3)))
        shaded = len(run_axes(fake_run(skills[3]))[-1].collections)
        assert len(run_axes(calm)[-1].collections) == shaded
        # Without them there is nothing to mark.
        for ax in run_axes(fake_run(skills[3]))[2:]:
            assert all(
                line.get_linestyle() == "-"
                for line in ax.lines
                if len(line.get_xdata()) > 1
            )

    def test_page_of_a_run_lists_its_events(self, skills):
        text = "contact lost from 0.5 to 0.9 s"
        run = fake_run(skills[3], events=[RunEvent(0.5, 0.9, "contact lost", text)])
        assert run_page.draw_run(run).get_suptitle() == text
        *others, last = run_axes(run)[2:]
        (shaded,) = (p for p in last.patches if p.get_label() == "contact lost")
        assert shaded.get_extents().width > 0
        # The other axes shade it without a name, which would not fit beside their titles.
        for ax in others:
            assert shaded.get_facecolor() in [p.get_facecolor() for p in ax.patches]
            assert "contact lost" not in [p.get_label() for p in ax.patches]
        assert run_page.draw_run(fake_run(skills[3])).get_suptitle() == ""

    def test_kinds_of_events_have_colours_of_their_own(self, skills):
        events = [
            RunEvent(0.5, 0.9, kind, kind)
            for kind in ("contact lost", "protective stop")
        ]
        ax = run_axes(fake_run(skills[3], events=events))[-1]
        colors = {p.get_facecolor() for p in ax.patches if p.get_label()[0] != "_"}
        assert len(colors) == 2


@pytest.mark.parametrize(
    ("shape", "labels"), [("plane", ("y (m)", "x (m)")), ("bowl", ("v (m)", "u (m)"))]
)
def test_the_picture_of_the_reach_names_the_coordinates(shape, labels, monkeypatch):
    figures = []
    monkeypatch.setattr(skill_page, "save", lambda figure, _: figures.append(figure))
    cells = np.linspace(0, 1, 4)
    feasibility = SimpleNamespace(
        cells=(cells, cells, np.ones((4, 4))),
        scenario=f"board: {{shape: {shape}}}",
        paths=np.zeros((1, 2, 3)),
        followed=np.ones((1, 2), dtype=bool),
        start=np.zeros(3),
        verdict="The arm can follow this skill.",
    )
    skill_page.plot_reach(feasibility, "reach.png")
    ax = figures[0].axes[0]
    assert (ax.get_xlabel(), ax.get_ylabel()) == labels


def test_lines_in_one_picture_differ_in_colour_or_style():
    styles = [tuple(series_style(number).values()) for number in range(20)]
    assert len(set(styles)) == 20
    # The second and third colour look the same to a deuteranope.
    assert len({line for _, line in styles[:4]}) == 4


def run_axes(run):
    """Return the axes of a run's page: path, ink, cleaned, force, error."""
    return [ax for ax in run_page.draw_run(run).axes if ax.get_title(loc="left")]


def fake_run(skill, *, clean=(), events=(), board=None, **more):
    """Return what a page needs of a `WipingRun`: a board of 0.4 m by 0.6 m.

    The demonstrated area are the first 12 cells, and `clean` says when the first of
    them got clean.
    """
    time = np.arange(2000) / 1000
    measured = np.column_stack([0.1 * np.sin(time), 0.2 * np.cos(time), 0 * time])
    logs = {
        "measured_position": measured,
        "desired_position": measured - [0.0, 0.0, 0.002],
        "normal_force": np.full((200, 1), 10.0),
        "cleaned_fraction": np.full((200, 1), 0.25),
        "remaps": np.zeros((200, 2)),
        **more,
    }
    ink = np.ones((12, 8))
    ink[-1, 0] = 0.0
    area = np.arange(ink.size).reshape(ink.shape) < 12
    return SimpleNamespace(
        skill=skill,
        scenario=SimpleNamespace(board=board or BoardConfig()),
        grid=SimpleNamespace(size=(0.4, 0.6), shape=ink.shape),
        demonstrated=[measured],
        kept=set(logs),
        log=logs.__getitem__,
        log_times=lambda name: np.linspace(0, 2, len(logs[name])),
        ink=lambda: ink,
        cleaned_by=lambda times: (
            np.searchsorted(clean, np.asarray(times) + 1e-9, side="right") / 12
        ),
        events=lambda: list(events),
        desired_force=lambda: np.full(len(logs["normal_force"]), 10.0),
        demonstrated_area=area,
        roles=ChannelRoles(position=(0, 1, 2)),
    )


def test_pictures_need_no_drake():
    code = """
import sys
sys.modules["pydrake"] = None
import fmp_drake.plots
assert "matplotlib.pyplot" not in sys.modules
"""
    subprocess.run([sys.executable, "-c", code], check=True)
