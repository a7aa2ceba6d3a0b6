"""Facts about films, on a board of 0.5 m by 0.7 m under a box."""

import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from films import read_film
from PIL import Image, ImageSequence
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from fmp_drake.errors import FmpError, RunError
from fmp_drake.film import (
    FilmReel,
    check_film,
    film_run,
    render,
    render_picture,
    scene,
)
from fmp_drake.film.render import render_film
from fmp_drake.film.scene import FilmScene, draw_caption, paint_ink, paint_trail
from fmp_drake.station.scenario_parts import CameraConfig
from fmp_drake.systems.ink.grid import InkGrid
from fmp_drake.systems.ink.mesh import ink_colours

GRID = InkGrid(size=(0.5, 0.7), cell=0.05)
CAMERA = CameraConfig(eye=[1.2, 0.0, 1.0], target=[0.0, 0.0, 0.0])
SIZE = (160, 120)
BOARD_AND_BOX = """
<sdf version="1.9"><model name="all">
  <link name="board">
    <visual name="slab"><pose>0 0 -0.01 0 0 0</pose>
      <geometry><box><size>0.5 0.7 0.02</size></box></geometry>
      <material><diffuse>1 1 1 1</diffuse></material></visual>
  </link>
  <frame name="surface" attached_to="board"/>
  <joint name="slides" type="prismatic">
    <parent>world</parent><child>board</child><axis><xyz>0 1 0</xyz></axis></joint>
  <link name="box">
    <visual name="box"><pose>0 0 0.05 0 0 0</pose>
      <geometry><box><size>0.1 0.1 0.1</size></box></geometry>
      <material><diffuse>0.8 0.1 0.1 1</diffuse></material></visual>
  </link>
  <joint name="carries" type="prismatic">
    <parent>world</parent><child>box</child><axis><xyz>0 1 0</xyz></axis></joint>
</model></sdf>
"""
# Positions: the board along y, then the box.
FAR_BOX = [0.0, 3.0]


@pytest.fixture
def egl():
    if not scene.renders():
        pytest.skip("films need EGL")


@pytest.fixture
def ffmpeg():
    return pytest.importorskip(
        "imageio_ffmpeg", reason="an .mp4 needs the extra fmp-drake[video]"
    )


@pytest.fixture(scope="module")
def station():
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, 0.01)
    plant.set_name("plant")
    Parser(plant).AddModelsFromString(BOARD_AND_BOX, "sdf")
    plant.mutable_gravity_field().set_gravity_vector([0.0, 0.0, 0.0])
    plant.Finalize()
    ink = builder.AddSystem(ConstantVectorSource(half_inked().ravel()))
    builder.ExportOutput(ink.get_output_port(), "ink")
    return builder.Build()


def half_inked():
    """Ink where x > 0: nearer to the camera."""
    ink = np.zeros(GRID.shape)
    ink[:, GRID.shape[1] // 2 :] = 1.0
    return ink


def shoot(station, q, *, ink=None, camera=CAMERA, size=SIZE):
    """Return a painted shot, where the board is seen, and the scene."""
    shot = FilmScene(station, camera, size).render(q)
    return shot, paint_ink(shot, GRID, bytes_of(half_inked() if ink is None else ink))


def bytes_of(ink):
    return np.rint(255 * ink).astype(np.uint8).ravel()


def blue(picture):
    """Return the pixels that are clearly blue, (height, width)."""
    r, g, b = np.moveaxis(np.asarray(picture).astype(int), -1, 0)
    return (b > r + 60) & (b > g + 40)


def pixel_of(shot, p_B):
    """Return row and column at which a point of the board is seen."""
    ((column, row),) = shot.pixels([p_B])
    return int(row), int(column)


@pytest.mark.usefixtures("egl")
class TestInk:
    def test_ink_is_blue_and_wiped_cells_are_unchanged(self, station):
        bare, _ = shoot(station, FAR_BOX, ink=np.zeros(GRID.shape))
        shot, is_board = shoot(station, FAR_BOX)
        painted = blue(shot.color)
        for x in (0.05, 0.12, 0.2):
            for y in (-0.3, 0.0, 0.3):
                assert painted[pixel_of(shot, [x, y, 0.0])]
                wiped_pixel = pixel_of(shot, [-x, y, 0.0])
                assert is_board[wiped_pixel]
                np.testing.assert_array_equal(
                    shot.color[wiped_pixel], bare.color[wiped_pixel]
                )
        assert not blue(bare.color).any()
        assert not painted[~is_board].any()

    @pytest.mark.parametrize("fraction", [0.0, 0.2, 0.5, 1.0])
    def test_colours_are_those_of_the_ink_in_the_light_of_the_board(
        self, station, fraction
    ):
        # Close to the box: some of the board is in its shadow.
        bare, _ = shoot(station, [0.0, 0.0], ink=np.zeros(GRID.shape))
        shot, is_board = shoot(station, [0.0, 0.0], ink=np.full(GRID.shape, fraction))
        assert np.ptp(bare.color[is_board].astype(int), axis=0).min() > 40
        np.testing.assert_allclose(
            shot.color[is_board],
            bare.color[is_board] * ink_colours(fraction, srgb=True),
            atol=2.0,
        )

    def test_bodies_on_the_board_hide_its_ink(self, station):
        inked = np.ones(GRID.shape)
        open_board, seen_open = shoot(station, FAR_BOX, ink=inked)
        hidden, is_board = shoot(station, [0.0, 0.0], ink=inked)
        # In the middle of the face of the box that looks at the camera.
        pixel = pixel_of(hidden, [0.05, 0.0, 0.05])
        assert seen_open[pixel]
        assert blue(open_board.color)[pixel]
        assert not is_board[pixel]
        assert not blue(hidden.color)[pixel]
        assert 0.02 < 1 - is_board.sum() / seen_open.sum() < 0.3

    def test_ink_moves_with_the_board(self, station):
        film_scene = FilmScene(station, CAMERA, SIZE)
        columns = []
        for y in (0.0, 0.1, 0.0):
            shot = film_scene.render([y, 3.0])
            paint_ink(shot, GRID, bytes_of(half_inked()))
            columns.append(np.mean(np.nonzero(blue(shot.color))[1]))
            assert blue(shot.color)[pixel_of(shot, [0.1, 0.3, 0.0])]
        # The camera looks along -x: y grows to the right.
        assert columns[1] > columns[0] + 5
        assert columns[2] == columns[0]

    def test_the_back_of_a_board_shows_no_ink(self, station):
        below = CameraConfig(eye=[1.2, 0.0, -1.0], target=[0.0, 0.0, 0.0])
        shot, is_board = shoot(station, FAR_BOX, camera=below)
        assert not is_board.any()
        assert not blue(shot.color).any()
        assert np.isfinite(shot.depth).any()

    def test_the_board_is_found_to_the_pixel(self, station):
        shot, is_board = shoot(station, FAR_BOX, size=(640, 480))
        corners = [[x, y, 0.0] for x in (-0.25, 0.25) for y in (-0.35, 0.35)]
        rows, columns = np.transpose([pixel_of(shot, corner) for corner in corners])
        board_pixels = np.nonzero(is_board)
        assert abs(board_pixels[0].min() - rows.min()) <= 1
        assert abs(board_pixels[0].max() - rows.max()) <= 1
        assert abs(board_pixels[1].min() - columns.min()) <= 1
        assert abs(board_pixels[1].max() - columns.max()) <= 1


@pytest.mark.usefixtures("egl")
def test_a_mesh_that_cannot_be_drawn_is_named(tmp_path):
    (tmp_path / "face.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (tmp_path / "arm.sdf").write_text(
        """<sdf version="1.9"><model name="arm"><link name="link"><visual name="face">
        <geometry><mesh><uri>face.obj</uri></mesh></geometry></visual></link>
        <frame name="surface" attached_to="link"/></model></sdf>"""
    )
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
    plant.set_name("plant")
    Parser(plant).AddModels(str(tmp_path / "arm.sdf"))
    plant.Finalize()
    with pytest.raises(
        RunError, match=r"cannot be drawn: .*normals.*face\.obj.*visual"
    ):
        FilmScene(builder.Build(), CAMERA, SIZE)


def test_a_caption_is_drawn_at_the_lower_left():
    picture = Image.new("RGB", (320, 240), "white")
    draw_caption(picture, "12 s\nforce 9.8 N")
    rows, columns = np.nonzero(np.asarray(picture).min(axis=2) < 100)
    assert rows.min() > 200
    assert rows.max() < 239
    assert 0 < columns.min()
    assert columns.max() < 160


def test_a_caption_fits_the_width_of_its_picture():
    picture = Image.new("RGB", (100, 76), "white")
    draw_caption(picture, "12 s, 0.1 times as fast\nforce 9.8 N (desired 5 to 15 N)")
    _, columns = np.nonzero(np.asarray(picture).min(axis=2) < 200)
    assert 70 < columns.max() < 98


def test_a_trail_is_drawn_on_the_board_only(station):
    clean = np.zeros(GRID.shape)
    points = np.column_stack(
        [np.full(50, -0.1), np.linspace(-0.6, 0.6, 50), np.zeros(50)]
    )
    before, is_board = shoot(station, [0.0, 0.0], ink=clean)
    color = before.color.copy()
    paint_trail(color, before.pixels(points), where=is_board)
    changed = np.any(color != before.color, axis=-1)
    assert changed.sum() > 50
    assert not changed[~is_board].any()
    r, g, b = color[pixel_of(before, [-0.1, 0.3, 0.0])].astype(int)
    assert r > b + 60 > g - 60


@pytest.mark.parametrize(
    "points",
    [
        [[0.0, 0.0, 0.0]],
        [[0.0, 0.0, 0.0], [2.4, 0.0, 2.0]],
        [[0.0, 9.0, 0.0], [0.0, 9.0, 0.1]],
    ],
    ids=["one point", "behind the camera", "beside the picture"],
)
@pytest.mark.usefixtures("egl")
def test_a_trail_that_is_not_seen_leaves_the_picture(points, station):
    shot = FilmScene(station, CAMERA, (64, 48)).render([0.0, 0.0])
    color = np.full((48, 64, 3), 200, dtype=np.uint8)
    where = np.ones((48, 64), dtype=bool)
    paint_trail(color, shot.pixels(points), where=where)
    assert np.all(color == 200)


def reel_of(station, count):
    """Return a film of the box that comes, where half the board is inked."""
    reel = FilmReel(station, fps=10)
    context = station.CreateDefaultContext()
    plant = station.GetSubsystemByName("plant")
    for i in range(count):
        context.SetTime(i / 10)
        q = [0.0, 0.3 * i / max(1, count - 1)]
        plant.SetPositions(plant.GetMyMutableContextFromRoot(context), q)
        reel.observe(context)
    return reel


VIEW = {"camera": CAMERA, "size": SIZE, "grid": GRID}


@pytest.mark.usefixtures("egl")
class TestFilms:
    def test_an_mp4_plays_every_frame(self, ffmpeg, station, outputs):
        film = outputs / "film.mp4"
        captions = [f"{t:.1f} s" for t in range(7)]
        render_film(film, reel_of(station, 7), captions=captions, **VIEW)
        assert list(outputs.iterdir()) == [film]
        frames, about = read_film(ffmpeg, film)
        assert about["codec"] == "h264"
        assert about["pix_fmt"].startswith("yuv420p")
        assert about["fps"] == 10
        assert tuple(about["source_size"]) == SIZE
        assert frames.shape == (7, SIZE[1], SIZE[0], 3)
        for frame in frames:
            assert 0.05 < blue(frame).mean() < 0.5
        assert np.mean(frames[0] != frames[-1]) > 0.01

    def test_a_gif_plays_every_frame_in_its_time(self, station, outputs):
        film = outputs / "film.gif"
        line = np.array([[-0.1, -0.2, 0.0], [-0.1, 0.2, 0.0]])
        render_film(film, reel_of(station, 7), trail=lambda _: line, **VIEW)
        assert list(outputs.iterdir()) == [film]
        with Image.open(film) as opened:
            assert opened.size == SIZE
            assert opened.info["loop"] == 0
            frames, durations = [], []
            for frame in ImageSequence.Iterator(opened):
                frames.append(np.asarray(frame.convert("RGB")))
                durations.append(frame.info["duration"])
        assert len(frames) == 7
        assert sum(durations) == pytest.approx(1000 * 7 / 10, abs=10)
        assert all(0.05 < blue(frame).mean() < 0.5 for frame in frames)
        # The box keeps its own colour, although it is small.
        r, g, b = np.moveaxis(frames[0].astype(int), -1, 0)
        assert np.mean((r > g + 60) & (r > b + 60)) > 0.005
        assert film.stat().st_size < 60_000

    def test_a_picture_is_a_frame_of_its_own(self, station, outputs):
        path = outputs / "one.png"
        path.write_bytes(b"older")
        render_picture(path, reel_of(station, 1), **VIEW)
        assert list(outputs.iterdir()) == [path]
        with Image.open(path) as opened:
            assert opened.size == SIZE
            assert 0.05 < blue(opened.convert("RGB")).mean() < 0.5

    @pytest.mark.parametrize("name", ["film.gif", "film.mp4"])
    def test_every_frame_is_tracked_once(self, name, station, outputs):
        if name.endswith(".mp4"):
            pytest.importorskip("imageio_ffmpeg")
        tracked_numbers = []

        def track(numbers):
            for number in numbers:
                tracked_numbers.append(number)
                yield number

        film = outputs / name
        render_film(film, reel_of(station, 3), track=track, **VIEW)
        assert tracked_numbers == [0, 1, 2]

    @pytest.mark.parametrize("name", ["film.mp4", "film.gif"])
    def test_a_film_that_fails_leaves_the_older_one(self, name, station, outputs):
        if name.endswith("mp4"):
            pytest.importorskip("imageio_ffmpeg")
        film = outputs / name
        film.write_bytes(b"precious")

        def trail(time):
            raise RunError(f"no trail at {time}")

        with pytest.raises(FmpError, match="no trail"):
            render_film(film, reel_of(station, 5), trail=trail, **VIEW)
        assert film.read_bytes() == b"precious"
        assert list(outputs.iterdir()) == [film]

    def test_an_ffmpeg_that_fails_is_an_error(self, station, outputs, monkeypatch):
        program = outputs / "ffmpeg"
        program.write_text("#!/bin/sh\necho out of order >&2\nexit 3\n")
        program.chmod(0o755)
        monkeypatch.setattr(
            "fmp_drake.film.encode.ffmpeg_program", lambda: str(program)
        )
        monkeypatch.setattr(
            "fmp_drake.film.render.ffmpeg_program", lambda: str(program)
        )
        with pytest.raises(FmpError, match="out of order"):
            render_film(outputs / "f.mp4", reel_of(station, 3), **VIEW)
        assert list(outputs.iterdir()) == [program]

    @pytest.mark.parametrize(
        ("change", "match"),
        [
            ({"size": (161, 120)}, "must be even"),
            (
                {"camera": CameraConfig(eye=[0.0, 0.0, 1.0], target=[0.0, 0.0, 0.0])},
                "straight",
            ),
        ],
    )
    def test_values_that_do_not_fit_are_refused(self, change, match, station, outputs):
        with pytest.raises(FmpError, match=match):
            render_film(outputs / "film.gif", reel_of(station, 1), **{**VIEW, **change})
        assert list(outputs.iterdir()) == []

    @pytest.mark.parametrize(
        ("has_board", "cleaned_by", "cleaned"),
        [
            (True, np.asarray, "cleaned 60 % of the demonstrated area"),
            (
                True,
                lambda times: 1.66 * times,
                "cleaned 99.6 % of the demonstrated area",
            ),
            (True, np.ones_like, "the demonstrated paths touch no ink"),
            (False, None, None),
        ],
    )
    def test_film_of_a_run_has_its_path_and_its_numbers(
        self, has_board, cleaned_by, cleaned, station, outputs, monkeypatch
    ):
        times = np.linspace(0.0, 0.6, 61)
        path = np.stack([0 * times - 0.1, times - 0.3, 0 * times + 0.002], axis=1)
        logs = {"measured_position": path, "normal_force": 10 * times[:, np.newaxis]}
        run = SimpleNamespace(
            scenario=SimpleNamespace(camera=CAMERA),
            log=logs.__getitem__,
            log_times=lambda _: times,
            grid=GRID,
            desired_force=lambda: 10.0 + 5 * times,
            cleaned_by=cleaned_by,
        )
        frames = []
        monkeypatch.setattr(render, "WipingRun", SimpleNamespace if has_board else str)
        monkeypatch.setattr(
            render, "draw_caption", lambda picture, text: frames.append((picture, text))
        )
        film_run(run, reel_of(station, 7), outputs / "film.gif", width=160)
        picture, text = frames[-1]
        if has_board:
            assert text.splitlines() == [
                "1 s",
                "force 6.0 N (desired 8 to 18 N)",
                cleaned,
            ]
        else:
            assert text == "1 s"
        # The box is to the right of the path.
        r, _, b = np.moveaxis(np.asarray(picture).astype(int), -1, 0)
        assert np.sum((r > b + 30)[:, :80]) > 20


class TestReel:
    def run(self, station, reel, until):
        simulator = Simulator(station)
        simulator.set_monitor(reel.observe)
        plant = station.GetSubsystemByName("plant")
        context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
        plant.SetVelocities(context, [0.0, 0.1])
        simulator.AdvanceTo(until)
        return simulator

    def test_a_reel_keeps_a_frame_for_each_time_of_the_film(self, station):
        reel = FilmReel(station, fps=10, speed=2.0)
        self.run(station, reel, 1.0)
        np.testing.assert_allclose(reel.times, np.arange(6) * 0.2, atol=1e-9)
        np.testing.assert_allclose(reel.positions[:, 1], 0.1 * reel.times, atol=1e-6)
        assert reel.ink.dtype == np.uint8
        np.testing.assert_array_equal(
            reel.ink, np.tile(np.rint(255 * half_inked()).ravel(), (6, 1))
        )

    def test_slow_motion_repeats_the_steps(self, station):
        reel = FilmReel(station, fps=50, speed=0.02)
        self.run(station, reel, 0.1)
        assert len(reel.times) == 251
        assert np.max(np.abs(reel.times - 0.02 / 50 * np.arange(251))) < 0.0101

    def test_times_between_steps_do_not_drift(self, station):
        reel = FilmReel(station, fps=30)
        self.run(station, reel, 2.0)
        assert len(reel.times) == 61
        assert np.max(np.abs(reel.times - np.arange(61) / 30)) < 0.0101

    def test_a_restarted_simulation_begins_a_new_reel(self, station):
        reel = FilmReel(station, fps=10)
        simulator = self.run(station, reel, 0.5)
        assert len(reel.times) == 6
        simulator.get_mutable_context().SetTime(0.0)
        simulator.Initialize()
        np.testing.assert_allclose(reel.times, [0.0])

    @pytest.mark.parametrize("change", [{"fps": 0}, {"fps": np.nan}, {"speed": -1}])
    def test_bad_rates_are_refused(self, change, station):
        with pytest.raises(FmpError, match=r"(fps|speed) is .* at least 0\.0"):
            FilmReel(station, **{"fps": 10, **change})


class TestChecks:
    @pytest.fixture(autouse=True)
    def can_render(self, monkeypatch):
        monkeypatch.setattr(scene, "renders", lambda: True)

    @pytest.mark.parametrize(
        ("name", "options", "match"),
        [
            ("film.avi", {}, r"end in \.mp4 or \.gif"),
            ("film", {}, r"end in \.mp4 or \.gif"),
            ("film.gif", {"fps": 0}, "fps is 0"),
            ("film.gif", {"fps": 0.001}, r"at least 0\.01"),
            ("film.gif", {"fps": 51}, "at most 50"),
            ("film.gif", {"fps": np.inf}, "fps is inf"),
            ("film.mp4", {"fps": 200}, "at most 120"),
            ("film.gif", {"speed": 0}, "speed is 0"),
            ("film.gif", {"size": (641, 480)}, "must be even"),
            ("film.gif", {"size": (0, 480)}, "must be even"),
            ("no/film.gif", {}, "there is no folder"),
        ],
    )
    def test_films_that_cannot_be_made_are_refused(self, name, options, match, outputs):
        with pytest.raises(FmpError, match=match):
            check_film(outputs / name, **options)

    def test_settings_of_no_film_and_of_a_valid_one_pass(self, outputs):
        check_film(None)
        check_film(outputs / "film.gif", fps=12, speed=3)
        check_film(outputs / "FILM.GIF")

    def test_the_missing_extra_is_named(self, monkeypatch, outputs):
        monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
        with pytest.raises(FmpError, match=r"pip install 'fmp-drake\[video\]'"):
            check_film(outputs / "film.mp4")
        check_film(outputs / "film.gif")

    def test_missing_ffmpeg_is_named(self, monkeypatch, outputs):
        def missing():
            raise RuntimeError("No ffmpeg exe could be found")

        package = SimpleNamespace(get_ffmpeg_exe=missing)
        monkeypatch.setitem(sys.modules, "imageio_ffmpeg", package)
        with pytest.raises(FmpError, match="there is no ffmpeg: No ffmpeg exe could"):
            check_film(outputs / "film.mp4")

    def test_missing_egl_is_named(self, monkeypatch, outputs):
        monkeypatch.setattr(scene, "renders", lambda: False)
        with pytest.raises(FmpError, match="libegl1"):
            check_film(outputs / "film.gif")


def test_a_machine_without_egl_is_recognised(monkeypatch):
    # Where it is missing, VTK ends the process with a segmentation fault.
    monkeypatch.setenv("__EGL_VENDOR_LIBRARY_FILENAMES", "/nowhere")
    assert scene.renders.__wrapped__() is False


@pytest.mark.parametrize(
    "failure", [OSError("no python"), subprocess.TimeoutExpired("python", 1)]
)
def test_without_a_running_probe_there_is_no_egl(failure, monkeypatch):
    def fail(*_, **__):
        raise failure

    monkeypatch.setattr(
        scene,
        "subprocess",
        SimpleNamespace(run=fail, TimeoutExpired=subprocess.TimeoutExpired),
    )
    assert scene.renders.__wrapped__() is False
