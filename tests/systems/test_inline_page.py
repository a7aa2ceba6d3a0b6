import numpy as np
import pytest
from browser import needs_chromium, screenshot
from pydrake.geometry import Box, Meshcat, Rgba

from fmp_drake.systems import InlinePage


@pytest.mark.browser
@needs_chromium
def test_a_notebook_shows_what_meshcat_shows(tmp_path):
    meshcat = Meshcat()
    meshcat.SetObject("box", Box(1.0, 1.0, 1.0), Rgba(1.0, 0.0, 0.0))
    meshcat.SetCameraPose([2.0, 0.0, 0.5], [0.0, 0.0, 0.0])
    shown = InlinePage(meshcat.StaticHtml(), height=300)
    page = tmp_path / "notebook.html"
    page.write_text(f"<body>{shown._repr_html_()}</body>", encoding="utf-8")
    red, green, _ = np.moveaxis(screenshot(page.as_uri(), tmp_path), 2, 0)
    assert np.mean((red > 0.3) & (green < 0.2 * red)) > 0.02


def test_where_no_page_can_be_shown_its_size_is_said():
    assert repr(InlinePage("x" * 2_340_000)) == "InlinePage of 2.3 MB"
