"""Kinds of recorded files, recognised by their first bytes, and their readers."""

import gzip
import shlex
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path

from fmp_drake.errors import FmpError, SkillFileError
from fmp_drake.primitives.data.reading import (
    arrays,
    bags,
    datasets,
    motion_capture,
    nested,
    text,
)
from fmp_drake.primitives.data.reading.table import (
    MOST_BYTES,
    ReadingOptions,
    Table,
    check_size,
    readable,
    without_copies,
)

# A reader returns one table for each recording in a file.
_Reader = Callable[[Path, ReadingOptions], list[Table]]
# Files that folders of recordings contain.
_LEROBOT, _BAG = "meta/info.json", "metadata.yaml"
_BOM = b"\xef\xbb\xbf"


def read_tables(path: Path, options: ReadingOptions) -> list[Table]:
    """Return the tables in a file or folder, one for each recording.

    Raises
    ------
    SkillFileError
        Where it is missing, broken, or of a kind that cannot be read.
    """
    if path.is_dir():
        return _reader_of_folder(path)(path, options)
    if not path.is_file():
        raise SkillFileError(f"there is no demonstration file {path}.")
    try:
        with path.open("rb") as stream:
            first = stream.read(4096).removeprefix(_BOM)
    except OSError as error:
        raise SkillFileError(f"cannot read {path}: {error.strerror}.") from None
    tables = _reader_of_file(path, first)(path, options)
    return tables if options.columns else [without_copies(t) for t in tables]


def _reader_of_folder(path: Path) -> _Reader:
    if (path / _LEROBOT).is_file():
        return datasets.read_lerobot
    if (path / _BAG).is_file():
        return bags.read_bag
    raise SkillFileError(
        f"{path} is a folder, but neither a ROS 2 bag (metadata.yaml) nor a LeRobot "
        "dataset (meta/info.json). "
        + (
            f"Name its files: fmp-drake inspect {shlex.quote(str(path))}/*"
            if any(path.iterdir())
            else "It is empty."
        )
    )


def _reader_of_file(path: Path, first: bytes) -> _Reader:
    """Return the reader of a file by its first bytes; by its ending where it is broken."""
    for magic, reader in _FIRST_BYTES.items():
        if first.startswith(magic):
            return reader
    if first.startswith(b"PK"):
        return _reader_of_archive(path)
    for (place, known), advice in _REFUSED.items():
        if first[place:].startswith(known):
            name = shlex.quote(str(path))
            raise SkillFileError(f"{path} is {advice.format(path=name)}")
    start = b"".join(first.split())[:2]
    if start == b"[[" or (start[:1] in (b"{", b"[") and b'"' in first):
        return nested.read_json
    if path.suffix.lower() in _ENDINGS:
        return _ENDINGS[path.suffix.lower()]
    is_vicon = motion_capture.is_vicon(first)
    return motion_capture.read_vicon if is_vicon else _read_text


def _read_text(path: Path, options: ReadingOptions) -> list[Table]:
    """Return the table in a text file, or those in its YAML."""
    try:
        return text.read_text(path, options)
    except text.YamlError:
        return nested.read_yaml(path, options)


def _reader_of_archive(path: Path) -> _Reader:
    """Return the reader of a zip archive by the names in it."""
    try:
        with zipfile.ZipFile(path) as archive:
            names = archive.namelist()
    except (OSError, zipfile.BadZipFile):  # The reader names the damage.
        readers = {".xlsx": arrays.read_excel, ".zip": _read_packed}
        return readers.get(path.suffix.lower(), arrays.read_npz_file)
    if "[Content_Types].xml" in names:
        return arrays.read_excel
    return (
        arrays.read_npz_file if all(n.endswith(".npy") for n in names) else _read_packed
    )


def _read_packed(path: Path, options: ReadingOptions) -> list[Table]:
    """Return the tables in a gzip file, or in a zip archive of one file."""
    with readable(path, "a packed file"):
        name, content = _unpacked(path)
    check_size(path, len(content))
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / name
        file.write_bytes(content)
        try:
            return read_tables(file, options)
        except FmpError as error:  # Name the user's file.
            raise type(error)(str(error).replace(str(file), str(path))) from None


def _unpacked(path: Path) -> tuple[str, bytes]:
    """Return the name and the first bytes of the only file in an archive."""
    if not zipfile.is_zipfile(path):
        with gzip.open(path) as stream:
            return path.stem, stream.read(MOST_BYTES + 1)
    with zipfile.ZipFile(path) as archive:
        names = [
            name
            for name in archive.namelist()
            # A Mac adds a folder of hidden files.
            if not name.endswith("/") and not Path(name).name.startswith(".")
        ]
        if len(names) != 1:
            # Datasets and bags are named by their folders.
            folders = [
                name.removesuffix(mark).rstrip("/") or "."
                for name in names
                for mark in (_LEROBOT, _BAG)
                if f"/{name}".endswith(f"/{mark}")
            ]
            names = folders or names
            raise SkillFileError(
                f"{path} holds several files; unpack it and name them: unzip "
                f"{shlex.quote(str(path))} && fmp-drake inspect {shlex.join(names)}"
            )
        with archive.open(names[0]) as member:
            return Path(names[0]).name, member.read(MOST_BYTES + 1)


_FIRST_BYTES: dict[bytes, _Reader] = {
    b"\x93NUMPY": arrays.read_npy,
    b"PAR1": arrays.read_parquet,
    b"#ROSBAG V2.0": bags.read_bag,
    b"\x89MCAP0": bags.read_bag,
    b"SQLite format 3": bags.read_bag,
    b"\x89HDF": datasets.read_hdf5,
    b"MATLAB 5": arrays.read_matlab,
    b"MATLAB 7.3": datasets.read_hdf5,
    b"\x1f\x8b": _read_packed,
    b"Format Version,": motion_capture.read_optitrack,
    b"PathFileType": motion_capture.read_trc,
    b"NO_OF_FRAMES\t": motion_capture.read_qualisys,
    b"FILE_VERSION\t": motion_capture.read_qualisys,
}
_ALTERNATIVES = (
    "; a demonstration is a table (.csv, .tsv, .txt, .xlsx; OptiTrack, Vicon), .npz, .npy, "
    ".parquet, .h5, .mat, JSON lines, YAML, a ROS 1 or ROS 2 bag, .mcap, or a LeRobot dataset. "
    "Write one of these, for example by numpy.savez('recording.npz', time=time, "
    "position=position)."
)
# Formats that are not supported, by bytes at an offset in the file, and advice.
_REFUSED = {
    (4, b"ftyp"): "a film" + _ALTERNATIVES,
    **dict.fromkeys(
        ((0, b"\x80"), (0, b"(lp"), (0, b"(dp"), (0, b"ccopy_reg"), (0, b"cnumpy")),
        "a Python pickle, which may run code" + _ALTERNATIVES,
    ),
    (0, b"\xd0\xcf\x11\xe0"): "an old Excel file; convert it: "
    "soffice --convert-to csv {path}",
    (257, b"ustar"): "an archive; unpack it and name its files: tar xf {path}",
    (0, b"\x02P"): "a C3D file; export it as .csv.",
    (0, b"HIERARCHY"): "a BVH file, of joint angles of a skeleton; export the "
    "positions of its joints as .csv.",
}
# Readers of broken files, which name the damage.
_ENDINGS: dict[str, _Reader] = {
    ".npz": arrays.read_npz_file,
    ".npy": arrays.read_npy,
    ".parquet": arrays.read_parquet,
    ".bag": bags.read_bag,
    ".mcap": bags.read_bag,
    ".db3": bags.read_bag,
    ".yaml": nested.read_yaml,
    ".yml": nested.read_yaml,
}
