"""Files made to hurt: each ends in one line that names the file, runs nothing and takes little memory and time."""

import io
import os
import pickle
import struct
import zipfile
from dataclasses import replace

import numpy as np
import pytest
from memory import peak
from test_recordings import NPZ, PICKLED

from vislam_edu import cli, recordings
from vislam_edu.drive import DriveError


def object_npy(path, pickled):
    """An .npy file whose header says "object", followed by a pickle."""
    header = b"{'descr': '|O', 'fortran_order': False, 'shape': (), }"
    header += b" " * (118 - len(header) - 1) + b"\n"
    path.write_bytes(b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + pickled)
    return path


def refused(path, match):
    with pytest.raises(DriveError, match=match) as error:
        recordings.load(path)
    assert str(error.value).startswith(str(path))
    assert "\n" not in str(error.value)


def reconstructed(dtype, state):
    """A pickle that makes an ndarray of this dtype and sets its state: what numpy itself writes, with any content."""
    def text(value):
        return b"U" + bytes([len(value)]) + value if isinstance(value, bytes) else pickle.dumps(value, protocol=2)[2:-1]

    array = b"cnumpy.core.multiarray\n_reconstruct\n(cnumpy\nndarray\nK\x00\x85U\x01btR"
    return b"\x80\x02" + array + b"(" + b"".join(text(item) for item in state[:2]) + dtype + text(state[2]) + \
        text(state[3]) + b"tb."


def test_bytes_for_an_array_of_objects_never_become_pointers(tmp_path):
    """dtype('O') with its flags cleared by BUILD, then raw bytes: numpy would read them as addresses."""
    dtype = b"cnumpy\ndtype\n(U\x02O8K\x00K\x01tR(K\x03U\x01|NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK\x00tb"
    path = object_npy(tmp_path / "a.npy", reconstructed(dtype, (1, (1,), False, b"AAAAAAAA")))
    refused(path, "its pickle holds a list|damaged")


@pytest.mark.parametrize("code", [b"V8", b"M8", b"f8,f8", b"a", b"(2,)f8"])
def test_only_plain_numbers_and_text_are_admitted_as_types(tmp_path, code):
    dtype = b"cnumpy\ndtype\n(U" + bytes([len(code)]) + code + b"K\x00K\x01tR"
    path = object_npy(tmp_path / "a.npy", reconstructed(dtype, (1, (1,), False, b"A" * 8)))
    refused(path, "its pickle holds an array")


def test_a_shape_that_does_not_fit_its_bytes_is_refused(tmp_path):
    dtype = b"cnumpy\ndtype\n(U\x02f8K\x00K\x01tR"
    for shape in ((10**9, 10**9), (-1,), (2,)):
        refused(object_npy(tmp_path / "a.npy", reconstructed(dtype, (1, shape, False, b"A" * 8))), "bytes do not fit")


def test_a_huge_memo_index_costs_nothing(tmp_path):
    path = object_npy(tmp_path / "a.npy", b"\x80\x02}r\xff\xff\xff\x7f.")
    assert peak(lambda: refused(path, "missing")) < 20e6


@pytest.mark.parametrize("opcodes", [b"(ios\nsystem\n.", b"(cos\nsystem\no.", b"Pname\n.", b"\x82\x01.", b"}}b."],
                         ids=["INST", "OBJ", "PERSID", "EXT1", "BUILD on a dictionary"])
def test_other_ways_to_ask_for_code_are_unknown(tmp_path, opcodes):
    refused(object_npy(tmp_path / "a.npy", b"\x80\x02" + opcodes), "nothing of it was run|damaged")


def test_a_zip_bomb_is_not_unpacked(tmp_path):
    path = tmp_path / "bomb.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for i in range(40):
            with archive.open(f"a{i}.npy", "w") as member:
                for _ in range(48):
                    member.write(bytes(1 << 20))
    assert peak(lambda: refused(path, "more than the 1.5 GB that a recording may have")) < 20e6


@pytest.mark.parametrize("header", [
    b"{'descr': '<f8', 'fortran_order': False, 'shape': (1000000, 1000000), }",
    b"{'descr': '<f8', 'fortran_order': False, 'shape': (-5,), }",
    b"{'descr': '|O', 'fortran_order': False, 'shape': (1,), }",
    b"{'descr': '<f8', 'fortran_order': False, 'shape': (2L,), }",
    b"{'descr': [('a', '<f8')], 'fortran_order': False, 'shape': (1,), }",
    b"(" * 5000,
    b"{'descr': '<f8'",
], ids=["huge", "negative", "objects", "of Python 2", "record", "nested", "cut short"])
def test_a_header_that_lies_is_refused_before_memory_is_taken(tmp_path, header):
    path = tmp_path / "a.npz"
    with zipfile.ZipFile(path, "w") as archive:
        for key, value in NPZ.items():
            file = io.BytesIO()
            np.save(file, value)
            if key == "K":
                file = io.BytesIO(b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header) + 1) + header + b"\n"
                                  + bytes(72))
            archive.writestr(f"{key}.npy", file.getvalue())
    assert peak(lambda: refused(path, "K: ")) < 50e6


@pytest.mark.parametrize("method", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2])
def test_any_byte_of_an_archive_may_be_wrong(tmp_path, method):
    """Flips, cuts and unknown compression: a DriveError or the same drive, and nothing else."""
    path, rng = tmp_path / "a.npz", np.random.default_rng(0)
    with zipfile.ZipFile(path, "w", method) as archive:
        for key, value in NPZ.items():
            file = io.BytesIO()
            np.save(file, value)
            archive.writestr(f"{key}.npy", file.getvalue())
    whole, messages = path.read_bytes(), []
    for _ in range(150):
        damaged = bytearray(whole)
        for at in rng.integers(0, len(whole), rng.integers(1, 4)):
            damaged[at] = rng.integers(0, 256)
        path.write_bytes(damaged[:rng.integers(10, len(whole))] if rng.random() < 0.2 else damaged)
        try:
            recordings.load(path)
        except DriveError as error:
            messages.append(str(error))
    assert messages
    assert not any("\n" in message for message in messages)


def test_any_byte_of_a_pickle_may_be_wrong(tmp_path):
    rng, whole = np.random.default_rng(1), pickle.dumps(np.array(PICKLED, dtype=object), protocol=2)
    messages = []
    for _ in range(300):
        damaged = bytearray(whole)
        for at in rng.integers(0, min(len(whole), 900), rng.integers(1, 4)):
            damaged[at] = rng.integers(0, 256)
        try:
            recordings.load(object_npy(tmp_path / "a.npy", bytes(damaged)))
        except DriveError as error:
            messages.append(str(error))
    assert messages
    assert not any("\n" in message for message in messages)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
def test_a_pipe_and_a_device_are_no_recordings(tmp_path):
    os.mkfifo(tmp_path / "pipe.npz")
    refused(tmp_path / "pipe.npz", "not a regular file")
    np.savez(tmp_path / "drive.npz", **NPZ)
    drive = recordings.load(tmp_path / "drive.npz")
    (tmp_path / "zero.txt").symlink_to("/dev/zero")
    with pytest.raises(DriveError, match="not a regular file"):
        recordings.load_ground_truth(tmp_path / "zero.txt", drive)


def test_control_characters_of_a_file_do_not_reach_the_terminal(tmp_path, capsys):
    np.savez(tmp_path / "a.npz", **{"\x1b[31mred" + "x" * 60000: np.zeros(1)})
    assert cli.main(["info", str(tmp_path / "a.npz")]) == 2
    said = capsys.readouterr().err
    assert "\x1b" not in said
    assert len(said) < 500 + len(str(tmp_path))
    drive = recordings.load("first_steps").replace(name="\x1b]0;title\x07", history=("two\nlines",))
    recordings.save(drive, tmp_path / "own.npz")
    assert cli.main(["info", str(tmp_path / "own.npz")]) == 0
    assert "\x1b" not in capsys.readouterr().out


@pytest.mark.parametrize(("field", "value"), [
    ("n_landmarks", np.nan), ("n_landmarks", np.inf), ("n_landmarks", 1e10), ("n_landmarks", 2.0**62),
    ("history", np.array(3.0)), ("history", np.array([["a"]])), ("landmark", np.array([np.nan])),
    ("frame_start", np.array([np.nan]))])
def test_the_own_format_is_checked_field_by_field(tmp_path, field, value):
    recordings.save(recordings.load("first_steps"), tmp_path / "own.npz")
    with np.load(tmp_path / "own.npz") as own:
        fields = dict(own) | {field: value}
    np.savez(tmp_path / "own.npz", **fields)
    refused(tmp_path / "own.npz", field)


@pytest.mark.parametrize(("field", "change"), [
    ("times", lambda d: d.replace(times=d.times * 1e150)), ("twists", lambda d: d.replace(twists=d.twists * 1e150)),
    ("pixels", lambda d: d.replace(pixels=d.pixels * 1e150)),
    ("cam_T_imu", lambda d: d.with_extrinsics(d.camera.cam_T_imu + 1e150 * np.eye(4, k=3))),
    ("truth_landmarks", lambda d: d.replace(truth_landmarks=d.truth_landmarks * 1e150))], ids=lambda v: str(v)[:20])
def test_absurd_magnitudes_are_refused_with_their_bound(field, change):
    with pytest.raises(DriveError, match=f"{field}: .*expected absolute values up to"):
        change(recordings.load("first_steps"))


@pytest.mark.parametrize(("field", "change"), [
    ("times", lambda drive: drive.replace(times=drive.times * 1e-300)),
    ("baseline", lambda drive: drive.replace(camera=replace(drive.camera, baseline=1e-150))),
    ("K", lambda drive: drive.replace(camera=replace(drive.camera, K=drive.camera.K * [[1e-9], [1e-9], [1]])))])
def test_numbers_too_small_to_divide_by_are_named(field, change):
    with pytest.raises(DriveError, match=f"{field}: .*expected .*at least"):
        change(recordings.load("first_steps"))


@pytest.mark.parametrize("words", [
    ["simulate", "--out", "x.npz", "--frames", "1000000000000"], ["simulate", "--out", "x.npz", "--sigma-px", "1e160"],
    ["run", "--out", "x", "--every", "9999999999999999999999999"], ["consistency", "--out", "x", "--sigma-px", "1e5"],
    ["audit", "--figure", "f.xyz"], ["audit", "nothing.npz"], ["exercises", "--report", "nothing"]], ids=" ".join)
def test_an_option_out_of_range_is_one_line(words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    try:
        status = cli.main(words)
    except SystemExit as stopped:  # argparse leaves this way
        status = stopped.code
    assert status == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_what_is_not_foreseen_is_one_line_with_its_place(monkeypatch, capsys):
    monkeypatch.setattr("vislam_edu.cli.outputs.description", lambda drive: 1 / 0)
    assert cli.main(["info"]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "unforeseen ZeroDivisionError in test_hostile_files.py, line " in said
    assert "please report it" in said
