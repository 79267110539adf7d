"""Files that expand too much, refer to other files, never end or have huge headings are refused
before they are read, or read quickly."""

import os
import threading
import tracemalloc
import zlib

import numpy as np
import pytest
from scipy.io import savemat

import jaxbody as jb
from jaxbody import laws
from jaxbody.records.text_tables import read_text, split_unit

MANY = 30_000_000  # zeros: 240 MB as numbers, a few kB as a file
LARGEST = 1e6


def refused(code, *words, peak=40e6):
    """A context that expects the error, and that little memory was taken until it came."""

    class Refused:
        def __enter__(self):
            tracemalloc.start()

        def __exit__(self, kind, error, trace):
            _, most = tracemalloc.get_traced_memory()
            tracemalloc.stop()
            assert isinstance(error, jb.JaxbodyError) and error.code == code, error
            assert [word for word in words if word not in str(error)] == [], str(error)
            assert most < peak, most
            return True

    return Refused()


def packed_hdf5(path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        # never written: zeros by default
        file.create_dataset("a", (MANY,), "f8", chunks=(1_000_000,), compression="gzip")


def packed_hdf5_in_one_chunk(path):
    """Ten numbers, in a chunk of thirty million."""
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        file.create_dataset("a", (10,), "f8", chunks=(MANY,), maxshape=(None,), compression="gzip")


def packed_mat73(path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w", userblock_size=512) as file:
        file.create_dataset("a", (1, MANY), "f8", chunks=(1, 1_000_000), compression="gzip")
    with open(path, "r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file".ljust(124))


def packed_mat5(path):
    """Forty arrays, each of them within the limit."""
    savemat(
        path,
        {f"x{i}": np.zeros(100_000) for i in range(40)} | {"a": np.zeros(10)},
        do_compression=True,
    )


def mat5_of_bytes(path):
    """A double array whose zeros are stored as bytes, eight times as many numbers as bytes
    would hold."""
    write_mat5(path, 6, 900_000, tagged(2, bytes(900_000)))


def mat5_of_empty_cells(path):
    """Eight bytes each in the file, far more as objects of Python."""
    write_mat5(path, 1, 30_000, tagged(14, b"") * 30_000)


def write_mat5(path, kind, count, content):
    savemat(path, {"a": np.zeros(10)})
    head = path.read_bytes()[:128]
    parts = [
        (6, np.array([kind, 0], "<u4").tobytes()),
        (5, np.array([count, 1], "<i4").tobytes()),
        (1, b"a"),
    ]
    packed = zlib.compress(tagged(14, b"".join(tagged(*part) for part in parts) + content))
    path.write_bytes(head + np.array([15, len(packed)], "<u4").tobytes() + packed)


def tagged(kind, data):
    return np.array([kind, len(data)], "<u4").tobytes() + data.ljust(-(-len(data) // 8) * 8, b"\0")


def packed_parquet(path):
    pa = pytest.importorskip(
        "pyarrow", reason="pyarrow is not installed: pip install 'jaxbody[files]'"
    )
    import pyarrow.parquet as pq

    pq.write_table(pa.table({"a": np.zeros(MANY // 10)}), path, compression="gzip")


def packed_tdms(path):
    """One byte each in the file, eight as a number."""
    nptdms = pytest.importorskip(
        "nptdms", reason="npTDMS is not installed: pip install 'jaxbody[files]'"
    )
    with nptdms.TdmsWriter(path) as file:
        file.write_segment([nptdms.ChannelObject("run", "a", np.zeros(200_000, np.uint8))])


def packed_mdf(path):
    asammdf = pytest.importorskip(
        "asammdf", reason="asammdf is not installed: pip install 'jaxbody[mdf]'"
    )
    with asammdf.MDF(version="4.10") as file:
        zeros = np.zeros(MANY // 30)
        file.append([asammdf.Signal(zeros, np.arange(len(zeros)) * 0.0, name="a", unit="g")])
        file.save(path, overwrite=True, compression=2)


PACKED = {  # file, what writes it, the channel
    "hdf5": ("run.h5", packed_hdf5, "a"),
    "hdf5 in one chunk": ("run.h5", packed_hdf5_in_one_chunk, "a"),
    "mat 7.3": ("run.mat", packed_mat73, "a"),
    "mat 5, many arrays": ("run.mat", packed_mat5, "a"),
    "mat 5, numbers as bytes": ("run.mat", mat5_of_bytes, "a"),
    "mat 5, empty cells": ("run.mat", mat5_of_empty_cells, "a"),
    "parquet": ("run.parquet", packed_parquet, "a"),
    "tdms": ("run.tdms", packed_tdms, "run/a"),
    "mdf": ("run.mf4", packed_mdf, "a"),
}


@pytest.mark.parametrize("kind", PACKED)
def test_the_limit_is_of_the_numbers_in_a_file_before_they_are_read(kind, tmp_path):
    """Each file is far below the limit of 1e6 bytes, what it holds far above."""
    name, write, channel = PACKED[kind]
    path = tmp_path / name
    write(path)
    assert path.stat().st_size < LARGEST
    with refused("TOO_LARGE", name, "largest="):
        jb.read_record(path, channels={"a": (channel, "g")}, rate=100.0, largest=LARGEST)


@pytest.mark.long
@pytest.mark.parametrize(
    "filters",
    [{}, {"shuffle": True, "fletcher32": True}, {"scaleoffset": 3, "dtype": "i4"}, "twice"],
    ids=str,
)
def test_a_chunk_that_inflates_beyond_what_the_file_states_is_refused(filters, tmp_path):
    """A thousand numbers, 8 kB as stated, that are 100 MB of zeros in truth; the same chunk, honest
    and as large as can be, passes."""
    h5py = pytest.importorskip("h5py")
    twice, options = (
        filters == "twice",
        {"compression": "gzip"} | (filters if isinstance(filters, dict) else {}),
    )
    plan = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    plan.set_chunk((1000,))
    for _ in range(1 + twice):
        plan.set_deflate(9)
    for name in ("honest.h5", "bomb.h5"):
        with h5py.File(tmp_path / name, "w") as file:
            if twice:
                h5py.h5d.create(
                    file.id, b"a", h5py.h5t.NATIVE_DOUBLE, h5py.h5s.create_simple((1000,)), plan
                )
            else:
                file.create_dataset("a", (1000,), **({"dtype": "f8"} | options), chunks=(1000,))
            file["a"][:] = np.random.default_rng(0).integers(0, 1000, 1000)
    with h5py.File(tmp_path / "bomb.h5", "r+") as file:
        packed = zlib.compress(bytes(100_000_000), 9)
        packed = zlib.compress(packed, 9) if twice else packed
        file["a"].id.write_direct_chunk((0,), packed + bytes(4) * ("fletcher32" in options))
    read = lambda name, **options: jb.read_record(  # noqa: E731
        tmp_path / name, channels={"a": ("a", "g")}, rate=100.0, **options
    )
    with refused("TOO_LARGE", "bomb.h5", "'/a'", "inflates"):
        read("bomb.h5", largest=LARGEST)
    assert len(read("honest.h5", largest=LARGEST)["a"]) == 1000


def test_a_limit_above_the_numbers_lets_them_pass(tmp_path):
    """30 000 numbers of 8 bytes: refused at 239 999, read at 240 000."""
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "run.h5", "w") as file:
        file["a"] = np.arange(30_000, dtype="i4") % 7
    with refused("TOO_LARGE", "2.4e+05 bytes of numbers (3e+04)"):
        jb.read_record(tmp_path / "run.h5", channels={"a": ("a", "g")}, rate=100.0, largest=239_999)
    assert (
        len(
            jb.read_record(
                tmp_path / "run.h5", channels={"a": ("a", "m")}, rate=100.0, largest=240_000
            )["a"]
        )
        == 30_000
    )


@pytest.mark.parametrize("way", ["external storage", "external link", "virtual dataset"])
def test_hdf5_that_points_to_other_files_is_refused(way, tmp_path):
    """The other file, here in the same folder with 800 bytes, could be any file of the machine."""
    h5py = pytest.importorskip("h5py")
    other, path = tmp_path / "other.bin", tmp_path / "run.h5"
    if way == "external storage":
        other.write_bytes(np.arange(100.0).tobytes())
        with h5py.File(path, "w") as file:
            file.create_dataset("a", (100,), "f8", external=[(str(other), 0, 800)])
    else:
        with h5py.File(other, "w") as file:
            file["kept"] = np.arange(100.0)
        with h5py.File(path, "w") as file:
            if way == "external link":
                file["a"] = h5py.ExternalLink(str(other), "/kept")
            else:
                layout = h5py.VirtualLayout((100,), "f8")
                layout[:] = h5py.VirtualSource(str(other), "kept", (100,))
                file.create_virtual_dataset("a", layout)
    with h5py.File(path, "a") as file:
        file["own"] = np.arange(50.0)
    with refused("EXTERNAL_DATA", "run.h5", "'a'", "another file", "h5repack"):
        jb.read_record(path, channels={"a": ("a", "g")}, rate=100.0)
    assert len(jb.read_record(path, channels={"own": ("own", "m")}, rate=100.0)["own"]) == 50


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="named pipes are of POSIX")
def test_a_named_pipe_is_refused_by_every_reader(tmp_path):
    """None of them may open it: opening blocks until someone writes. A thread that would free them
    fails the test."""
    path = tmp_path / "pipe.csv"
    os.mkfifo(path)
    blocked = []

    def free():
        blocked.append(True)
        os.close(os.open(path, os.O_WRONLY))

    rescue = threading.Timer(20.0, free)
    rescue.start()
    try:
        for read in (
            lambda: jb.read_record(path, channels={"a": ("a", "g")}, rate=100.0),
            lambda: jb.read_record(path, channels={"a": ("a", "g")}, rate=100.0, format="hdf5"),
            lambda: jb.records.read_responses(path, {("y", "f"): "4+Z/1+Z"}),
            lambda: laws.Tabulated.read(path),
        ):
            with refused("NOT_A_FILE", "pipe", "regular file"):
                read()
    finally:
        rescue.cancel()
    assert not blocked
    with refused("NOT_A_FILE", "device"):
        jb.read_record("/dev/zero", channels={"a": ("a", "g")}, rate=100.0, format="text")


# Work that grows with the square of a length would take hours at these; no time is asserted, it
# ends or it does not.

LONG = 1_000_000


@pytest.mark.parametrize(
    ("head", "parts"),
    [
        ("a" + " " * LONG, ("a", None)),
        ("a" + " " * LONG + "b", ("a" + " " * LONG + "b", None)),
        ("a" + " " * LONG + "[g]", ("a", "g")),
        ("[" * LONG, ("[" * LONG, None)),
        ("[" * LONG + "]", ("[" * (LONG - 1), None)),
        ("a " + "(" * LONG + "b)", ("a " + "(" * LONG + "b)", None)),
        ("a (" + "b" * LONG, ("a (" + "b" * LONG, None)),
        ("a (m" + " " * LONG + ")", ("a", "m")),
    ],
)
def test_a_heading_without_end_is_read_at_once(head, parts):
    assert split_unit(head) == parts


@pytest.mark.long
def test_blanks_and_digits_without_end_are_read_at_once(tmp_path):
    """The file of the report had 40 kB of blanks in its heading, for 11.5 s."""
    blanks = " " * LONG
    result = read_text(f"t [s],a{blanks}x [g]\n0,1\n1,2\n".encode(), "run.csv")
    assert [column.unit for column in result.columns.values()] == ["s", "g"]
    digits = "1" * LONG
    with refused("NO_NUMBERS", "run.csv"):
        read_text(f"t,a\n{digits}x,{digits}x\n".encode(), "run.csv")


@pytest.mark.long
def test_many_columns_are_named_at_once():
    n = 200_000
    text = ",".join(f"a{i}" for i in range(n)) + "\n" + ",".join("1" * n) + "\n"
    assert len(read_text(text.encode(), "run.csv").columns) == n


@pytest.mark.parametrize(
    ("head", "parts"),
    [
        ("acc [g]", ("acc", "g")),
        ("acc[g]", ("acc", "g")),
        ("[g]", ("[g]", None)),
        ("acc []", ("acc", None)),
        ("X [2]", ("X [2]", None)),
        ("k (N/(m/s))", ("k", "N/(m/s)")),
        ("x (left) (mm)", ("x (left)", "mm")),
        ("x (left)", ("x (left)", None)),
        ("a) (m", ("a) (m", None)),
    ],
)
def test_units_in_headings(head, parts):
    assert split_unit(head) == parts


# Curves of laws


def test_a_curve_may_have_another_separator_and_decimal_commas(tmp_path):
    """Written as a program in German does, with a unit line below the names; the same numbers as
    with commas and points."""
    path = tmp_path / "feder.csv"
    path.write_bytes("Weg;Kraft\nmm;kN\n-2,5;-1,0\n0;0\n1,5;0,5\n3;1,25\nEnde;\n".encode("utf-16"))
    law = laws.Tabulated.read(path, decimal=",", encoding="utf-16", footer=1)
    np.testing.assert_allclose(law.x, [-2.5e-3, 0, 1.5e-3, 3e-3], rtol=1e-15)
    np.testing.assert_allclose(law.forces, [-1000, 0, 500, 1250], rtol=1e-15)
    path.write_text("elongation [mm] | force [kN]\n-2.5|-1\n0|0\n1.5|0.5\n3|1.25\n")
    np.testing.assert_array_equal(laws.Tabulated.read(path, separator="|").forces, law.forces)


@pytest.mark.parametrize(
    ("text", "options", "code", "words"),
    [
        (
            "a [mm];b [kN]\n0;1,5\n1;2,5\n2;3,5\n3;4,5\n",
            {},
            "DECIMAL_COMMA",
            ["curve.csv:2", 'decimal=","'],
        ),
        ("a [mm]|b [kN]\n0|1\n1|2\n", {}, "NO_NUMBERS", ["separated by"]),
        (
            "a [mm],b [kN]\n" + "0,1\n" * 40,
            {"largest": 100},
            "TOO_LARGE",
            ["174 bytes", "allowed: 100 bytes"],
        ),
        ("a [mm],b [kN],c [N]\n0,1,2\n1,2,3\n", {}, "BAD_SHAPE", ["3 columns", "allowed: two"]),
        (
            "a [kN],b [mm]\n0,1\n1,2\n",
            {},
            "WRONG_DIMENSION",
            ["'a' in 'kN'", "'b' in 'mm'", "First elongation"],
        ),
        ("a,b [kN]\n0,1\n1,2\n", {}, "NO_UNIT", ["column 'a'"]),
    ],
)
def test_what_is_wrong_with_a_curve_is_named(text, options, code, words, tmp_path):
    path = tmp_path / "curve.csv"
    path.write_text(text)
    with refused(code, *words):
        laws.Tabulated.read(path, **options)


@pytest.mark.parametrize(
    ("text", "code", "words"),
    [
        (
            "angle [deg], force [N]\n-2,-2\n-1,-1\n0,0\n1,1\n",
            "WRONG_DIMENSION",
            "an angle with a force",
        ),
        (
            "stroke [mm], moment [N m]\n-2,-2\n-1,-1\n0,0\n1,1\n",
            "WRONG_DIMENSION",
            "a length with a moment",
        ),
        ("stroke [mm], force [N]\n-2,-2\n-1,-1\n0,0\n1_0,1\n", "BAD_LINE", "'1_0'"),
    ],
)
def test_a_table_pairs_turns_with_moments_and_reads_plain_numbers(tmp_path, text, code, words):
    path = tmp_path / "curve.csv"
    path.write_text(text)
    with pytest.raises(jb.JaxbodyError, match=words) as refused:
        jb.laws.Tabulated.read(path)
    assert refused.value.code == code
