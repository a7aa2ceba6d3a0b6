"""Facts about `fmp-drake video`."""

import sys
import tarfile

import matplotlib.image
import numpy as np
import pytest
from films import read_film
from PIL import Image

FRAMES = 12


@pytest.fixture
def ffmpeg():
    return pytest.importorskip(
        "imageio_ffmpeg", reason="films need the extra fmp-drake[video]"
    )


@pytest.fixture
def make_frames(tmp_path):
    """The function that packs pictures as the page's recorder does."""

    def make(size=(64, 48), count=FRAMES):
        archive = tmp_path / "frames.tar"
        with tarfile.open(archive, "w") as tar:
            for i in range(count):
                picture = np.zeros((size[1], size[0], 3))
                picture[:, : (i + 1) * size[0] // count, 2] = 1.0
                path = tmp_path / f"{i:07d}.png"
                matplotlib.image.imsave(path, picture)
                tar.add(path, arcname=path.name)
                path.unlink()
        return archive

    return make


@pytest.mark.parametrize("size", [(64, 48), (63, 47)])
def test_film_plays_the_frames(ffmpeg, command, make_frames, outputs, size):
    film = outputs / "film.mp4"
    result = command("video", make_frames(size), film, "--fps", 24)
    assert result.code == 0, result
    assert f"wrote {film}" in result.out
    assert list(outputs.iterdir()) == [film]
    count, seconds = ffmpeg.count_frames_and_secs(str(film))
    assert count == FRAMES
    assert seconds == pytest.approx(FRAMES / 24, abs=0.1)
    frames, about = read_film(ffmpeg, film)
    assert about["fps"] == 24
    # A format that browsers and phones can play.
    assert about["codec"] == "h264"
    assert about["pix_fmt"].startswith("yuv420p")
    assert len(frames) == FRAMES
    # Odd sizes are padded.
    assert frames.shape[1:3] == (48, 64)
    # The bar grows from frame to frame.
    blue = (frames[..., 2] > 128).mean(axis=(1, 2))
    assert np.all(np.diff(blue) > 0)


def test_existing_film_is_replaced(ffmpeg, command, make_frames, outputs):
    film = outputs / "film.mp4"
    film.write_bytes(b"old")
    assert command("video", make_frames(), film).code == 0
    assert ffmpeg.count_frames_and_secs(str(film))[0] == FRAMES


def test_a_gif_needs_no_extra(command, make_frames, outputs, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    film = outputs / "film.gif"
    assert command("video", make_frames(), film).code == 0
    with Image.open(film) as opened:
        assert (opened.n_frames, opened.size) == (FRAMES, (64, 48))


@pytest.mark.usefixtures("ffmpeg")
def test_invalid_archive_of_frames_is_refused(refused, make_frames, tmp_path, outputs):
    film = outputs / "film.mp4"
    assert "no frame archive" in refused("video", tmp_path / "nowhere.tar", film)
    noise = tmp_path / "noise.tar"
    noise.write_bytes(b"no tar at all")
    assert "is not a .tar" in refused("video", noise, film)
    empty = tmp_path / "empty.tar"
    with tarfile.open(empty, "w") as tar:
        tar.add(noise, arcname="readme.txt")
    assert "is not a .tar" in refused("video", empty, film)
    whole = make_frames().read_bytes()
    noise.write_bytes(whole[: 3 * len(whole) // 4])
    assert "is damaged after" in refused("video", noise, film)
    with tarfile.open(empty, "w") as tar:
        tar.add(noise, arcname="0000001.png")
    assert "0000001.png of" in refused("video", empty, film)
    assert list(outputs.iterdir()) == []


def test_frames_of_a_gif_last_what_every_player_can_show(command, make_frames, outputs):
    film = outputs / "film.gif"
    assert command("video", make_frames(), film).code == 0
    with Image.open(film) as frames:
        durations = []
        for i in range(frames.n_frames):
            frames.seek(i)
            durations.append(frames.info["duration"])
    assert durations == [20] * FRAMES


@pytest.mark.usefixtures("ffmpeg")
def test_wrong_options_are_refused(refused, make_frames, outputs, tmp_path):
    frames, film = make_frames(), outputs / "film.mp4"
    assert "fps is 0" in refused("video", frames, film, "--fps", 0)
    assert "there is no folder" in refused("video", frames, tmp_path / "no" / "f.mp4")
    assert "film.xyz" in refused("video", frames, outputs / "film.xyz")
    fast = ("--fps", 60)
    assert "at most 50" in refused("video", frames, outputs / "film.gif", *fast)
    assert list(outputs.iterdir()) == []


def test_missing_extra_is_named(refused, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    message = refused("video", tmp_path / "frames.tar", tmp_path / "film.mp4")
    assert "pip install 'fmp-drake[video]'" in message
