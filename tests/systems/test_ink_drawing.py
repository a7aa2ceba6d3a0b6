"""Facts about words and pictures as ink."""

import re

import numpy as np
import pytest
from PIL import Image
from pydrake.math import RigidTransform, RollPitchYaw

from fmp_drake.errors import SystemsError
from fmp_drake.systems.ink.drawing import (
    MARGIN,
    draw_picture,
    draw_words,
    upright_turns,
)
from fmp_drake.systems.ink.grid import InkGrid

GRID = InkGrid(size=(0.5, 0.7), cell=0.0025)


def extent(ink):
    """Return where there is ink in B: low and high corner in metres."""
    p = GRID.centres[ink.ravel() > 0.0]
    return p.min(axis=0), p.max(axis=0)


def by_quarters(ink):
    """Sum the ink over the quarters of the board, shape (2, 2), y first."""
    ny, nx = ink.shape
    return ink.reshape(2, ny // 2, 2, nx // 2).sum(axis=(1, 3))


def test_words_are_fractions_of_cells():
    ink = draw_words(GRID, "wipe me")
    assert ink.shape == GRID.shape
    assert ink.min() == 0.0
    assert ink.max() == 1.0
    assert np.any((ink > 0.0) & (ink < 1.0))


@pytest.mark.parametrize("turns", range(-1, 5))
def test_words_fill_the_board_up_to_its_margin(turns):
    low, high = extent(draw_words(GRID, "wide words", quarter_turns=turns))
    np.testing.assert_allclose(low, -high, atol=0.004)
    along = 1 if turns % 2 else 0
    free = 0.5 * GRID.size[along] * (1.0 - 2.0 * MARGIN)
    assert high[along] == pytest.approx(free, abs=0.004)


def test_letters_have_the_given_height_around_the_middle():
    ink = draw_words(GRID, "HI", height=0.1, quarter_turns=0)
    low, high = extent(ink)
    assert high[1] - low[1] == pytest.approx(0.1, abs=0.003)
    np.testing.assert_allclose(0.5 * (low + high), [0.0, 0.0], atol=0.003)
    turned = draw_words(GRID, "HI", height=0.1, quarter_turns=1)
    low, high = extent(turned)
    assert high[0] - low[0] == pytest.approx(0.1, abs=0.003)
    np.testing.assert_allclose(0.5 * (low + high), [0.0, 0.0], atol=0.003)


def test_what_is_larger_than_the_board_is_refused_with_what_fits(tmp_path):
    picture = tmp_path / "dark.png"
    Image.new("L", (20, 10)).save(picture)
    for draw in (
        lambda size: draw_words(GRID, "HI", height=size, quarter_turns=0),
        lambda size: draw_picture(GRID, picture, size=size, quarter_turns=0),
    ):
        with pytest.raises(SystemsError, match="larger than the board") as refusal:
            draw(30.0)
        largest = float(re.search(r"room for ([\d.]+) m", str(refusal.value))[1])
        assert draw(0.99 * largest).any()
        with pytest.raises(SystemsError, match="larger than the board"):
            draw(1.01 * largest)


def test_words_are_upright_and_not_mirrored():
    # An L has its stem on the left and its foot at the bottom.
    quarters = by_quarters(draw_words(GRID, "L", quarter_turns=0))
    assert quarters[1, 0] > quarters[1, 1]
    assert quarters[0, 1] > quarters[1, 1]
    assert quarters[0, 0] > 0.0
    # Turned counterclockwise: the foot points along +y, on the side of +x.
    quarters = by_quarters(draw_words(GRID, "L", quarter_turns=1))
    assert quarters[1, 1] > quarters[1, 0]
    assert quarters[0, 0] > quarters[1, 0]


def test_a_second_line_is_below_the_first():
    one = by_quarters(draw_words(GRID, "MMM\n.", quarter_turns=0)).sum(axis=1)
    two = by_quarters(draw_words(GRID, ".\nMMM", quarter_turns=0)).sum(axis=1)
    assert one[1] > one[0]
    assert two[0] > two[1]


def test_an_empty_line_leaves_its_place_free():
    high = [
        np.ptp(extent(draw_words(GRID, text, height=0.06, quarter_turns=0)), axis=0)[1]
        for text in ("M", "M\nM", "M\n\nM")
    ]
    assert high[2] - high[1] == pytest.approx(high[1] - high[0], abs=0.005)


def test_letters_keep_their_holes():
    ink = draw_words(GRID, "O", quarter_turns=0)
    middle = ink[GRID.shape[0] // 2, GRID.shape[1] // 2]
    assert middle == 0.0
    assert ink.sum() > 100.0


def test_dollar_signs_do_not_begin_a_formula():
    assert draw_words(GRID, "$5 or $6").any()


@pytest.mark.parametrize(
    ("text", "options", "what"),
    [
        ("", {}, "no words"),
        (" \n ", {}, "no words"),
        ("\u200b", {}, "cannot write"),
        ("\U0001f9fd", {}, "cannot write"),
        ("a", {"height": 0.0}, "height of the words is 0.0"),
        ("a", {"height": np.nan}, "height of the words is nan"),
        ("a", {"height": 1e-5}, "no ink on the board"),
    ],
)
def test_words_without_ink_are_refused(text, options, what):
    with pytest.raises(SystemsError, match=what):
        draw_words(GRID, text, **options)


@pytest.mark.parametrize(
    ("X_WB", "eye"),
    [
        (RigidTransform([0.55, 0.0, 0.10]), (1.12, -0.60, 0.72)),
        (RigidTransform([0.55, 0.0, 0.10]), (1.5, 0.0, 0.8)),
        (RigidTransform([0.55, 0.0, 0.10]), (-0.5, 0.1, 0.8)),
        (RigidTransform(RollPitchYaw(0, -0.436, 0), [0.6, 0, 0.3]), (-0.3, 0, 0.9)),
        (RigidTransform(RollPitchYaw(0, -np.pi / 2, 0), [0.6, 0, 0.5]), (-1, 0.3, 0.6)),
    ],
)
def test_upright_text_runs_to_the_right_in_the_camera_s_view(X_WB, eye):
    turns = upright_turns(GRID, X_WB=X_WB, eye=eye)
    angle = 0.5 * np.pi * turns
    along_B = np.array([np.cos(angle), np.sin(angle), 0.0])
    above_B = np.array([-np.sin(angle), np.cos(angle), 0.0])
    view = X_WB.translation() - np.asarray(eye)
    right = np.cross(view, [0.0, 0.0, 1.0])
    up = np.cross(right, view)
    R_WB = X_WB.rotation().matrix()
    assert right @ R_WB @ along_B > 0.0
    assert up @ R_WB @ above_B > 0.0


def test_upright_writing_runs_along_the_longer_edge():
    eye = (1.5, 0.0, 0.8)
    X_WB = RigidTransform([0.55, 0.0, 0.1])
    assert upright_turns(GRID, X_WB=X_WB, eye=eye) == 1
    assert upright_turns(InkGrid(size=(0.7, 0.5)), X_WB=X_WB, eye=(0, -2, 1)) == 0
    assert upright_turns(InkGrid(size=(0.7, 0.5)), X_WB=X_WB, eye=(0, 2, 1)) == 2


@pytest.fixture
def picture(tmp_path):
    """Save a picture of 40 x 20 pixels, black at the top left, grey below."""
    pixels = np.full((20, 40), 255, dtype=np.uint8)
    pixels[:10, :20] = 0
    pixels[10:, :20] = 102
    path = tmp_path / "picture.png"
    Image.fromarray(pixels).save(path)
    return path


def test_dark_pixels_are_ink_and_white_ones_are_not(picture):
    ink = draw_picture(GRID, picture, size=0.2, quarter_turns=0)
    top = ink[(GRID.y > 0.002) & (GRID.y < 0.048)]
    bottom = ink[(GRID.y < -0.002) & (GRID.y > -0.048)]
    left, right = (GRID.x > -0.098) & (GRID.x < -0.002), GRID.x > 0.002
    np.testing.assert_allclose(top[:, left], 1.0)
    np.testing.assert_allclose(bottom[:, left], 0.6, atol=0.01)
    assert (ink[:, right] == 0.0).all()
    assert (ink[np.abs(GRID.y) > 0.052] == 0.0).all()


def test_a_picture_fills_the_board_and_turns(picture):
    ink = draw_picture(GRID, picture, quarter_turns=1)
    low = extent(ink)[0]
    assert low[1] == pytest.approx(-0.5 * 0.7 * (1.0 - 2.0 * MARGIN), abs=0.004)
    # Dark on the left: along -y.
    assert by_quarters(ink)[0].sum() > by_quarters(ink)[1].sum()


def test_transparent_pixels_are_not_ink(tmp_path):
    pixels = np.zeros((8, 8, 4), dtype=np.uint8)
    pixels[:4, :, 3] = 255
    path = tmp_path / "half.png"
    Image.fromarray(pixels).save(path)
    ink = draw_picture(GRID, path, quarter_turns=0)
    assert (ink[GRID.y < -0.003] == 0.0).all()
    assert ink[GRID.y > 0.003].max() == 1.0


def test_files_that_are_not_pictures_are_refused(tmp_path, picture):
    with pytest.raises(SystemsError, match=r"there is no picture .*missing\.png"):
        draw_picture(GRID, tmp_path / "missing.png")
    text = tmp_path / "text.png"
    text.write_text("no picture")
    with pytest.raises(SystemsError, match=r"text\.png is not a picture"):
        draw_picture(GRID, text)
    broken = tmp_path / "broken.png"
    broken.write_bytes(picture.read_bytes()[:60])
    with pytest.raises(SystemsError, match=r"broken\.png"):
        draw_picture(GRID, broken)
    with pytest.raises(SystemsError, match="cannot be read"):
        draw_picture(GRID, tmp_path)
    white = tmp_path / "white.png"
    Image.new("L", (5, 5), 255).save(white)
    with pytest.raises(SystemsError, match="no ink on the board"):
        draw_picture(GRID, white)
    with pytest.raises(SystemsError, match="width of the picture is -1"):
        draw_picture(GRID, picture, size=-1)
