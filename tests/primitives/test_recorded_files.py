"""Facts about files as people have them: read exactly, or refused with advice."""

import json
import re
import shlex
import shutil
import subprocess
import sys
import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import recorded_files as files
import yaml
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from fmp_drake.errors import FmpError
from fmp_drake.primitives import Demonstration, ReadingOptions, read_demonstrations
from fmp_drake.primitives.data.orientation import rotations_of

NEEDS = {"bag": "rosbags", "ros": "rosbags", "mcap": "rosbags"} | dict.fromkeys(
    ("lerobot", "parquet", "half"), "pyarrow"
)
NEEDS |= {"hdf5": "h5py", "robomimic": "h5py", "aloha": "h5py", "excel_": "openpyxl"}

# Header of a force plate: properties of all columns, then of the file, names and units.
PLATE = """Version 5 Export
Device:\tPlate\tPlate\tPlate\tPlate
Samples (#):\t400\t400\t400\t400
Rate (Hz):\t50.0\t50.0\t50.0\t50.0
File Information
Date\tNov 03, 2014
abs time\tFx\tFy\tFz\tMx
s\tN\tN\tN\tN m"""

# Read as x, y and z.
POSITIONS = (
    files.plain,
    files.units_in_brackets,
    files.units_in_full,
    files.pandas_index,
    files.pandas_time_index,
    files.pandas_dates,
    files.short_t,
    files.axis_before_the_word,
    files.header_of_savetxt,
    files.end_effector,
    files.words_that_begin_later,
    files.columns_of_words_that_begin_later,
    files.position_of_two_topics,
    files.stamps_without_names,
    files.stamps_beside_the_time,
    files.compact_dates,
    files.vectors_over_several_lines,
    files.lists_between_semicolons,
    files.number_after_a_list,
    files.json_beside_a_list,
    files.json_with_a_rate,
    files.json_of_pandas,
    files.units_in_the_singular,
    files.number_after_a_column_of_words,
    files.qualisys,
    files.qualisys_without_names,
    files.hands_in_turn,
    files.numbered_sensors_in_turn,
    files.landmarks_of_hands,
    files.json_of_landmarks_of_hands,
    files.json_of_landmarks_in_frames,
    files.json_of_arrays_of_landmarks,
    files.npz_of_landmarks,
    files.hdf5_of_matlab_7_3,
    files.hdf5_of_two_arms,
    files.hdf5_with_the_clock_of_a_camera,
    files.npz_beside_a_scan,
    files.npz_with_dates,
    files.npz_with_durations,
    files.json_of_bodies_in_turn,
    files.json_of_numbered_bodies_in_turn,
    files.parquet_of_bodies_in_turn,
    files.hdf5_of_angles_beside_a_position,
    files.zeros_at_the_end,
    files.table_that_is_named_yaml,
    files.json_lines_that_are_named_yaml,
    files.yaml_documents,
    files.capitals,
    files.semicolons,
    files.decimal_commas,
    files.tabs,
    files.spaces,
    files.no_header,
    files.comments,
    files.preamble_and_units_below,
    files.spreadsheet,
    files.old_spreadsheet,
    files.milliseconds,
    files.milliseconds_in_the_name,
    files.nanoseconds,
    files.millimetres,
    files.columns_by_name,
    files.columns_by_number,
    files.rate_instead_of_time,
    files.samples_counted,
    files.repeated_stamps,
    files.gaps_between_topics,
    files.words_beside,
    files.npz_of_the_package,
    files.npz_of_someone,
    files.npz_in_milliseconds,
    files.npz_of_one_array,
    files.npz_by_columns,
    files.npy_with_a_rate,
    files.npy_with_times,
    files.npy_with_fields,
    files.parquet,
    files.optitrack_two_bodies,
    files.vicon_trajectories,
    files.trc,
    files.vicon_objects,
    files.hdf5_of_someone,
    files.hdf5_of_matlab,
    files.matlab,
    files.json_lines,
    files.json_list,
    files.json_columns,
    files.excel_sheet,
    files.table_by_gzip,
    files.array_by_gzip,
    files.table_in_zip,
    files.table_in_zip_of_a_mac,
    files.npz_by_gzip,
    files.time_by_its_unit,
    files.rows_twice,
    files.rows_out_of_order,
    files.columns_by_the_names_of_channels,
    files.vicon_one_marker_of_two,
    files.json_rows,
    files.json_list_in_an_object,
    files.matlab_matrix,
    files.dates_by_day,
    files.dates_by_month,
    files.points_between_thousands,
    files.units_in_words,
    files.header_of_numbers,
    files.header_of_a_time_and_numbers,
    files.header_of_a_time_in_milliseconds_and_numbers,
    files.index_of_pandas_above_numbers,
    files.list_in_each_line,
    files.measured_and_commanded,
    files.positions_by_number,
    files.sheet_after_notes,
    files.npz_with_a_rate,
)
# Read as x, y, z and an orientation.
POSES = (
    files.ros_topic_echo,
    files.rostopic_echo_in_yaml,
    files.bagpy,
    files.tum,
    files.ros1_poses,
    files.ros1_one_topic_of_two,
    files.ros2_transforms,
    files.mcap_file,
    files.ros2_without_stamps,
    files.ros1_out_of_order,
    files.optitrack,
    files.optitrack_in_millimetres,
    files.qualisys_bodies,
    files.libfranka,
    files.libfranka_desired_too,
    files.rostopic_of_franka,
    files.npz_of_matrices,
    files.npz_of_matrices_without_the_last_row,
    files.table_of_matrices_without_a_header,
    files.npz_of_poses,
    files.tum_without_header,
    files.poses_behind_stamps_without_names,
    files.quaternion_from_1,
    files.quaternion_of_one_letter,
    files.quaternion_without_a_word,
    files.lists_in_cells,
)
REFUSED = {
    files.no_time: r"no column holds the time; .* x, y, z\. .*--sample-rate",
    files.counted_time: r"counts 1, 2, 3 .* samples or milliseconds\..* --columns 'time=time \[ms\]'$",
    files.coarse_time: r"stays the same in 391 of 400 samples: .*--sample-rate 50$",
    files.coarser_time: r"stays the same in 398 of 400 .* instead: --sample-rate HZ$",
    files.time_backwards: r"does not increase after sample 199 \(3\.98 s, then 0 s\)",
    files.values_missing: r"252 of 400 samples have no value of z; leave them out: "
    r"--columns x=x,y=y$",
    files.broken_lines: r"12 of 400 rows broken \(line 9: 2 cells instead of 4\); delete "
    r"them: sed -i\.orig '9d;10d;.*20d' ",
    files.bytes_of("d.csv", b""): r"is empty: .* fmp-drake record --out demo\.csv$",
    files.bytes_of("d.csv", b"time,x\n"): r"no line of numbers .* --out demo\.csv$",
    files.bytes_of("d.xls", b"\xd0\xcf\x11\xe0"): "soffice --convert-to csv ",
    files.bytes_of("d.tar", bytes(257) + b"ustar"): "an archive; .*: tar xf ",
    files.bytes_of("d.c3d", b"\x02P" + bytes(9)): r"a C3D file; export it as \.csv",
    files.bytes_of(
        "d.bvh", b"HIERARCHY\nROOT Hips"
    ): r"a BVH file, of joint angles .*csv",
    files.bytes_of("d.xlsx", b"PK\x03\x04"): r"not a readable Excel file .*as \.csv",
    files.unknown_column: r"no column 'px' for x; the columns are time, x, y, z",
    files.repeated_names: r"names of columns repeat: a \(2, 3, 4\); .* time, a, a, a",
    files.no_quaternions: r"not unit quaternions \(lengths from 5 to 5\)",
    files.sensors_in_turn_without_a_choice: "sensor_id alternates: .* among 3, 7: --topic 3",
    files.landmarks_without_a_choice: "landmark alternates: .* 19, 20: --topic 0$",
    files.landmarks_of_both_hands: "hand alternates: .* among 8,Left, 8,Right: --topic 8,Left$",
    files.json_of_landmarks_of_both_hands: "hand alternates: .* --topic 8,Left$",
    files.landmarks_of_an_unknown_label: "no column has 99 to choose; .* --topic 8,Left$",
    files.yaml_of_joints: "holds neither objects nor lists of numbers",
    files.yaml_with_aliases: "YAML with aliases; write JSON",
    files.deep_yaml: "more than 100 levels",
    files.deep_keys_in_yaml: "holds nothing",
    files.broken_yaml: "no line of numbers",
    files.letter: r"no line of numbers .* header such as `time,x,y,z`",
    files.windows: r"the array \(5, 3, 3, 120\).* expected .* \(N, D\)",
    files.objects: r"Python objects, which may run code; save an array",
    files.pickled: r"a Python pickle, which may run code; a demonstration is",
    files.pickled_as_text: r"a Python pickle, which may run code; a demonstration is",
    files.excel: r"not a readable Excel file .*; save it as \.csv",
    files.hollow_archive: r"unpacked it takes 288 MB; at most 256 MB",
    files.boasting_archive: r"shorter than its shape",
    files.bytes_of("d.h5", b"\x89HDF\r\n\x1a\n"): "not a readable HDF5 file",
    files.bytes_of("d.mat", b"MATLAB 5.0 MAT-file"): "not a readable MATLAB file",
    files.bytes_of("d.csv.gz", b"\x1f\x8b\x08"): "not a readable packed file",
    files.bytes_of("d.json", b'{"x": [1, 2]}'): r"no column holds the time; .* are x",
    files.bytes_of("d.jsonl", b'{"x": 1}\n{"x"'): "line 2 is not JSON .* such as",
    files.bytes_of("d.json", b'["a", "b"]'): "neither objects nor lists of numbers",
    files.bytes_of("d.jsonl", b'{"x": 1}\n[1, 2]'): "neither objects nor lists",
    files.bytes_of("d.npy", b""): r"not a readable \.npy file \([^;]*\)\.$",
    files.empty_array: r"d\.npy holds no samples",
    files.bytes_of("d.json", b'{"x": [[1, 2], [3]]}'): "not a readable JSON",
    files.bytes_of("d.json", b'["' + b"[" * 200_000): "not a readable JSON|is not JSON",
    files.bytes_of("d.json", b'[{"x": [[1], 2]}]'): "not a readable JSON",
    files.hdf5_of_links: "holds nothing; expected arrays of numbers",
    files.matlab_too_large: r"d\.mat holds \d+ MB; at most 256",
    files.json_of_bodies_without_a_choice: "body alternates: .* among a, b: --topic a",
    files.bursts: "come in bursts, 0.1 ms apart and 239 ms between .* --sample-rate 50",
    files.bag_in_zip: r"unzip \S+d\.zip && fmp-drake inspect run$",
    files.tables_in_zip: "holds several files; unpack it and name them: unzip ",
    files.letter_by_gzip: r"d\.txt\.gz has no line of numbers",
    files.bomb_by_gzip: "holds 256 MB; at most 256",
    files.optitrack_without_header: "no row `Frame,Time .* export it from Motive",
    files.vicon_two_markers: r"30 of 400 samples have no value of Wand:B X, .*; several positions \(Wand:A X, "
    r"Wand:B X \.\.\.\): choose with --columns 'x=Wand:A X,y=Wand:A Y,z=Wand:A Z'$",
    files.trc_without_header: "no row `Frame#`, `Time` ... below its settings",
    files.vicon_without_positions: "none of the sections Objects, .* from Nexus",
    files.aloha: "no column holds the time; .*--sample-rate 100",
    files.bytes_of("d.csv", b"1,2\0\0\0,3"): "not a text file",
    files.bytes_of("d.mp4", b"\0\0\0\x18ftypmp42"): "a film; a demonstration is",
    files.bytes_of("d.csv", b"0," + b"1" * 140_000): "line cannot be split into cells",
    files.bytes_of(
        "d.txt", b"Dear Sir,\n" * 201 + b"0 1\n1 2\n"
    ): "no line of numbers among its first 200",
    files.bytes_of("d.bag", b""): "not a readable bag",
    files.bytes_of("d.parquet", b"PAR1"): "not a readable Parquet file",
    files.bytes_of("d.csv", b""): "is empty",
    files.empty_folder: "a folder, but neither a ROS 2 bag .* nor a LeRobot dataset",
    files.ros1_two_poses: r"topics /left \(PoseStamped\), /right .* --topic",
    files.ros1_cut: "not a readable bag",
    files.half_a_dataset: r"no feature observation\.state; .* --topic among action",
}


def name_of(make):
    return make.__name__


def written(make, folder):
    """Write a file, where what writes it is installed."""
    for begin, package in NEEDS.items():
        if make.__name__.startswith(begin):
            pytest.importorskip(package)
    return make(folder)


def options_of(file):
    given = dict(file.options)
    rate = given.pop("sample-rate", None)
    return ReadingOptions.parse(given.pop("columns", ""), sample_rate=rate, **given)


def read(make, folder):
    file = written(make, folder)
    found, remarks = read_demonstrations([file.path], options_of(file))
    return found, " ".join(remarks)


def test_there_are_at_least_25_kinds():
    assert len(POSITIONS) + len(POSES) + len(REFUSED) > 60


@pytest.mark.parametrize("make", POSITIONS, ids=name_of)
def test_positions_are_read(make, tmp_path):
    (found,), _ = read(make, tmp_path)
    assert found.channels == ("x", "y", "z")
    assert found.units == ("m", "m", "m")
    assert_allclose(found.time, files.TIME, atol=1e-6)
    assert_allclose(found.values, files.PATH, atol=1e-12)


@pytest.mark.parametrize("make", POSES, ids=name_of)
def test_poses_are_read_with_an_orientation_that_does_not_jump(make, tmp_path):
    (found,), _ = read(make, tmp_path)
    assert found.channels == ("x", "y", "z", "rx", "ry", "rz")
    assert found.units == ("m", "m", "m", "rad", "rad", "rad")
    assert_allclose(found.time - found.time[0], files.TIME, atol=1e-6)
    assert_allclose(found.values[:, :3], files.PATH, atol=1e-12)
    turned = rotations_of(found.values[:, 3:], found.rotation_reference)
    assert np.max((turned * files.TURNS.inv()).magnitude()) < 1e-6
    assert np.max(np.abs(np.diff(found.values[:, 3:], axis=0))) < 0.1


@pytest.mark.parametrize("make", REFUSED, ids=name_of)
def test_unreadable_files_are_refused_with_advice(make, tmp_path):
    with pytest.raises(FmpError, match=REFUSED[make]) as refusal:
        read(make, tmp_path)
    assert str(tmp_path) in str(refusal.value)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("\n50\n", "\n0\n", "has no rate, or no columns, in Trajectories"),
        (",X,Y,Z", ",,,", "has no rate, or no columns, in Trajectories"),
        ("\n7,0,", "\n7,0,lost", r"line 12: 'lost.*' is not a number"),
    ],
)
def test_broken_vicon_files_are_refused(old, new, message, tmp_path):
    columns = ["X", "Y", "Z"], ["mm"] * 3, files.PATH
    text = files.vicon_section("Trajectories", "Wand:Tip", *columns)
    assert text.count(old) == 1
    path = files.write(tmp_path, text.replace(old, new)).path
    with pytest.raises(FmpError, match=message):
        read_demonstrations([path])


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (files.milliseconds, "the time is in ms"),
        (files.nanoseconds, "the time is in ns"),
        (files.decimal_commas, "decimal commas, semicolons between the columns"),
        (files.units_in_brackets, "x, y, z converted to m"),
        (files.optitrack_in_millimetres, "x, y, z converted to m"),
        (files.repeated_stamps, "2 samples with the time of the one before left out"),
        (files.gaps_between_topics, "400 rows without a value left out"),
        (files.rows_out_of_order, "samples sorted by time"),
        (files.rows_twice, "100 samples with the time of the one before left out"),
        (files.no_header, "column 1, which increases, is taken for the time"),
        (files.words_beside, "task left out: not numeric"),
        (files.npz_of_someone, "gains .* left out"),
        (files.ros1_poses, "/pose, header stamps"),
        (files.ros2_without_stamps, "/pose, times of receipt"),
        (files.ros1_out_of_order, "/pose, header stamps, sorted"),
        (files.optitrack, "OptiTrack, Eraser; 1 marker left out"),
        (files.vicon_trajectories, "Vicon, Trajectories at 50 Hz"),
        (files.libfranka, "O_T_EE_0 to O_T_EE_15 are a pose"),
        (files.left_and_right, r"several positions \(l_x, r_x .* x=l_x,y=l_y,z=l_z$"),
        (
            files.two_arms,
            r"several arms \(left_arm_q1, right_arm_q1 .* joint1=left_arm_",
        ),
        (files.two_hands, r"several positions \(left_x, right_x \.\.\.\): choose with"),
        (files.two_arms_one_force, r"several positions \(left_tx, right_tx \.\.\.\)"),
    ],
    ids=lambda each: getattr(each, "__name__", ""),
)
def test_recognised_columns_are_reported(make, said, tmp_path):
    (found,), remarks = read(make, tmp_path)
    assert re.search(said, remarks)
    assert found.note in remarks


def test_a_lost_marker_of_qualisys_is_left_out(tmp_path):
    path = files.qualisys_without_names(tmp_path).path
    text = path.read_text().splitlines()
    text[53] = "0.000\t0.000\t0.000"
    path.write_text("\n".join(text) + "\n")
    (found,), _ = read_demonstrations([path])
    assert_allclose(found.time, np.delete(files.TIME, 50))
    assert_allclose(found.values, np.delete(files.PATH, 50, axis=0))


def test_a_marker_of_qualisys_may_have_any_name(tmp_path):
    path = files.qualisys_without_names(tmp_path).path
    path.write_text(path.read_text().replace("Wand", "left quad"))
    (found,), _ = read_demonstrations([path])
    assert_allclose(found.values, files.PATH)


def test_other_exports_of_qualisys_are_tables(tmp_path):
    text = "NO_OF_FRAMES\t400\nFREQUENCY\t50\nDATA_INCLUDED\tAngle\n\n" + files.lines(
        files.TIME, files.PATH[:, 0], header="Time\tknee", delimiter="\t"
    )
    (found,), _ = read_demonstrations([files.write(tmp_path, text, "d.tsv").path])
    assert found.channels == ("knee",)
    assert_allclose(found.time, files.TIME)


def test_a_last_line_that_was_not_written_to_its_end_is_left_out(tmp_path):
    text = files.xyz(header="time,x,y,z").rpartition(",")[0]
    (found,), remarks = read_demonstrations([files.write(tmp_path, text).path])
    assert_allclose(found.values, files.PATH[:-1], atol=1e-12)
    assert remarks == ["d.csv: line 401, the last, is incomplete: left out"]


@pytest.mark.parametrize(
    "times", [{"tout": files.TIME}, {"Fs": files.RATE}, {"Ts": 1 / files.RATE}]
)
def test_times_and_rates_of_simulations_have_short_names(times, tmp_path):
    np.savez(tmp_path / "d.npz", xout=files.PATH, **times)
    (found,), _ = read_demonstrations([tmp_path / "d.npz"])
    assert_allclose(found.time, files.TIME)
    assert_allclose(found.values, files.PATH)


@pytest.mark.parametrize("name", ["date", "Tiempo", "Temps [s]", "epoch"])
def test_times_have_names_of_other_languages_or_that_of_the_date(name, tmp_path):
    text = files.xyz(1.7e9 + files.TIME, header=f"{name},x,y,z")
    (found,), _ = read_demonstrations([files.write(tmp_path, text).path])
    assert found.channels == ("x", "y", "z")
    assert_allclose(found.time, files.TIME, atol=1e-6)
    # Beside a time they are something else, such as the tempo of a drummer.
    beside = files.lines(
        1.7e9 + 2 * files.TIME, files.TIME, *files.PATH.T, header=f"{name},time,x,y,z"
    )
    (found,), _ = read_demonstrations([files.write(tmp_path, beside).path])
    assert len(found.channels) == 4
    assert_allclose(found.time, files.TIME)


@pytest.mark.parametrize(
    "names", ["{},time", "{},clock [s]", ",{}", "time,{}", "clock [s],{}"]
)
@pytest.mark.parametrize("other", ["date", "temps", "goal.time_from_start"])
def test_another_time_is_read_before_words_that_mean_something_else(
    names, other, tmp_path
):
    others = files.TIME % 3 if "start" in other else 20190806 + 2 * files.TIME
    both = [others, files.TIME] if names[0] == "{" else [files.TIME, others]
    text = files.lines(*both, *files.PATH.T, header=f"{names.format(other)},x,y,z")
    (found,), _ = read_demonstrations([files.write(tmp_path, text).path])
    assert_allclose(found.time, files.TIME)
    assert {*found.channels} == {other, "x", "y", "z"}


@pytest.mark.parametrize(
    ("name", "unit"),
    [("millis", 1e-3), ("elapsed_millis", 1e-3), ("ms", 1e-3), ("micros", 1e-6)],
)
def test_a_time_may_be_named_by_its_unit(name, unit, tmp_path):
    ticks = np.arange(len(files.TIME))
    text = files.xyz(ticks, header=f"{name},x,y,z")
    (found,), remarks = read_demonstrations([files.write(tmp_path, text).path])
    assert found.channels == ("x", "y", "z")
    assert_allclose(found.time, unit * ticks)
    assert f"the time is in {name.removeprefix('elapsed_')}" in remarks[0]


def test_a_clock_in_microseconds_may_be_named_utime(tmp_path):
    stamps = 1_400_000_000_000_000 + np.round(1e6 * files.TIME).astype(np.int64)
    text = files.xyz(stamps, header="utime,x,y,z")
    (found,), _ = read_demonstrations([files.write(tmp_path, text).path])
    assert_allclose(found.time, files.TIME)


@pytest.mark.parametrize("form", ["{:g} sec", "05-Mar-2021 10:59:{:09.6f}"])
def test_times_may_be_written_as_matlab_does(form, tmp_path):
    text = files.xyz(map(form.format, files.TIME), header="Time,x,y,z")
    (found,), _ = read_demonstrations([files.write(tmp_path, text).path])
    assert_allclose(found.time, files.TIME, atol=1e-6)
    assert_allclose(found.values, files.PATH)


@pytest.mark.parametrize("name", ["time", "Time (YYYY-MM-DD hh:mm:ss:ms)"])
def test_milliseconds_of_a_time_of_day_may_follow_a_colon(name, tmp_path):
    clock = [f"2019-08-06 10:25:{50 + t:06.3f}".replace(".", ":") for t in files.TIME]
    text = files.xyz(clock, header=f"{name},x,y,z")
    (found,), _ = read_demonstrations([files.write(tmp_path, text).path])
    assert_allclose(found.time, files.TIME, atol=1e-6)


@pytest.mark.parametrize("names", [["", "", "", ""], ["time", "x", "y", "z"]])
@pytest.mark.parametrize("delimiter", [",", " ", "\t"])
def test_samples_of_a_matrix_may_be_beside_one_another(names, delimiter, tmp_path):
    rows = [files.TIME, *files.PATH.T]
    cells = [
        [name] * bool(name) + [*map(repr, map(float, row))]
        for name, row in zip(names, rows, strict=True)
    ]
    text = "".join(f"{delimiter.join(row)}\n" for row in cells)
    (found,), remarks = read_demonstrations([files.write(tmp_path, text).path])
    assert found.channels == ("x", "y", "z")
    assert_allclose(found.values, files.PATH)
    assert_allclose(found.time, files.TIME)
    assert "each line is a channel" in remarks[0]
    columns = ReadingOptions.parse("time=1,x=2,y=4")
    (found,), _ = read_demonstrations([files.write(tmp_path, text).path], columns)
    assert_allclose(found.values, files.PATH[:, [0, 2]])


@pytest.mark.parametrize("form", ["comment", "no names", "a name is missing"])
def test_few_samples_of_many_columns_are_not_channels(form, tmp_path):
    time = files.TIME[:19]
    markers = np.random.default_rng(1).normal(size=(60, 19))
    names = ["time", *(f"m{i}" for i in range(60))]
    if form == "a name is missing":
        names[1] = ""
    header = {"comment": "# ", "no names": None}.get(form, "")
    header = header if header is None else header + ",".join(names)
    text = files.lines(time, *markers, header=header)
    (found,), _ = read_demonstrations([files.write(tmp_path, text).path])
    assert_allclose(found.time, time)
    assert_allclose(found.values, markers.T)


@pytest.mark.parametrize("delimiter", [",", " "])
def test_a_line_of_a_channel_may_be_long(delimiter, tmp_path):
    channels = np.vstack([np.arange(9000) / 100, np.ones((3, 9000)) / 3])
    text = "".join(f"{delimiter.join(map(repr, row))}\n" for row in channels.tolist())
    assert len(text) > 4 * 131072  # Python's limit of a cell.
    (found,), _ = read_demonstrations([files.write(tmp_path, text).path])
    assert_allclose(found.time, channels[0])
    assert_allclose(found.values, channels[1:].T)


def test_samples_may_be_numbered_before_a_time_without_a_name(tmp_path):
    numbers = np.arange(len(files.TIME))
    text = files.lines(numbers, files.TIME, *files.PATH.T, *files.QUATERNIONS.T)
    (found,), remarks = read_demonstrations([files.write(tmp_path, text).path])
    assert found.channels == ("x", "y", "z", "rx", "ry", "rz")
    assert_allclose(found.time, files.TIME)
    assert "column 2, which increases, is taken for the time" in remarks[0]
    # Nothing says that the second one is the time where its steps differ.
    text = files.lines(numbers, files.TIME**3, *files.PATH.T)
    with pytest.raises(FmpError, match="no column holds the time"):
        read_demonstrations([files.write(tmp_path, text).path])


@pytest.mark.parametrize(
    "columns", ["index, count, time", "milliseconds, line", "encoder, time"]
)
def test_no_time_is_taken_from_counters_or_behind_a_time(columns, tmp_path):
    numbers = np.arange(len(files.TIME))
    first = {
        "index, count, time": (numbers, numbers + 1, files.TIME),
        "milliseconds, line": (20 * numbers, 0.05 * files.TIME),
        "encoder, time": (1000 * numbers + 900 * (numbers % 2), files.TIME),
    }[columns]
    text = files.lines(*first, *files.PATH.T)
    with pytest.raises(FmpError, match=r"no column holds the time; .* time="):
        read_demonstrations([files.write(tmp_path, text).path])


@pytest.mark.parametrize(
    ("start", "unit"), [(3e8, 1e-9), (0, 1e-6), (1.7e12, 1e-3), (1.7e18, 1e-9)]
)
def test_whole_numbers_without_a_name_may_be_stamps(start, unit, tmp_path):
    stamps = np.round(files.TIME / unit).astype(np.int64) + int(start)
    matrices = np.tile(np.eye(4), (len(stamps), 1, 1))
    matrices[:, :3, 3] = files.PATH
    text = files.lines(stamps, *matrices.reshape(-1, 16).T, delimiter=" ")
    (found,), remarks = read_demonstrations([files.write(tmp_path, text).path])
    assert found.channels[:3] == ("x", "y", "z")
    assert_allclose(found.time - found.time[0], files.TIME, atol=1e-6)
    assert_allclose(found.values[:, :3], files.PATH, atol=1e-12)
    assert "column 2 to column 17 are a pose" in remarks[0]
    assert "column 1, which increases, is taken for the time" in remarks[0]


@pytest.mark.parametrize("pauses", [1, 4])
def test_a_movement_that_pauses_a_few_times_does_not_come_in_bursts(pauses, tmp_path):
    samples = np.arange(8 * (pauses + 1))
    time = 0.1 * samples + 10 * (samples // 8)
    text = files.xyz(time, files.PATH[: len(time)], header="time,x,y,z")
    (found,), remarks = read_demonstrations([files.write(tmp_path, text).path])
    assert_allclose(found.time, time)
    assert f"not bridged: {pauses}" in remarks[0]


def test_names_of_rows_may_end_with_a_colon(tmp_path):
    rows = [f"sample {i}:" for i in range(len(files.TIME))]
    text = files.lines(rows, files.TIME, *files.PATH.T, header="row,time,x,y,z")
    (found,), _ = read_demonstrations([files.write(tmp_path, text).path])
    assert_allclose(found.values, files.PATH)


@pytest.mark.parametrize("header", [PLATE, PLATE.replace(":", "")])
def test_properties_of_the_columns_of_a_force_plate_are_before_the_numbers(
    header, tmp_path
):
    text = files.lines(
        files.TIME, *files.FORCE.T, 0 * files.TIME, delimiter="\t", header=header
    )
    (found,), _ = read_demonstrations([files.write(tmp_path, text).path])
    assert found.channels == ("force_x", "force_y", "force_z", "Mx")
    assert found.units == ("N", "N", "N", "N m")
    assert_allclose(found.values[:, :3], files.FORCE)


@pytest.mark.parametrize("count", [2, 3, 6])
@pytest.mark.parametrize("form", ["list", "lines"])
def test_joint_states_in_json_have_the_names_of_their_joints(form, count, tmp_path):
    names = [f"{word}_joint" for word in ("elbow", "lift", "pan", "a", "b", "c")]
    names = names[:count]
    states = [
        {
            "time": float(t),
            "name": names,
            "position": [*q[:count]],
            "velocity": [0.0] * count,
        }
        for t, q in zip(files.TIME, files.JOINTS, strict=True)
    ]
    lines = [json.dumps(state) for state in states]
    text = "\n".join(lines) if form == "lines" else f"[{','.join(lines)}]"
    path = files.write(tmp_path, text, name="d.json").path
    (found,), remarks = read_demonstrations([path])
    assert found.channels == tuple(names)
    assert_allclose(found.values, files.JOINTS[:, :count])
    assert "name" not in remarks[0]


def test_messages_in_yaml_are_read_as_they_are_printed(tmp_path):
    path, _ = files.ros2_topic_echo_of_joints(tmp_path)
    (found,), _ = read_demonstrations([path])
    assert found.channels == tuple(f"joint_{i}" for i in range(1, 8))
    assert_allclose(found.time - found.time[0], files.TIME, atol=1e-6)
    assert_allclose(found.values[:, 2], 1e-5 * (1 + files.JOINTS[:, 2]), rtol=0.4)
    assert_allclose(found.values[:, 3], files.JOINTS[:, 3], rtol=0.4)
    _, remarks = read_demonstrations([files.rostopic_echo_in_yaml(tmp_path).path])
    assert "2 broken documents left out" in remarks[0]
    (found,), _ = read(files.odometry_in_yaml, tmp_path)
    assert found.channels == ("x", "y", "z")
    assert_allclose(found.values, files.PATH, atol=1e-12)


@pytest.mark.parametrize("form", ["npz", "json", "yaml"])
def test_joint_names_beside_arrays_name_their_columns(form, tmp_path):
    names = [f"{word}_joint" for word in ("elbow", "lift", "pan", "a", "b", "c")]
    angles, path = files.JOINTS[:, :6], tmp_path / f"d.{form}"
    points = [
        {"positions": q.tolist(), "velocities": [0.0] * 6, "time_from_start": float(t)}
        for t, q in zip(files.TIME, angles, strict=True)
    ]
    content = {"joint_names": names, "points": points}
    if form == "npz":
        rates = np.zeros_like(angles)
        np.savez(path, t=files.TIME, joint_names=names, q=angles, velocities=rates)
    else:
        path.write_text((yaml.dump if form == "yaml" else json.dumps)(content))
    (found,), remarks = read_demonstrations([path])
    assert found.channels[:6] == tuple(names)
    assert found.units[:6] == ("rad",) * 6
    assert_allclose(found.values[:, :6], angles)
    assert_allclose(found.time, files.TIME, atol=1e-9)
    assert not any("joint_names" in remark for remark in remarks)


@pytest.mark.parametrize("names", ["joint_names", "names"])
@pytest.mark.parametrize(
    ("words", "arrays"),
    [
        (["cup", "plate", "hand"], {"positions": files.PATH}),
        (["waist", "shoulder", "elbow"], {"q": 100 * files.PATH}),
        (["joint"] * 7, {"q": files.JOINTS}),
        ([f"joint_{i}" for i in range(6)], {"q": files.JOINTS}),
        (
            [f"joint_{i}" for i in range(7)],
            {"left.q": files.JOINTS, "right.q": 2 * files.JOINTS},
        ),
    ],
)
def test_names_that_may_not_be_those_of_the_joints_are_left_out(
    names, words, arrays, tmp_path
):
    for name, extra in (("a", {}), ("b", {names: words})):
        np.savez(tmp_path / name, t=files.TIME, **arrays, **extra)
    (expected,), before = read_demonstrations([tmp_path / "a.npz"])
    (found,), remarks = read_demonstrations([tmp_path / "b.npz"])
    assert (found.channels, found.units) == (expected.channels, expected.units)
    assert_allclose(found.values, expected.values)
    assert f"{names} " in remarks[0]
    for part in before:
        assert part.removeprefix("a.npz: ") in remarks[0]


def test_joint_names_leave_velocities_and_commands_as_they_are(tmp_path):
    words = [f"arm_joint_{i}" for i in range(7)]
    arrays = {"position": files.JOINTS, "velocity": 0 * files.JOINTS}
    np.savez(tmp_path / "a.npz", t=files.TIME, name=words, **arrays)
    (found,), remarks = read_demonstrations([tmp_path / "a.npz"])
    assert found.channels == tuple(words)
    assert "velocities and efforts of joints left out" in remarks[0]
    arrays = {"desired.positions": files.JOINTS + 1, "actual.positions": files.JOINTS}
    np.savez(tmp_path / "b.npz", t=files.TIME, joint_names=words, **arrays)
    (found,), _ = read_demonstrations([tmp_path / "b.npz"])
    assert_allclose(found.select(words).values, files.JOINTS)


def test_a_key_in_one_object_only_takes_no_memory_for_the_others(tmp_path):
    step = 2 * np.pi / 100
    rows = [
        {
            "t": k / 20,
            "x": np.cos(k * step),
            "y": np.sin(k * step),
            "z": 0.0,
            f"id{k}": k,
        }
        for k in range(5000)
    ]
    path = files.write(tmp_path, json.dumps(rows), "d.json").path
    tracemalloc.start()
    demonstration = Demonstration.load(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert demonstration.values.shape == (5000, 3)
    # A column for each key has 200 MB.
    assert peak < 60e6


@pytest.mark.parametrize("every", [50, 150])
def test_a_position_that_is_rare_beside_other_values_is_not_ignored(tmp_path, every):
    rows = [{"t": k / 20, "force": 5.0 + np.sin(k / 9)} for k in range(3000)]
    for row in rows[::every]:
        row |= {"x": np.cos(row["t"]), "y": np.sin(row["t"]), "z": 0.1}
    path = files.write(tmp_path, json.dumps(rows), "d.json").path
    with pytest.raises(FmpError, match="samples have no value of x, y, z"):
        Demonstration.load(path)


def test_stamps_in_seconds_and_nanoseconds_are_exact(tmp_path):
    whole, nanoseconds = np.divmod(files.STAMPS, 10**9)
    names = "header.stamp.sec,header.stamp.nanosec,x,y,z"
    text = files.lines(whole, nanoseconds, *files.PATH.T, header=names)
    (found,), _ = read_demonstrations([files.write(tmp_path, text).path])
    assert_allclose(found.time, files.TIME, atol=1e-10)


def test_stamps_that_were_never_set_are_not_the_time(tmp_path):
    columns = (np.zeros(400), files.TIME, *files.PATH.T)
    text = files.lines(*columns, header="stamp,time,x,y,z")
    (found,), _ = read_demonstrations([files.write(tmp_path, text).path])
    assert_allclose(found.time, files.TIME, atol=1e-12)


@pytest.mark.parametrize(("gap", "is_bridged"), [(0.49, True), (0.51, False)])
def test_gaps_up_to_half_a_second_are_bridged(gap, is_bridged, tmp_path):
    time = files.TIME + (np.arange(400) > 200) * (gap - 0.02)
    text = files.xyz(time=time, header="time,x,y,z")
    _, remarks = read_demonstrations([files.write(tmp_path, text).path])
    assert any("not bridged: 1" in remark for remark in remarks) != is_bridged


@pytest.mark.parametrize("jump", [0.2, -0.5])
@pytest.mark.parametrize(
    "rows", [[0], [1], [0, 1], [100, 102, 250], [60, 61, 62], [399]]
)
def test_positions_that_jump_away_and_back_are_left_out(rows, jump, tmp_path):
    path = files.PATH.copy()
    path[rows, 1] += jump
    text = files.lines(files.TIME, *path.T, header="time,x,y,z")
    (found,), (remark,) = read_demonstrations([files.write(tmp_path, text).path])
    kept = np.delete(np.arange(400), rows)
    assert_allclose(found.time, files.TIME[kept], atol=1e-12)
    assert_allclose(found.values, files.PATH[kept], atol=1e-9)
    assert f"{len(rows)} sample" in remark
    (largest,) = re.findall(r"jumps, by up to (\S+) m", remark)
    assert float(largest) == pytest.approx(abs(jump), abs=0.02)


def test_one_sample_far_away_does_not_question_the_unit(tmp_path):
    path = files.PATH.copy()
    path[100] += 100.0
    text = files.lines(files.TIME, *path.T, header="time,x,y,z")
    _, (remark,) = read_demonstrations([files.write(tmp_path, text).path])
    assert "jumps, by up to 173 m" in remark


@pytest.mark.parametrize("change", ["step", "long", "noise", "often"])
def test_other_changes_of_the_position_are_kept(change, tmp_path):
    path = files.PATH.copy()
    rng = np.random.default_rng(0)
    if change == "step":
        path[200:] += 0.3
    elif change == "long":
        path[200:204] += 0.3
    elif change == "noise":
        path += 0.05 * rng.standard_normal(path.shape)
    else:
        path[rng.choice(400, 40, replace=False)] += 0.3
    text = files.lines(files.TIME, *path.T, header="time,x,y,z")
    (found,), remarks = read_demonstrations([files.write(tmp_path, text).path])
    assert_allclose(found.values, path, atol=1e-9)
    assert not remarks


@pytest.mark.parametrize(
    ("name", "in_degrees", "factor"),
    [
        ("Coordinates", "yes", np.pi / 180),
        ("Coordinates", "no", 1.0),
        ("forces", "yes", 1),
    ],
)
def test_angles_of_opensim_have_the_unit_of_the_header(
    name, in_degrees, factor, tmp_path
):
    head = f"{name}\nversion=1\nnRows=400\ninDegrees={in_degrees}\nendheader\n"
    columns = "time\tpelvis_tx\thip_flexion_r\tknee_angle_l"
    text = files.lines(files.TIME, *files.PATH.T, header=columns, delimiter="\t")
    path = tmp_path / "ik.mot"
    path.write_text(head + text)
    (found,), _ = read_demonstrations([path])
    is_known = name == "Coordinates"
    assert found.units == (("1", "rad", "rad") if is_known else ("1", "1", "1"))
    assert_allclose(found.values[:, 0], files.PATH[:, 0], atol=1e-9)
    assert_allclose(found.values[:, 1:], factor * files.PATH[:, 1:], atol=1e-9)


@pytest.mark.parametrize("names", ["px,py,pz", "tx,ty,tz", "x,y,z", "X,Y,Z"])
def test_positions_in_a_file_of_opensim_are_no_angles(names, tmp_path):
    head = "Coordinates\nversion=1\nnRows=400\ninDegrees=yes\nendheader\n"
    text = head + files.xyz(header=f"time,{names}")
    (found,), _ = read_demonstrations([files.write(tmp_path, text, "ik.mot").path])
    assert (found.channels, found.units) == (("x", "y", "z"), ("m", "m", "m"))
    assert_allclose(found.values, files.PATH, atol=1e-9)


def test_components_of_a_force_have_standard_names(tmp_path):
    columns = (files.TIME, *files.PATH.T, *files.PATH.T)
    text = files.lines(*columns, header="time,x,y,z,fx,fy,fz")
    (found,), _ = read_demonstrations([files.write(tmp_path, text).path])
    assert found.channels == ("x", "y", "z", "force_x", "force_y", "force_z")
    assert found.units[3:] == ("N", "N", "N")


@pytest.mark.parametrize(
    ("make", "rows", "said"),
    [
        (files.values_missing, [8], "1 sample without a value of z left out"),
        (
            files.broken_lines,
            [8],
            "1 broken line left out .line 9: 2 cells instead of 4",
        ),
        (files.broken_lines, [7, 8, 9], r"3 broken lines left out .line 8: "),
    ],
)
def test_few_broken_rows_are_left_out(make, rows, said, tmp_path):
    (found,), remarks = read_demonstrations([make(tmp_path, rows).path])
    kept = np.delete(np.arange(400), np.array(rows) - 1)
    assert_allclose(found.values, files.PATH[kept], atol=1e-12)
    assert_allclose(found.time, files.TIME[kept], atol=1e-12)
    assert re.search(said, remarks[0])


def test_topics_in_rows_of_their_own_are_interpolated_at_the_times_of_the_position(
    tmp_path,
):
    (found,), (remark,) = read_demonstrations(
        [files.two_topics_in_a_table(tmp_path).path]
    )
    joints = [f"/joint_states/panda_joint{i}/position" for i in range(1, 8)]
    assert "interpolated at the times of the position" in remark
    # Before the first row of the joints nothing is known of them.
    assert_allclose(found.time, files.TIME[1:], atol=1e-12)
    assert_allclose(found.select(["x", "y", "z"]).values, files.PATH[1:], atol=1e-12)
    known = [
        np.interp(files.TIME[1:], files.TIME + 0.004, q) for q in files.JOINTS[:400].T
    ]
    assert_allclose(found.select(joints).values, np.transpose(known), atol=1e-9)


@pytest.mark.parametrize("every", [2, 5, 40])
def test_a_slower_position_is_read_with_the_mean_of_the_force(every, tmp_path):
    force = np.where(np.arange(400) % 2, 9.0, 11.0)
    placed = np.where(np.arange(400)[:, None] % every, np.nan, files.PATH)
    text = files.lines(files.TIME, *placed.T, force, header="time,x,y,z,force")
    file = files.write(tmp_path, text.replace("nan", ""))
    if every == 40:  # 0.8 s
        with pytest.raises(FmpError, match=r"390 of .* x, y, z; a position .* 0\.5 s"):
            read_demonstrations([file.path])
        return
    (found,), remarks = read_demonstrations([file.path])
    count = 400 - 400 // every
    remark = f"{count} samples without a position left out, of faster sensors"
    assert remark in remarks[0]
    path = files.PATH[::every]
    assert_allclose(found.select(["x", "y", "z"]).values, path, atol=1e-12)
    assert_allclose(found.select(["force"]).values, 10.0, atol=0.5)


@pytest.mark.parametrize("every", [5, 40])
def test_a_slower_force_is_interpolated_but_not_over_gaps(every, tmp_path):
    force = np.round(10 + 3 * np.sin(files.TIME), 6)
    rows = ["time,x,y,z,force"]
    for i, (t, p) in enumerate(
        zip(files.TIME.tolist(), files.PATH.tolist(), strict=True)
    ):
        value = "" if i % every else repr(float(force[i]))
        rows.append(",".join([*map(repr, [t, *p]), value]))
    file = files.write(tmp_path, "\n".join(rows))
    if every == 40:  # 0.8 s
        with pytest.raises(FmpError, match="390 of 400 samples have no value of force"):
            read_demonstrations([file.path])
        return
    (found,), _ = read_demonstrations([file.path])
    assert len(found.time) == 396
    assert_allclose(found.values[:, 3], force[:396], atol=0.01)


def test_a_row_that_is_left_out_does_not_move_the_others_in_time(tmp_path):
    file = files.values_missing(tmp_path, [8])
    (found,), _ = read_demonstrations(
        [file.path], ReadingOptions(sample_rate=files.RATE)
    )
    assert_allclose(found.time, np.delete(files.TIME, 7), atol=1e-12)


def test_broken_lines_can_be_deleted_with_the_given_command(tmp_path):
    file = files.broken_lines(tmp_path).path
    with pytest.raises(FmpError) as refusal:
        read_demonstrations([file])
    subprocess.run(shlex.split(str(refusal.value).partition("them: ")[2]), check=True)
    (found,), _ = read_demonstrations([file])
    assert len(found.time) == 400 - 12


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("field.{}{}", []),
        ("{}_{}", [f"panda_joint{i}" for i in range(1, 8)]),
        ("/joint_states/panda_joint{1}/{0}", []),
    ],
)
def test_positions_of_joint_states_in_a_table_are_read(name, words, tmp_path):
    file = files.joint_states(tmp_path, name, words=words)
    (found,), remarks = read_demonstrations([file.path])
    assert len(found.channels) == 7
    assert all(channel in name or "joint" in channel for channel in found.channels)
    assert not words or found.channels == tuple(words)
    assert set(found.units) == {"rad"}
    assert_allclose(found.values, files.JOINTS, atol=1e-12)
    assert "velocities and efforts of joints left out" in remarks[0]


def test_numbered_positions_without_names_may_be_degrees(tmp_path):
    degrees = np.rad2deg(files.JOINTS)
    kinds = [f"{kind}_{i}" for kind in ("Position", "Velocity") for i in range(7)]
    text = files.lines(
        files.TIME, *degrees.T, *degrees.T, header=",".join(["t", *kinds])
    )
    (found,), (remark,) = read_demonstrations([files.write(tmp_path, text).path])
    assert found.channels == tuple(f"joint_{i}" for i in range(1, 8))
    assert_allclose(found.values, files.JOINTS)
    assert "joint_7 reach 143 and are taken for degrees" in remark


@pytest.mark.parametrize("others", [[], ["measured"]])
def test_measured_positions_of_joints_are_read_before_commanded_ones(others, tmp_path):
    kinds = ["commanded", *others]
    names = [f"{kind}_joint_position_{i}" for kind in kinds for i in range(7)]
    columns = [(files.JOINTS + 0.01 * (kind == "commanded")).T for kind in kinds]
    text = files.lines(files.TIME, *np.vstack(columns), header=",".join(["t", *names]))
    (found,), _ = read_demonstrations([files.write(tmp_path, text).path])
    read_joints = found.select([f"joint_{i}" for i in range(1, 8)]).values
    assert_allclose(read_joints, files.JOINTS + 0.01 * (not others))


def test_forces_of_a_universal_robot_are_read_beside_its_pose(tmp_path):
    (found,), remarks = read_demonstrations([files.ur_rtde(tmp_path).path])
    assert "TCP_force_0 to actual_TCP_force_5 are a force and a torque" in remarks[0]
    assert "target_tcp_pose_qw left out: commanded, not measured" in remarks[0]
    assert_allclose(found.select(["x", "y", "z"]).values, files.PATH, atol=1e-12)
    vectors = found.select(["rx", "ry", "rz"]).values
    turned = rotations_of(vectors, found.rotation_reference)
    assert np.max((turned * files.TURNS.inv()).magnitude()) < 1e-6
    units = dict(zip(found.channels, found.units, strict=True))
    assert [units[f"force_{a}"] for a in "xyz"] == ["N"] * 3
    assert_allclose(found.select(["force_x"]).values[:, 0], 10 * files.PATH[:, 0])
    assert units["actual_q_5"] == "rad"
    assert units["actual_tcp_torque_z"] == "Nm"


@pytest.mark.parametrize(
    ("other", "is_force"),
    [
        *[(name, True) for name in ("O_F_ext", "F_ext_hat_K", "fext", "ft")],
        *[(name, True) for name in ("ft_sensor", "ft300")],
        *[(name, False) for name in ("O_T_ext", "tcp_speed", "pos_err", "stiffness")],
        *[(name, False) for name in ("imu_link", "joystick")],
        *[(name, False) for name in ("base_omegadot", "reaction", "momentum")],
    ],
)
def test_forces_speeds_and_errors_are_no_positions(other, is_force, tmp_path):
    names = [f"{name}_{axis}" for name in (other, "tcp_pose") for axis in "xyz"]
    text = files.lines(
        files.TIME, *files.FORCE.T, *files.PATH.T, header=",".join(["t", *names])
    )
    (found,), _ = read_demonstrations([files.write(tmp_path, text).path])
    forces = ["force_x", "force_y", "force_z"] if is_force else names[:3]
    assert found.channels == (*forces, "x", "y", "z")
    assert_allclose(found.select(["x", "y", "z"]).values, files.PATH)


@pytest.mark.parametrize("frame", ["w", "b"])
def test_a_position_may_name_its_frame(frame, tmp_path):
    axes = [f"ee_pos_{frame}_{axis}" for axis in "xyz"]
    turns = [f"ee_quat_{frame}_{axis}" for axis in "xyzw"]
    columns = (files.TIME, *files.PATH.T, *files.QUATERNIONS.T)
    text = files.lines(*columns, header=",".join(["t", *axes, *turns]))
    (found,), _ = read_demonstrations([files.write(tmp_path, text).path])
    assert found.channels == ("x", "y", "z", "rx", "ry", "rz")
    assert found.units[:3] == ("m", "m", "m")


def test_pixels_beside_a_position_keep_a_name_of_their_own(tmp_path):
    pixels = 1e3 * files.PATH[:, 1:]
    columns = (files.TIME, *pixels.T, *files.PATH.T)
    text = files.lines(*columns, header="t,x,y,tcp_x,tcp_y,tcp_z")
    (found,), _ = read_demonstrations([files.write(tmp_path, text).path])
    assert found.channels == ("other x", "other y", "x", "y", "z")
    assert_allclose(found.values, np.hstack([pixels, files.PATH]))


@pytest.mark.parametrize("name", ["Kraft", "Fuerza", "Last"])
def test_three_components_in_newtons_are_a_force_in_any_language(name, tmp_path):
    names = ["Weg X [mm]", "Weg Y [mm]", "Weg Z [mm]"]
    names += [f"{name} {axis} [N]" for axis in "XYZ"]
    columns = (files.TIME, *1e3 * files.PATH.T, *files.FORCE.T)
    text = files.lines(*columns, header=",".join(["Zeit [s]", *names]))
    (found,), _ = read_demonstrations([files.write(tmp_path, text).path])
    assert found.channels == ("x", "y", "z", "force_x", "force_y", "force_z")
    assert_allclose(found.values, np.hstack([files.PATH, files.FORCE]))


def test_of_several_positions_that_of_the_tool_is_suggested(tmp_path):
    groups = ("tool_target", "marker", "tool")
    names = [f"{name}_{axis}" for name in groups for axis in "xyz"]
    text = files.lines(files.TIME, *[*files.PATH.T] * 3, header=",".join(["t", *names]))
    _, (remark,) = read_demonstrations([files.write(tmp_path, text).path])
    assert remark.endswith("choose with --columns x=tool_x,y=tool_y,z=tool_z")


def test_a_marker_named_c_is_not_mistaken_for_a_command(tmp_path):
    names = [f"{marker}_{axis}" for marker in "bc" for axis in "xyz"]
    text = files.lines(
        files.TIME, *files.PATH.T, *files.PATH.T, header=",".join(["t", *names])
    )
    (found,), remarks = read_demonstrations([files.write(tmp_path, text).path])
    assert found.channels == tuple(names)
    assert "several positions (b_x, c_x ...)" in remarks[0]


def test_angles_beyond_two_revolutions_are_read_as_degrees(tmp_path):
    angles = np.column_stack([3 * np.sin(files.TIME), 90 + files.TIME])
    text = files.lines(files.TIME, *angles.T, header="time,roll,joint_1")
    (found,), remarks = read_demonstrations([files.write(tmp_path, text).path])
    assert_allclose(found.values, np.deg2rad(angles), atol=1e-12)
    assert "roll, joint_1 reach 98 and are taken for degrees" in remarks[0]
    text = files.lines(files.TIME, angles[:, 1], header="time,joint_1 [rad]")
    (found,), _ = read_demonstrations([files.write(tmp_path, text).path])
    assert_allclose(found.values[:, 0], angles[:, 1], atol=1e-12)


def test_a_rotation_vector_is_an_orientation(tmp_path):
    swing = 0.2 * np.sin(files.TIME)
    rotations = Rotation.from_euler(
        "zx", np.column_stack([0 * swing + 0.3, np.pi + swing])
    )
    vectors = rotations.as_rotvec()
    # The angle passes half a turn, where the vector changes its sign.
    assert np.max(np.abs(np.diff(vectors, axis=0))) > 6
    text = files.lines(files.TIME, *vectors.T, header="time,rx,ry,rz")
    (found,), remarks = read_demonstrations([files.write(tmp_path, text).path])
    errors = rotations_of(found.values, found.rotation_reference) * rotations.inv()
    assert np.max(errors.magnitude()) < 1e-6
    assert "rx, ry, rz read as a rotation vector" in remarks[0]


def test_angles_that_jump_by_a_revolution_are_continued(tmp_path):
    roll = 180 + 20 * np.sin(files.TIME)
    text = files.lines(files.TIME, (roll + 180) % 360 - 180, header="time,roll [deg]")
    (found,), remarks = read_demonstrations([files.write(tmp_path, text).path])
    turns = (found.values[:, 0] - np.deg2rad(roll)) / (2 * np.pi)
    assert_allclose(turns, round(turns[0]), atol=1e-9)
    assert "roll unwrapped where they jump by a revolution" in remarks[0]


@pytest.mark.parametrize(("step", "is_continued"), [(4.8, True), (4.6, False)])
def test_an_angle_continues_from_three_quarters_of_a_revolution(
    step, is_continued, tmp_path
):
    roll = np.where(files.TIME < 4, 0.1, 0.1 - step)
    text = files.lines(files.TIME, roll, header="time,roll [rad]")
    (found,), _ = read_demonstrations([files.write(tmp_path, text).path])
    turns = (found.values[-1, 0] - roll[-1]) / (2 * np.pi)
    assert turns == pytest.approx(1.0 if is_continued else 0.0)


def test_the_rate_that_is_advised_for_whole_seconds_is_the_rate(tmp_path):
    rows = [f"{i // 100},{np.sin(0.02 * i)}" for i in range(2000)]
    path = files.write(tmp_path, "\n".join(["time,x", *rows])).path
    with pytest.raises(FmpError, match=r"--sample-rate 100$"):
        read_demonstrations([path])


@pytest.mark.parametrize(("unit", "metres"), [("in", 0.0254), ("Feet", 0.3048)])
def test_a_row_of_units_may_be_imperial(tmp_path, unit, metres):
    rows = [f"{t},{t},{2 * t},0" for t in files.TIME]
    text = "\n".join(["time,x,y,z", f"Seconds,{unit},{unit},{unit}", *rows])
    (found,), _ = read_demonstrations([files.write(tmp_path, text).path])
    assert_allclose(found.values[:, 1], 2 * metres * files.TIME)


def test_joints_of_a_dataset_have_one_unit(tmp_path):
    pytest.importorskip("pyarrow")
    names = ["shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll"]
    file = files.dataset(tmp_path, "v3.0", names, files.JOINTS[:, :5])
    found, _ = read_demonstrations([file.path])
    assert found[0].channels == tuple(names)
    assert set(found[0].units) == {"1"}


@pytest.mark.parametrize(
    ("factor", "header", "unit", "is_questioned"),
    [
        (1000, "time,x,y,z", "", True),
        (1000, "time,x,y,z", "m", False),
        (1000, "time,x [mm],y [mm],z [mm]", "", False),
        (1, "time,x,y,z", "", False),
    ],
)
def test_a_path_too_wide_in_metres_has_a_remark(
    factor, header, unit, is_questioned, tmp_path
):
    text = files.lines(files.TIME, *factor * files.PATH.T, header=header)
    path = files.write(tmp_path, text).path
    _, remarks = read_demonstrations([path], ReadingOptions(unit=unit))
    assert any("m wide" in remark for remark in remarks) == is_questioned
    (right,), _ = read_demonstrations([path], ReadingOptions(unit="mm"))
    if is_questioned:
        assert "such as --unit mm" in remarks[0]
        np.testing.assert_allclose(right.values, files.PATH, atol=1e-6)


@pytest.mark.parametrize("order", ["xyzw", "wxyz"])
def test_a_quaternion_in_numbered_columns_has_the_stated_order(order, tmp_path):
    quaternions = np.roll(files.QUATERNIONS, 1 if order == "wxyz" else 0, axis=1)
    columns = (files.TIME, *files.PATH.T, *quaternions.T)
    text = files.lines(*columns, header="time,x,y,z,q0,q1,q2,q3")
    path = files.write(tmp_path, text).path
    (found,), remarks = read_demonstrations([path], ReadingOptions(quaternions=order))
    turned = rotations_of(found.values[:, 3:], found.rotation_reference)
    assert np.max((turned * files.TURNS.inv()).magnitude()) < 1e-6
    assert f"the quaternion from q0 is read as {', '.join(order)}" in remarks[0]
    assert "if it is" not in remarks[0]
    _, remarks = read_demonstrations([path])
    assert "x, y, z, w; if it is w, x, y, z, add --quaternions wxyz" in remarks[0]


@pytest.mark.parametrize("name", ["Gyr_{}", "gyr{}", "Gyro_{}", "imu_gyr_{}"])
def test_angular_rates_of_a_gyroscope_are_no_position(name, tmp_path):
    header = ",".join(["time", *map(name.format, "XYZ")])
    columns = (files.TIME, *files.PATH.T, *files.QUATERNIONS.T)
    text = files.lines(*columns, header=f"{header},qx,qy,qz,qw")
    (found,), _ = read_demonstrations([files.write(tmp_path, text).path])
    assert found.channels == (*map(name.format, "XYZ"), "rx", "ry", "rz")


def test_a_column_with_one_value_is_left_out(tmp_path):
    text = files.lines(files.TIME, *files.PATH.T, header="time,x,y,z,start")
    first, second, rest = text.split("\n", 2)
    rows = [f"{line}," for line in rest.splitlines()]
    text = "\n".join([first, f"{second},1755022819.805", *rows])
    (found,), remarks = read_demonstrations([files.write(tmp_path, text).path])
    assert found.channels == ("x", "y", "z")
    assert_allclose(found.values, files.PATH)
    assert "start left out: less than 2 values" in remarks[0]


@pytest.mark.parametrize(
    ("name", "count"),
    [
        *((name, n) for name in ("tcp", "actual_tcp", "ee", "eef") for n in (3, 6)),
        ("pose", 6),
    ],
)
def test_numbered_columns_of_a_tool_begin_with_a_position(name, count, tmp_path):
    header = ",".join(["time", *(f"{name}_{i}" for i in range(count))])
    columns = (files.TIME, *files.PATH.T, *(0.1 * files.PATH.T)[: count - 3])
    path = files.write(tmp_path, files.lines(*columns, header=header)).path
    (found,), remarks = read_demonstrations([path])
    assert found.channels == ("x", "y", "z")
    assert_allclose(found.values, files.PATH, atol=1e-12)
    assert ("angles that are not read" in " ".join(remarks)) == (count == 6)


def test_named_components_of_a_quaternion_need_no_order(tmp_path):
    file = files.tum(tmp_path).path
    found, _ = read_demonstrations([file], ReadingOptions(quaternions="wxyz"))
    expected, _ = read_demonstrations([file])
    assert np.array_equal(found[0].values, expected[0].values)


def test_a_refusal_for_a_missing_time_gives_an_option_that_works(tmp_path):
    text = files.lines(*files.PATH.T, files.TIME, header="x,y,z,when")
    path = files.write(tmp_path, text).path
    with pytest.raises(FmpError, match="--columns") as refusal:
        read_demonstrations([path])
    (option,) = shlex.split(str(refusal.value).partition("--columns ")[2])
    (found,), _ = read_demonstrations(
        [path], ReadingOptions.parse(f"{option},x=x,y=y,z=z")
    )
    assert_allclose(found.values, files.PATH, atol=1e-12)


def test_no_joint_is_advised_as_the_time(tmp_path):
    # It increases, but not steadily.
    rising = np.cumsum(1 + 10 * (files.TIME % 1 < 0.3))
    text = files.lines(rising, files.TIME % 0.7, header="joint_1,joint_2")
    with pytest.raises(FmpError, match="no column holds the time") as refusal:
        read_demonstrations([files.write(tmp_path, text).path])
    assert "--columns" not in str(refusal.value)


@pytest.mark.parametrize(
    "header", ["X,Y", "pos_x,pos_y", "x_pos,y_pos", "px,py", "X(mm),Y(mm)", "x_mm,y_mm"]
)
def test_a_table_may_hold_a_path_in_the_plane(header, tmp_path):
    text = files.lines(files.TIME, *files.PATH.T[:2], header=f"time,{header}")
    (found,), _ = read_demonstrations([files.write(tmp_path, text).path])
    assert (found.channels, found.units) == (("x", "y"), ("m", "m"))
    factor = 1e-3 if "mm" in header else 1.0
    assert_allclose(found.values, factor * files.PATH[:, :2], atol=1e-12)


@pytest.mark.parametrize(
    ("header", "channels"),
    [
        ("left_x,left_y", ("left_x", "left_y")),
        ("speed_x,speed_y", ("speed_x", "speed_y")),
        ("goal_x,goal_y", ("goal_x", "goal_y")),
        ("X,Y,joint_1,joint_2,joint_3,joint_4,joint_5,joint_6", ("X", "Y")),
    ],
)
def test_other_pairs_of_columns_are_no_path_in_the_plane(header, channels, tmp_path):
    columns = np.tile(files.PATH[:, :2], 4).T[: header.count(",") + 1]
    text = files.lines(files.TIME, *columns, header=f"time,{header}")
    (found,), _ = read_demonstrations([files.write(tmp_path, text).path])
    assert found.channels[:2] == channels


@pytest.mark.parametrize(
    ("unit", "factor"),
    [
        ("meters", 1.0),
        ("millimeters", 1e-3),
        ("in_centimetres", 0.01),
        ("inch", 0.0254),
    ],
)
def test_a_name_may_end_with_a_unit_in_full(unit, factor, tmp_path):
    header = ",".join(f"{axis}_{unit}" for axis in "xyz")
    text = files.xyz(path=files.PATH / factor, header=f"time_seconds,{header}")
    (found,), _ = read_demonstrations([files.write(tmp_path, text).path])
    assert (found.channels, found.units) == (("x", "y", "z"), ("m", "m", "m"))
    assert_allclose(found.values, files.PATH, atol=1e-12)


def test_an_angle_in_degrees_by_its_name_does_not_jump_by_a_revolution(tmp_path):
    angle = 350 + 60 * np.sin(2 * files.TIME)
    text = files.lines(files.TIME, angle % 360, header="time,Angle_Degrees")
    (found,), remarks = read_demonstrations([files.write(tmp_path, text).path])
    assert found.units == ("rad",)
    assert np.ptp(found.values) == pytest.approx(np.radians(120), rel=1e-3)
    assert "unwrapped" in " ".join(remarks)


def test_feet_may_be_those_of_a_body(tmp_path):
    text = files.lines(
        files.TIME, *files.PATH.T[:2], header="time,left_foot,right_feet"
    )
    (found,), _ = read_demonstrations([files.write(tmp_path, text).path])
    assert (found.channels, found.units) == (("left_foot", "right_feet"), ("1", "1"))


@pytest.mark.parametrize(
    "name", ["Gravity.", "Grav", "palm_normal_", "normal_", "direction_", "view_dir_"]
)
def test_directions_are_no_positions(name, tmp_path):
    header = ",".join(f"{name}{axis}" for axis in "xyz")
    text = files.lines(
        files.TIME,
        *files.PATH.T,
        *files.PATH.T,
        header=f"t,{header},hand_x,hand_y,hand_z",
    )
    (found,), remarks = read_demonstrations([files.write(tmp_path, text).path])
    assert found.channels[3:] == ("x", "y", "z")
    assert not remarks
    text = files.xyz(header=f"t,{header}")
    (found,), _ = read_demonstrations([files.write(tmp_path, text).path])
    assert found.units == ("1", "1", "1")


@pytest.mark.parametrize("name", ["quality", "object"])
def test_labels_in_any_order_are_no_sources_beside_those_chosen(name, tmp_path):
    time, path = np.repeat(files.TIME, 2), np.repeat(files.PATH, 2, axis=0)
    labels = np.random.default_rng(0).integers(0, 3, len(time))
    if name == "quality":
        labels = np.array(["good", "bad", "none found"])[labels]
    hands = ["Left", "Right"] * len(files.TIME)
    text = files.lines(hands, time, *path.T, labels, header=f"hand,t,x,y,z,{name}")
    options = ReadingOptions(topic="Left")
    (found,), _ = read_demonstrations([files.write(tmp_path, text).path], options)
    assert found.channels[:3] == ("x", "y", "z")
    assert_allclose(found.values[:, :3], files.PATH)


@pytest.mark.parametrize("other", ["cam", "RKorr", "left_hand"])
def test_a_position_that_never_changes_is_not_the_motion(other, tmp_path):
    header = ",".join(["time", *(f"{b}_{a}" for b in (other, "hand") for a in "xyz")])
    still = np.full_like(files.PATH, 0.1)
    text = files.lines(files.TIME, *still.T, *files.PATH.T, header=header)
    (found,), remarks = read(lambda folder: files.write(folder, text), tmp_path)
    assert_allclose(found.select(["x", "y", "z"]).values, files.PATH, atol=1e-12)
    assert "several positions" not in remarks


def test_a_command_that_changes_is_not_read_for_a_measured_rest(tmp_path):
    header = (
        "time,x_target,y_target,z_target,left_x,left_y,left_z,right_x,right_y,right_z"
    )
    still = np.full_like(files.PATH, 0.1)
    text = files.lines(
        files.TIME, *files.PATH.T, *still.T, *(still + 1).T, header=header
    )
    (found,), remarks = read(lambda folder: files.write(folder, text), tmp_path)
    assert "x" not in found.channels
    assert "choose with --columns x=left_x,y=left_y,z=left_z" in remarks


def test_the_position_that_moves_is_advised(tmp_path):
    header = ",".join(
        ["time", *(f"{b}_{a}" for b in ("head", "left", "right") for a in "xyz")]
    )
    bodies = [*(0.01 * files.PATH).T, *files.PATH.T, *(2 * files.PATH).T]
    text = files.lines(files.TIME, *bodies, header=header)
    _, remarks = read(lambda folder: files.write(folder, text), tmp_path)
    assert "(head_x, left_x, right_x ...)" in remarks
    assert "choose with --columns x=left_x,y=left_y,z=left_z" in remarks


@pytest.mark.parametrize("names", ["ax ay az gx gy gz", "imu_gx imu_gy imu_gz"])
def test_rates_of_a_gyroscope_are_not_a_position(names, tmp_path):
    values = [column for _ in range(len(names) // 9 + 1) for column in files.PATH.T]
    header = ",".join(["time", *names.split()])
    text = files.lines(files.TIME, *values[: len(names.split())], header=header)
    (found,), _ = read(lambda folder: files.write(folder, text), tmp_path)
    assert found.channels == tuple(names.split())


@pytest.mark.parametrize(
    "names",
    [
        "planned_{},actual_{}",
        "soll_{},ist_{}",
        "{}_cmd,{}_meas",
        "{}_des,{}_act",
        "{}_soll,{}_ist",
    ],
)
def test_what_is_measured_is_preferred_to_what_is_planned(names, tmp_path):
    kinds = [kind.format(axis) for kind in names.split(",") for axis in "xyz"]
    columns = [*(files.PATH + 1).T, *files.PATH.T]
    text = files.lines(files.TIME, *columns, header=",".join(["time", *kinds]))
    (found,), _ = read(lambda folder: files.write(folder, text), tmp_path)
    assert_allclose(found.select(["x", "y", "z"]).values, files.PATH, atol=1e-12)


def test_joints_of_inverse_kinematics_are_commanded(tmp_path):
    names = [f"{kind}_J{i}" for kind in ("IK", "Actual") for i in range(7)]
    columns = [*(files.JOINTS + 0.01).T, *files.JOINTS.T]
    text = files.lines(files.TIME, *columns, header=",".join(["time", *names]))
    _, remarks = read(lambda folder: files.write(folder, text), tmp_path)
    assert "several arms" not in remarks


def test_words_that_contain_grav_may_be_positions(tmp_path):
    text = files.xyz(header="t,engraver_x,engraver_y,engraver_z")
    (found,), _ = read_demonstrations([files.write(tmp_path, text).path])
    assert found.channels == ("x", "y", "z")


@pytest.mark.parametrize("name", ["force_sensor", "crc"])
def test_a_measurement_of_many_integers_does_not_alternate(name, tmp_path):
    rng = np.random.default_rng(0)
    counts = [f"x{n:02x}" if name == "crc" else n for n in rng.integers(0, 60, 2000)]
    time, path = np.arange(2000) / 500, np.repeat(files.PATH, 5, axis=0)
    text = files.lines(time, *path.T, counts, header=f"t,x,y,z,{name}")
    (found,), _ = read_demonstrations([files.write(tmp_path, text).path])
    assert found.channels[:3] == ("x", "y", "z")


@pytest.mark.parametrize("name", ["Sequence", "frame_id", "camera_frame_id", "seq"])
def test_a_counter_that_leaves_out_numbers_is_no_channel(name, tmp_path):
    count = np.arange(len(files.TIME)) * 3 // 2
    text = files.lines(count, files.TIME, *files.PATH.T, header=f"{name},t,x,y,z")
    (found,), _ = read_demonstrations([files.write(tmp_path, text).path])
    assert found.channels == ("x", "y", "z")


def test_poses_without_names_and_times_are_refused_with_the_columns_of_the_file(
    tmp_path,
):
    text = files.lines(*files.PATH.T, *files.QUATERNIONS.T)
    match = (
        r"no column holds the time; the 7 columns have no names; .*--sample-rate 100$"
    )
    with pytest.raises(FmpError, match=match):
        read_demonstrations([files.write(tmp_path, text).path])


@pytest.mark.parametrize("first", ["2023-01-01 10:00:00", "0.5", "a"])
def test_a_first_row_of_small_numbers_is_no_header(first, tmp_path):
    rows = [f"{first},{i},{i + 1},{i + 2}" for i in range(40)]
    file = files.write(tmp_path, "\n".join(rows) + "\n").path
    options = ReadingOptions.parse("x=2,y=3,z=4", sample_rate=50)
    (found,), _ = read_demonstrations([file], options)
    assert_allclose(found.values, np.arange(40)[:, None] + [0, 1, 2])


@pytest.mark.parametrize("form", ["{}_t", "mag_{}_uT", "joint_{}_T"])
def test_a_channel_may_end_with_t(form, tmp_path):
    names = [form.format(axis) for axis in "xyz"]
    text = files.xyz(header=f"robot_t,{','.join(names)}")
    (found,), _ = read_demonstrations([files.write(tmp_path, text).path])
    assert found.channels == tuple(names)
    assert_allclose(found.time, files.TIME, atol=1e-9)


def test_a_time_whose_name_ends_with_t_may_go_back(tmp_path):
    time = files.TIME + 1.5 / files.RATE * (np.arange(len(files.TIME)) % 2)
    file = files.write(tmp_path, files.xyz(time, header="robot_t,x,y,z")).path
    (found,), remarks = read_demonstrations([file])
    assert found.channels == ("x", "y", "z")
    assert "samples sorted by time" in " ".join(remarks)
    file = files.write(tmp_path, files.xyz(files.TIME % 2, header="robot_t,x,y,z")).path
    with pytest.raises(FmpError, match=r"time does not increase .* Cut the file there"):
        read_demonstrations([file])


@pytest.mark.parametrize("unit", ["deg", "°C"])
def test_a_column_t_in_another_unit_is_not_the_time(unit, tmp_path):
    columns = (100 * files.PATH[:, 0], 1e3 * files.TIME, *files.PATH.T)
    text = files.lines(*columns, header=f"T [{unit}],Time [ms],x,y,z")
    (found,), _ = read_demonstrations([files.write(tmp_path, text).path])
    assert found.channels == ("T", "x", "y", "z")
    assert_allclose(found.time, files.TIME)


def test_a_second_time_is_no_channel(tmp_path):
    text = files.lines(
        files.TIME, files.TIME + 0.01, *files.PATH.T, header="camera.t,arm.t,x,y,z"
    )
    (found,), remarks = read_demonstrations([files.write(tmp_path, text).path])
    assert found.channels == ("x", "y", "z")
    assert "the time is camera.t" in " ".join(remarks)


def test_landmarks_in_frames_are_one_recording_of_several_positions(tmp_path):
    for make in (files.json_of_landmarks_in_frames, files.npz_of_landmarks):
        (found,), remarks = read_demonstrations([make(tmp_path).path])
        assert len(found.time) == len(files.TIME)
        assert re.search(r"several positions .* --columns x=landmarks.0.x", remarks[-1])
    (found,), _ = read_demonstrations([files.npz_of_landmarks(tmp_path).path])
    assert {"rx", "ry", "rz"} <= {*found.channels}


def test_recordings_with_the_time_of_their_beginning_are_several(tmp_path):
    recordings = [
        {"time": 100.0 * i, "position": files.PATH[i:].tolist()} for i in range(25)
    ]
    file = files.write(tmp_path, json.dumps(recordings), "d.json").path
    found, _ = read_demonstrations([file], ReadingOptions(sample_rate=files.RATE))
    assert [len(each.time) for each in found] == list(range(400, 375, -1))


@pytest.mark.parametrize("suffix", ["json", "npz"])
def test_recordings_of_one_length_with_their_beginnings_are_several(suffix, tmp_path):
    paths = np.stack([files.PATH[i : i + 100] for i in range(25)])
    time, begins = files.TIME[:100], 100.0 * np.arange(25)
    file = tmp_path / f"d.{suffix}"
    if suffix == "npz":
        np.savez(file, timestamp=begins, positions=paths, rate=files.RATE)
    else:
        items = zip(begins.tolist(), paths.tolist(), strict=True)
        content = [
            {"timestamp": b, "position": p, "t": time.tolist()} for b, p in items
        ]
        file.write_text(json.dumps(content))
    found, _ = read_demonstrations([file])
    assert [each.values.shape for each in found] == [(100, 3)] * 25


@pytest.mark.parametrize("counts", [[1] + [0] * 99, [0, 1, 2, 3]])
def test_lists_of_objects_of_few_samples_or_different_lengths_are_left_out(
    counts, tmp_path
):
    samples = [
        {
            "t": t,
            "position": dict(zip("xyz", point, strict=True)),
            "contacts": [{"force": {"x": 1.0, "y": 2.0, "z": t}}]
            * counts[i % len(counts)],
        }
        for i, (t, point) in enumerate(
            zip(files.TIME.tolist(), files.PATH.tolist(), strict=True)
        )
    ]
    file = files.write(tmp_path, json.dumps(samples), "d.json").path
    (found,), _ = read_demonstrations([file])
    assert found.channels == ("x", "y", "z")
    assert_allclose(found.values, files.PATH)


def test_a_column_twice_is_read_once(tmp_path):
    file = files.column_twice(tmp_path)
    (found,), remarks = read_demonstrations([file.path])
    assert found.channels == ("current", "x", "y", "z")
    assert "current repeated: read once" in " ".join(remarks)
    options = ReadingOptions.parse("time=1,x=3,y=4,z=5,again=6")
    (found,), _ = read_demonstrations([file.path], options)
    assert found.channels == ("x", "y", "z", "again")


def test_columns_of_one_name_and_different_units_are_no_copies(tmp_path):
    text = files.lines(
        files.TIME, *files.PATH.T, files.PATH[:, 0], header="t,x [m],y [m],z [m],x [mm]"
    )
    with pytest.raises(FmpError, match=r"names of columns repeat: x \(2, 5\)"):
        read_demonstrations([files.write(tmp_path, text).path])


def test_an_array_of_a_handle_has_no_points_of_a_hand(tmp_path):
    jacobians = np.ones((len(files.TIME), 6, 3))
    file = tmp_path / "d.npz"
    np.savez(file, t=files.TIME, p=files.PATH, handle_jacobian=jacobians)
    (found,), remarks = read_demonstrations([file])
    assert found.channels == ("x", "y", "z")
    assert "handle_jacobian (400, 6, 3) of float64 left out" in remarks[0]


def test_points_of_a_trajectory_without_names_are_joints(tmp_path):
    points = [
        {
            "positions": angles.tolist(),
            "velocities": [0.0] * 7,
            "time_from_start": [int(t), round(t % 1 * 1e9)],
        }
        for t, angles in zip(files.TIME.tolist(), files.JOINTS, strict=True)
    ]
    text = json.dumps({"trajectory": points})
    (found,), _ = read_demonstrations([files.write(tmp_path, text, "d.json").path])
    assert found.channels == tuple(f"joint_{i}" for i in range(1, 8))
    assert found.units == ("rad",) * 7
    assert_allclose(found.time, files.TIME, atol=1e-9)
    assert_allclose(found.values, files.JOINTS, atol=1e-12)


def test_rows_of_several_points_of_a_body_are_not_mixed(tmp_path):
    nodes, path = np.tile([4, 8], len(files.TIME)), np.repeat(files.PATH, 2, axis=0)
    path[0::2] += 1.0
    text = files.lines(
        nodes, np.repeat(files.TIME, 2), *path.T, header="Node Number,t,X,Y,Z"
    )
    file = files.write(tmp_path, text).path
    with pytest.raises(FmpError, match=r"Node Number alternates: .* among 4, 8"):
        read_demonstrations([file])
    (found,), _ = read_demonstrations([file], ReadingOptions(topic="8"))
    assert_allclose(found.values, files.PATH, atol=1e-12)


def test_a_joint_that_hardly_moves_is_no_column_of_sensors(tmp_path):
    names = ["shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3"]
    angles = np.tile(files.PATH, 2)
    angles[:, 2] = 1.2 + 1e-5 * (np.arange(len(angles)) % 3)
    header = ",".join(["time", *(f"{name}_joint" for name in names)])
    text = files.lines(files.TIME, *angles.T, header=header)
    (found,), _ = read_demonstrations([files.write(tmp_path, text).path])
    assert_allclose(found.values, angles, atol=1e-12)


def test_a_topic_chooses_rows_that_do_not_alternate(tmp_path):
    hands = ["left"] * len(files.TIME) + ["right"] * len(files.TIME)
    path, time = np.tile(files.PATH, (2, 1)), np.tile(files.TIME, 2)
    path[len(files.TIME) :] += 1.0
    text = files.lines(hands, time, *path.T, header="hand,t,x,y,z")
    file = files.write(tmp_path, text).path
    (found,), _ = read_demonstrations([file], ReadingOptions(topic="right"))
    assert_allclose(found.values, 1.0 + files.PATH, atol=1e-12)


def test_a_topic_that_no_column_has_is_reported(tmp_path):
    file = files.write(tmp_path, files.xyz(header="t,x,y,z")).path
    _, (remarks,) = read_demonstrations([file], ReadingOptions(topic="hand"))
    assert "no column has hand to choose: --topic is not used" in remarks


def test_the_time_is_preferred_to_another_clock(tmp_path):
    text = files.lines(
        np.floor(files.TIME), files.TIME, *files.PATH.T, header="time_utc,time,x,y,z"
    )
    (found,), _ = read_demonstrations([files.write(tmp_path, text).path])
    assert_allclose(found.time, files.TIME - files.TIME[0], atol=1e-9)


@pytest.mark.parametrize("make", [files.lerobot_2, files.lerobot_3], ids=name_of)
def test_a_dataset_has_a_demonstration_for_each_episode(make, tmp_path):
    found, remarks = read(make, tmp_path)
    assert "episode 1: observation.state at 50 Hz" in remarks
    for episode, each in enumerate(found):
        assert each.channels == ("x", "y", "z")
        assert_allclose(each.time, files.TIME, atol=1e-6)
        assert_allclose(each.values, files.PATH + 0.1 * episode, atol=1e-6)
    with pytest.raises(FmpError, match="holds 2 demonstrations"):
        Demonstration.load(tmp_path / "dataset")


def drop(column, path):
    from pyarrow import parquet

    parquet.write_table(parquet.read_table(path).drop([column]), path)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (
            lambda d: (d / "meta" / "info.json").write_text("{"),
            r"info\.json is not a LeRobot dataset's \(JSONDecodeError",
        ),
        (
            lambda d: (d / "meta" / "info.json").write_text('{"fps": 50}'),
            r"info\.json is not a LeRobot dataset's \(KeyError\('features'\)",
        ),
        (lambda d: shutil.rmtree(d / "data"), r"has no data/\*\*/\*\.parquet"),
        (
            lambda d: drop("timestamp", next(d.rglob("*.parquet"))),
            "its files have different columns",
        ),
        (
            lambda d: [drop("timestamp", file) for file in d.rglob("*.parquet")],
            "has no column timestamp",
        ),
        (
            lambda d: [drop("observation.state", f) for f in d.rglob("*.parquet")],
            r"has no column observation\.state",
        ),
    ],
)
def test_error_of_a_dataset_lists_missing_parts(damage, message, tmp_path):
    dataset = written(files.lerobot_2, tmp_path).path
    damage(dataset)
    with pytest.raises(FmpError, match=message):
        read_demonstrations([dataset])


@pytest.mark.parametrize(
    "make",
    [
        files.matlab_structures,
        files.matlab_cells,
        files.npy_of_recordings,
        files.npz_of_recordings,
        files.json_recordings,
        files.hdf5_of_episodes,
    ],
    ids=name_of,
)
def test_several_recordings_in_a_file_are_read(make, tmp_path):
    found, _ = read(make, tmp_path)
    assert len(found) == 2
    for k, demonstration in enumerate(found):
        assert demonstration.channels == ("x", "y", "z")
        assert_allclose(demonstration.time, files.TIME, atol=1e-9)
        assert_allclose(demonstration.values, files.PATH + k, atol=1e-12)


@pytest.mark.parametrize("make", [files.json_with_gaps, files.json_columns_with_gaps])
def test_samples_without_a_value_in_json_are_left_out(make, tmp_path):
    (found,), remarks = read(make, tmp_path)
    known = np.delete(np.arange(400), [0, 9, 10])
    assert_allclose(found.time, files.TIME[known], atol=1e-9)
    assert_allclose(found.values, files.PATH[known], atol=1e-12)
    assert "3 rows without a value left out" in remarks


@pytest.mark.parametrize(
    ("unit", "start", "begin"),
    [
        (1.0, 1.7e9, 0.0),
        (1e-3, 1.7e12, 0.0),
        (1e-6, 1.7e15, 0.0),
        (1e-6, 2.0e10, 2.0e4),
        (1e-9, 1.1e13, 1.1e4),
        (1e-3, 1.8e8, 1.8e5),
        (1e-7, 6.39e17, 0.0),
        (1e-7, 1.34e17, 0.0),
    ],
)
@pytest.mark.parametrize("interval", [0.02, 0.4])
def test_unit_of_times_of_day_and_since_the_start_of_a_machine_is_found(
    unit, start, begin, interval, tmp_path
):
    time = np.arange(60) * interval
    stamps = (start + np.round(time / unit, 3)).tolist()
    path = tmp_path / "d.csv"
    form = "{:.3f}" if unit == 1.0 else "{:.0f}"
    rows = [f"{form.format(s)},{np.sin(t)}" for s, t in zip(stamps, time, strict=True)]
    path.write_text("time,x\n" + "\n".join(rows))
    (found,), _ = read_demonstrations([path])
    assert_allclose(found.time, begin + time, atol=1e-4)


def test_stamps_of_seconds_that_come_once_a_second_stay_seconds(tmp_path):
    path = tmp_path / "d.csv"
    path.write_text(
        "time,x\n" + "\n".join(f"{1_700_000_000 + i},{i}" for i in range(30))
    )
    (found,), _ = read_demonstrations([path])
    assert found.time[-1] == 29.0


def test_two_columns_of_whole_numbers_are_not_decimal_commas(tmp_path):
    path = tmp_path / "d.csv"
    path.write_text(
        "time_ms,angle\n" + "\n".join(f"{20 * i},{500 + i}" for i in range(60))
    )
    (found,), _ = read_demonstrations([path])
    assert found.channels == ("angle",)
    assert_allclose(found.time, 0.02 * np.arange(60))


def test_parts_of_a_dataset_without_names_are_numbered(tmp_path):
    found, _ = read(files.lerobot_without_names, tmp_path)
    assert found[0].channels == tuple(f"c{i}" for i in range(7))
    assert_allclose(found[0].values, files.JOINTS, atol=1e-6)


def test_robomimic_episodes_are_read_at_their_control_frequency(tmp_path):
    demonstrations, remarks = read(files.robomimic, tmp_path)
    assert "demo_10: obs/robot0_eef_pos, obs/robot0_eef_quat at 50 Hz" in remarks
    for demonstration, height in zip(demonstrations, (0.0, 0.1), strict=True):
        assert demonstration.channels == ("x", "y", "z", "rx", "ry", "rz")
        assert_allclose(demonstration.time, files.TIME, atol=1e-9)
        assert_allclose(demonstration.values[:, :3], files.PATH + height, atol=1e-12)


@pytest.mark.parametrize("topic", ["", "action"])
def test_aloha_joints_are_read_at_a_stated_rate(topic, tmp_path):
    file = written(files.aloha, tmp_path)
    (demonstration,), remarks = read_demonstrations(
        [file.path], ReadingOptions(sample_rate=50, topic=topic)
    )
    assert_allclose(demonstration.values, files.JOINTS, atol=1e-12)
    assert (topic or "observations/qpos") in remarks[0]
    with pytest.raises(FmpError, match="no dataset nose; choose with --topic among"):
        read_demonstrations([file.path], ReadingOptions(sample_rate=50, topic="nose"))


def test_joints_of_a_bag_keep_their_names(tmp_path):
    (found,), _ = read(files.ros2_joints, tmp_path)
    assert found.channels == tuple(f"panda_joint{i}" for i in range(1, 8))
    assert set(found.units) == {"rad"}
    assert_allclose(found.values, files.JOINTS, atol=1e-12)


@pytest.mark.parametrize("first", [0, 1])
def test_arm_is_read_where_a_gripper_is_on_the_same_topic(first, tmp_path):
    pytest.importorskip("rosbags")

    def state(k):
        message = files.joint_state(1, k)
        if k % 2 == first:
            message.name, message.position = ["gripper"], np.zeros(1)
        if k == 201 - first:
            message.name.append("gripper")
            message.position = np.append(message.position, 0.0)
        return message

    bag = files.bag(tmp_path / "d.bag", {"/joint_states": state}, ros=1)
    (found,), remarks = read_demonstrations([bag])
    assert found.channels == tuple(f"panda_joint{i}" for i in range(1, 8))
    assert_allclose(found.values, files.JOINTS[1 - first :: 2], atol=1e-12)
    assert "gripper left out" in " ".join(remarks)


def test_a_frame_of_a_tree_of_transforms_is_read(tmp_path):
    pytest.importorskip("rosbags")
    types = files.typestore(2).types

    def transforms(*names):
        def message(k):
            all_of_them = [
                replace(files.transform_stamped(2, k), child_frame_id=n) for n in names
            ]
            return types["tf2_msgs/msg/TFMessage"](transforms=all_of_them)

        return message

    one = files.bag(tmp_path / "one", {"/tf": transforms("tool")}, storage="SQLITE3")
    (found,), _ = read_demonstrations([one], ReadingOptions(topic="/tf"))
    assert_allclose(found.values[:, :3], files.PATH, atol=1e-9)
    assert found.rotation_reference is not None
    two = files.bag(
        tmp_path / "two", {"/tf": transforms("tool", "cup")}, storage="SQLITE3"
    )
    with pytest.raises(FmpError, match=r"frames cup, tool; .* --topic /tf:cup$"):
        read_demonstrations([two], ReadingOptions(topic="/tf"))
    with pytest.raises(FmpError, match=r"frames cup, tool; choose"):
        read_demonstrations([two], ReadingOptions(topic="/tf:pan"))
    tool = {"/tool": lambda k: files.transform_stamped(2, k)}
    other = files.bag(tmp_path / "other", tool, storage="SQLITE3")
    with pytest.raises(FmpError, match=r"no frames to choose from; give --topic /tool"):
        read_demonstrations([other], ReadingOptions(topic="/tool:cup"))
    (found,), _ = read_demonstrations([two], ReadingOptions(topic="/tf:tool"))
    assert_allclose(found.values[:, :3], files.PATH, atol=1e-9)


def test_a_bag_begins_with_its_earliest_message(tmp_path):
    pytest.importorskip("rosbags")
    topics = {"/pose": lambda k: files.pose_stamped(1, 399 - k)}
    bag = files.bag(tmp_path / "d.bag", topics, ros=1)
    (found,), _ = read_demonstrations([bag])
    assert found.time[0] == 0
    assert_allclose(found.values[:, :3], files.PATH, atol=1e-12)


def test_simulated_time_may_begin_at_zero(tmp_path):
    (found,), remarks = read(files.bag_of_simulated_time, tmp_path)
    assert "header stamps" in remarks
    assert_allclose(found.time, files.TIME, atol=1e-9)


def test_an_episode_that_was_broken_off_is_left_out(tmp_path):
    from pyarrow import parquet

    dataset = written(files.lerobot_2, tmp_path).path
    (_, second) = sorted(dataset.rglob("*.parquet"))
    parquet.write_table(parquet.read_table(second).slice(0, 3), second)
    (found,), remarks = read_demonstrations([dataset])
    assert_allclose(found.values, files.PATH, atol=1e-6)
    assert "episode 1 left out, with too few frames" in " ".join(remarks)


def test_an_episode_may_have_fewer_frames_than_joints(tmp_path):
    from pyarrow import parquet

    wide = np.tile(files.PATH, 2)[:, :6]
    dataset = written(lambda f: files.dataset(f, "v2.1", None, wide), tmp_path).path
    (_, second) = sorted(dataset.rglob("*.parquet"))
    parquet.write_table(parquet.read_table(second).slice(0, 5), second)
    first, short = read_demonstrations([dataset])[0]
    assert (len(first.time), len(short.time)) == (400, 5)


def test_joints_without_positions_are_refused(tmp_path):
    pytest.importorskip("rosbags")

    def state(k):
        message = files.joint_state(1, k)
        message.position = np.zeros(0)
        return message

    bag = files.bag(tmp_path / "d.bag", {"/joint_states": state}, ros=1)
    with pytest.raises(FmpError, match="of joint states only positions are read"):
        read_demonstrations([bag])


def test_a_bag_by_another_name_is_refused_with_advice(tmp_path):
    bag = written(files.ros1_poses, tmp_path).path
    renamed = bag.rename(bag.with_suffix(".orig"))
    with pytest.raises(FmpError, match=r"ends with \.bag, \.mcap or \.db3"):
        read_demonstrations([renamed])
    folder = written(files.ros2_joints, tmp_path).path
    named_as_ros1 = folder.rename(folder.with_suffix(".bag"))
    with pytest.raises(
        FmpError, match=r"folder of a ROS 2 bag; give it a name without"
    ):
        read_demonstrations([named_as_ros1])


@pytest.mark.parametrize(
    ("topic", "message"),
    [
        ("", r"has the topics /note \(String\); choose one with --topic"),
        ("/nose", r"has no topic /nose; it has /note \(String\)"),
        ("/note", "/note has no message with numbers"),
    ],
)
def test_a_bag_of_words_is_refused(topic, message, tmp_path):
    pytest.importorskip("rosbags")
    word = files.typestore(1).types["std_msgs/msg/String"](data="here")
    bag = files.bag(tmp_path / "d.bag", {"/note": lambda _: word}, ros=1)
    with pytest.raises(FmpError, match=message):
        read_demonstrations([bag], ReadingOptions(topic=topic))


def test_a_bag_that_claims_millions_of_messages_is_refused(tmp_path):
    bag = written(files.ros2_joints, tmp_path).path
    about = bag / "metadata.yaml"
    claimed = about.read_text().replace("message_count: 400", "message_count: 3000000")
    about.write_text(claimed)
    with pytest.raises(FmpError, match="has 3000000 messages; at most 2000000 are"):
        read_demonstrations([bag])


def test_text_that_is_too_large_is_refused_before_it_is_read(tmp_path):
    path = tmp_path / "d.csv"
    with path.open("w") as stream:
        stream.write("time,x\n")
        stream.truncate(2**28)
    with pytest.raises(FmpError, match=r"d\.csv holds 256 MB; at most 128 MB"):
        read_demonstrations([path])


def test_rows_that_would_take_too_much_memory_are_refused(tmp_path):
    pa = pytest.importorskip("pyarrow")
    from pyarrow.parquet import write_table

    path = tmp_path / "d.parquet"
    write_table(pa.table({"x": pa.nulls(40_000_000)}), path)
    with pytest.raises(FmpError, match=r"d\.parquet holds 305 MB; at most 256 MB"):
        read_demonstrations([path])


@pytest.mark.skipif(sys.platform != "linux", reason="needs a file that none can read")
def test_a_file_that_cannot_be_read_is_named():
    path = Path("/proc/self/mem")
    with pytest.raises(FmpError, match=f"cannot read {path}: Input/output error"):
        read_demonstrations([path])


@pytest.mark.parametrize(
    ("name", "content", "package", "message"),
    [
        (
            "d.bag",
            b"#ROSBAG V2.0",
            "rosbags.highlevel",
            r"a bag; .*'fmp-drake\[bags\]'",
        ),
        ("d.parquet", b"PAR1", "pyarrow", r"Parquet file; .*'fmp-drake\[parquet\]'"),
        ("d.h5", b"\x89HDF\r\n\x1a\n", "h5py", r"HDF5 file; .*'fmp-drake\[hdf5\]'"),
    ],
)
def test_missing_reader_is_named_with_its_extra(
    name, content, package, message, tmp_path, monkeypatch
):
    monkeypatch.setitem(sys.modules, package, None)
    path = files.bytes_of(name, content)(tmp_path).path
    with pytest.raises(FmpError, match=message):
        read_demonstrations([path])


def test_recordings_that_are_read_together_have_one_reference_of_rotations(tmp_path):
    one = files.tum(tmp_path).path
    later = tmp_path / "later.txt"
    rows = one.read_text().split("\n")
    later.write_text("\n".join([rows[0], *rows[200:]]))
    found, _ = read_demonstrations([one, later])
    assert found[0].rotation_reference == found[1].rotation_reference
    assert_allclose(found[1].values, found[0].values[199:], atol=1e-9)


def test_forces_and_angles_without_units_get_those_of_their_kind(tmp_path):
    text = files.lines(*[files.TIME] * 5, header="time,force_x,joint_1,pitch,emg")
    found = Demonstration.load(files.write(tmp_path, text).path)
    assert found.units == ("N", "rad", "rad", "1")


def test_degrees_become_radians(tmp_path):
    text = files.lines(files.TIME, 90 + files.TIME, header="time,elbow [deg]")
    found = Demonstration.load(files.write(tmp_path, text).path)
    assert found.units == ("rad",)
    assert found.values[0, 0] == pytest.approx(np.pi / 2)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"unit": "furlong"}, "unit is 'furlong'; choose one of m, .* or convert the"),
        ({"sample_rate": -1}, "sample rate is -1"),
        ({"quaternions": "zyxw"}, "quaternions is 'zyxw'; choose xyzw or wxyz"),
    ],
)
def test_invalid_reading_options_are_refused(given, message):
    with pytest.raises(FmpError, match=message):
        ReadingOptions(**given)


@pytest.mark.parametrize("columns", ["time", "=x", "x=", "x=1,y"])
def test_columns_are_pairs(columns):
    with pytest.raises(FmpError, match="write NAME=COLUMN"):
        ReadingOptions.parse(columns)


CELLS = [
    "0",
    "-2.5",
    "1,5",
    "nan",
    "",
    "x",
    "t",
    "#",
    "%time",
    "y [mm]",
    "qx",
    "qw",
    "z",
    "12:00:00",
    "2024-13-01 10:00:00Z",
    "1e400",
    '"',
    "_",
    "secs",
    "nsecs",
    "inf",
]


def test_any_table_is_read_or_refused(tmp_path):
    rng = np.random.default_rng(0)
    path, reasons = tmp_path / "d.csv", []
    given = [None, ReadingOptions(sample_rate=10), ReadingOptions.parse("time=1,x=2")]
    for number in range(400):
        width, delimiter = rng.integers(1, 7), rng.choice([",", ";", "\t", " "])
        head = rng.choice(CELLS, (rng.integers(0, 4), width))
        body = 0.02 * np.arange(12)[:, None] + rng.normal(0, 0.01, (12, width))
        rows = [*head, *body.astype(str)[: rng.integers(0, 12)]]
        path.write_text("\n".join(delimiter.join(row) for row in rows))
        try:
            read_demonstrations([path], given[number % 3])
        except FmpError as error:
            reasons.append(str(error))
    assert 100 < len(reasons) < 390
    assert all("d.csv" in reason for reason in reasons)
