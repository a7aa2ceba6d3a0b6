"""Of what kind a file is, told by its first bytes rather than by its name."""

from pathlib import Path

from fmp_drake.errors import SkillFileError

_READ = {
    b"\x93NUMPY": "npy",
    b"PAR1": "parquet",
    b"#ROSBAG V2.0": "bag",
    b"\x89MCAP0": "bag",
    b"SQLite format 3": "bag",
}
_NOT_READ = {
    b"\x89HDF": "an HDF5 file (robomimic, MATLAB 7.3)",
    b"MATLAB 5": "a MATLAB file",
    b"\xd0\xcf\x11\xe0": "an old Excel file",
    b"\x1f\x8b": "compressed by gzip",
    b"\x28\xb5\x2f\xfd": "compressed by zstd",
    b"BZh": "compressed by bzip2",
    b"7z\xbc\xaf": "a 7z archive",
    b"\x80": "a Python pickle, which may run code",
    b"%PDF": "a PDF",
    b"\x89PNG": "a picture",
    b"\xff\xd8\xff": "a picture",
    b"ARROW1": "an Arrow file",
    b"<?xml": "an XML file",
    b"#ROSBAG V1": "a ROS bag of version 1 (rosbag fix)",
}
_KINDS = (
    "a table (.csv, .tsv, .txt), .npz, .npy, .parquet, a ROS 1 or ROS 2 bag, .mcap, or a "
    "LeRobot dataset"
)


def kind_of(path: Path) -> str:
    """Return how a file or folder is read: npz, npy, parquet, bag, lerobot or text.

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
            "dataset (meta/info.json)."
        )
    if not path.is_file():
        raise SkillFileError(f"there is no demonstration file {path}.")
    try:
        with path.open("rb") as stream:
            begin = stream.read(4096)
    except OSError as error:
        raise SkillFileError(f"cannot read {path}: {error.strerror}.") from None
    for magic, kind in _READ.items():
        if begin.startswith(magic):
            return kind
    if begin.startswith(b"PK"):
        if b"[Content_Types].xml" not in begin:
            return "npz"
        raise _refusal(path, "an Excel or other office file")
    if b"ftyp" in begin[4:12]:
        raise _refusal(path, "a film")
    for magic, what in _NOT_READ.items():
        if begin.startswith(magic):
            raise _refusal(path, what)
    if path.suffix.lower() in (".npz", ".npy", ".bag", ".mcap", ".db3", ".parquet"):
        # An ending promises more than the bytes hold.
        return path.suffix[1:].lower().replace("mcap", "bag").replace("db3", "bag")
    if begin.lstrip()[:1] in (b"{", b"[") and b'"' in begin:
        raise _refusal(path, "a JSON file")
    return "text"


def _refusal(path: Path, what: str) -> SkillFileError:
    return SkillFileError(
        f"{path} is {what}; a demonstration is {_KINDS}. Export it as one of these."
    )
