"""Facts about the colours of ink."""

import numpy as np

from fmp_drake.systems.ink.mesh import BOARD_COLOUR, INK_COLOUR, ink_colours


def test_full_ink_is_a_pale_blue_marker_and_none_is_the_board():
    colours = ink_colours(np.array([[0.0, 1.0, 0.5]]))
    assert colours.shape == (1, 3, 3)
    np.testing.assert_allclose(colours[0, 0], BOARD_COLOUR)
    np.testing.assert_allclose(colours[0, 1], INK_COLOUR)
    np.testing.assert_allclose(
        colours[0, 2], 0.5 * np.add(INK_COLOUR, BOARD_COLOUR), rtol=1e-12
    )
    red, green, blue = ink_colours(1.0, srgb=True)
    assert blue > 1.2 * green > 1.4 * red > 0.5


def test_srgb_is_the_standard_curve():
    np.testing.assert_allclose(ink_colours(0.0, srgb=True), 1.0)
    expected = 1.055 * np.array(INK_COLOUR) ** (1 / 2.4) - 0.055
    np.testing.assert_allclose(ink_colours(1.0, srgb=True), expected)


def test_fractions_out_of_range_are_clipped():
    np.testing.assert_array_equal(ink_colours([-1.0, 2.0]), ink_colours([0.0, 1.0]))
