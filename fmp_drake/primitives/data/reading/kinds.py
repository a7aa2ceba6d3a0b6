"""Kinds of recorded files, recognised by their first bytes, and their readers."""

import gzip
import tempfile
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fmp_drake.errors import FmpError, SkillFileError
from fmp_drake.primitives.data.reading.arrays import (
    read_lerobot,
    read_npy,
    read_parquet,
)
from fmp_drake.primitives.data.reading.bags import read_bag
from fmp_drake.primitives.data.reading.hdf5 import read_hdf5
from fmp_drake.primitives.data.reading.motion_capture import (
    is_vicon,
    read_optitrack,
    read_vicon,
)
from fmp_drake.primitives.data.reading.reading_options import ReadingOptions
from fmp_drake.primitives.data.reading.structured import (
    read_excel,
    read_json,
    read_matlab,
)
from fmp_drake.primitives.data.reading.table import MOST_BYTES, Table, check_size
from fmp_drake.primitives.data.reading.text import read_text

# First bytes of a file, and its kind.
_FIRST_BYTES = {
    b"\x93NUMPY": "npy",
    b"PAR1": "parquet",
    b"#ROSBAG V2.0": "bag",
    b"\x89MCAP0": "bag",
    b"SQLite format 3": "bag",
    b"\x89HDF": "hdf5",
    b"MATLAB 5": "matlab",
    b"\x1f\x8b": "packed",
    b"Format Version,": "optitrack",
    b"\xef\xbb\xbfFormat Version,": "optitrack",
}
# Readers of kinds with one recording, without options.
_READERS = {
    "npy": read_npy,
    "parquet": read_parquet,
    "matlab": read_matlab,
    "excel": read_excel,
    "json": read_json,
    "optitrack": read_optitrack,
    "vicon": read_vicon,
    "text": read_text,
}
_KINDS = (
    "a table (.csv, .tsv, .txt, .xlsx; OptiTrack, Vicon), .npz, .npy, .parquet, .h5, "
    ".mat, JSON lines, a ROS 1 or ROS 2 bag, .mcap, or a LeRobot dataset"
)


def kind_of(path: Path) -> str:
    """Return the kind of a file or folder: npz, bag, lerobot, hdf5, packed, text ...

    Raises
    ------
    SkillFileError
        Where it is missing, or cannot be read; its kind is named.
    """
    if path.is_dir():
        if (path / "meta" / "info.json").is_file():
            return "lerobot"
        if (path / "metadata.yaml").is_file():
            return "bag"
        raise SkillFileError(
            f"{path} is a folder, but neither a ROS 2 bag (metadata.yaml) nor a LeRobot "
            "dataset (meta/info.json). Name its files: "
            f"fmp-drake inspect {path}/*."
        )
    if not path.is_file():
        raise SkillFileError(f"there is no demonstration file {path}.")
    try:
        with path.open("rb") as stream:
            first = stream.read(4096)
    except OSError as error:
        raise SkillFileError(f"cannot read {path}: {error.strerror}.") from None
    for magic, kind in _FIRST_BYTES.items():
        if first.startswith(magic):
            return kind
    if first.startswith(b"PK"):
        return _kind_of_archive(path)
    if first.startswith(b"\x80"):
        raise _refusal(
            path,
            "a Python pickle, which may run code",
            "numpy.savez('recording.npz', time=time, position=position)",
        )
    if b"ftyp" in first[4:12]:
        raise _refusal(
            path, "a film", "numpy.savez('recording.npz', time=t, position=p)"
        )
    if path.suffix.lower() in (".npz", ".npy", ".bag", ".mcap", ".db3", ".parquet"):
        # A truncated file: its reader names the damage.
        return path.suffix[1:].lower().replace("mcap", "bag").replace("db3", "bag")
    if first.lstrip()[:1] in (b"{", b"[") and b'"' in first:
        return "json"
    return "vicon" if is_vicon(first) else "text"


def read_tables(path: Path, kind: str, options: ReadingOptions) -> list[Table]:
    """Return the tables in a file of a kind other than npz, one per recording."""
    if kind == "lerobot":
        return read_lerobot(path, options.topic)
    if kind == "bag":
        return [read_bag(path, options.topic)]
    if kind == "hdf5":
        return read_hdf5(path, options.topic)
    if kind == "packed":
        with _unpacked(path) as file:
            return read_tables(file, kind_of(file), options)
    return [_READERS[kind](path)]


def _kind_of_archive(path: Path) -> str:
    """Return the kind of a zip archive by the names in it."""
    try:
        with zipfile.ZipFile(path) as archive:
            names = archive.namelist()
    except (OSError, zipfile.BadZipFile):
        return "npz"  # Its reader names the damage.
    if "[Content_Types].xml" in names:
        return "excel"
    return "npz" if all(name.endswith(".npy") for name in names) else "packed"


@contextmanager
def _unpacked(path: Path) -> Iterator[Path]:
    """Yield a temporary file with the content of a gzip file or of a zip of one file."""
    try:
        name, content = _content(path)
    except (OSError, EOFError, RuntimeError, zipfile.BadZipFile, zlib.error) as reason:
        raise SkillFileError(f"{path} cannot be unpacked ({reason}).") from None
    check_size(path, len(content))
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / name
        file.write_bytes(content)
        try:
            yield file
        except FmpError as error:  # Name the file of the user.
            raise type(error)(str(error).replace(str(file), str(path))) from None


def _content(path: Path) -> tuple[str, bytes]:
    """Return the name and the first bytes of the only file in an archive."""
    if not zipfile.is_zipfile(path):
        with gzip.open(path) as stream:
            return path.stem, stream.read(MOST_BYTES + 1)
    with zipfile.ZipFile(path) as archive:
        names = [name for name in archive.namelist() if not name.endswith("/")]
        if len(names) != 1:
            raise SkillFileError(
                f"{path} holds {len(names)} files; unpack it and name them: unzip {path}."
            )
        with archive.open(names[0]) as member:
            return Path(names[0]).name, member.read(MOST_BYTES + 1)


def _refusal(path: Path, what: str, call: str) -> SkillFileError:
    return SkillFileError(
        f"{path} is {what}; a demonstration is {_KINDS}. Write one of these, for example "
        f"by {call}."
    )
