"""Files as other programs write them: LabVIEW's text, cells and structs of MATLAB, dates
as times."""

import numpy as np
import pytest
from scipy.io import savemat

import jaxbody as jb

HEAD = """LabVIEW Measurement\t
Writer_Version\t2
Separator\tTab
Decimal_Separator\tMARK
X_Columns\tCOLUMNS
Time_Pref\tAbsolute
Date\t2013/02/19
Time\t09:51:39
***End_of_Header***\t
\t
"""
NO_TIMES = """Channels\t2\t\t
Samples\t3\t3\t
Date\t2013/02/19\t2013/02/19\t
Y_Unit_Label\tNewtons\tg\t
X_Dimension\tTime\tTime\t
X0\t5,0E-1\t5,0E-1\t
Delta_X\t2,5E-3\t2,5E-3\t
***End_of_Header***\t\t\t
X_Value\tForce (Trigger)\tTop\tComment
\t10,5\t0,1\tstart
\t20,5\t-0,2
\t30,5\t0,4
"""
PAIRS = """Channels\t2\t\t\t\t
Y_Unit_Label\tmm\t\tg\t
X_Dimension\tTime\t\tTime\t
***End_of_Header***\t\t\t
X_Value\tx\tX_Value\ta\tComment
0.500\t1\t0.500\t2
0.502\t3\t0.502\t5
0.504\t4\t0.504\t3
"""
ONE = """Notes\tX values guaranteed valid only for Dev0/Ai0
Channels\t2
X_Dimension\tTime\tTime
***End_of_Header***
X_Value\tx\ty
0.5\t1\t7
0.6\t2\t9
0.7\t4\t3
"""


def lvm(path, columns, mark, table):
    path.write_text(HEAD.replace("COLUMNS", columns).replace("MARK", mark) + table)
    return path


def test_text_of_labview_has_the_units_and_times_of_its_headings(tmp_path):
    """Without times, decimal commas; times for each channel; times once, without units."""
    record = jb.read_record(
        lvm(tmp_path / "a.lvm", "No", ",", NO_TIMES), channels={"f": "Force (Trigger)", "a": "Top"}
    )
    np.testing.assert_allclose(record.times, [0.5, 0.5025, 0.505], rtol=1e-15)
    assert record["f"].tolist() == [10.5, 20.5, 30.5] and record.stated == {
        "f": "Newtons",
        "a": "g",
    }
    np.testing.assert_allclose(record["a"], 9.80665 * np.array([0.1, -0.2, 0.4]), rtol=1e-15)
    record = jb.read_record(
        lvm(tmp_path / "b.lvm", "Multi", ".", PAIRS), channels={"x": "x", "a": "a"}
    )
    assert record.times.tolist() == [0.5, 0.502, 0.504] and record["x"].tolist() == [
        0.001,
        0.003,
        0.004,
    ]
    path = lvm(tmp_path / "c.lvm", "One", ".", ONE)
    for time in (None, ("X_Value", "s")):
        record = jb.read_record(path, channels={"y": ("y", "m")}, time=time)
        assert record.times.tolist() == [0.5, 0.6, 0.7] and record["y"].tolist() == [7, 9, 3]


def test_what_is_not_one_table_over_time_is_refused(tmp_path):
    path = tmp_path / "a.lvm"
    for columns, table, words in (
        (
            "One",
            ONE.replace("Time\tTime", "Frequency\tTime"),
            r"a.lvm\['x'\]: is over 'Hz', not over time.*NOT_A_RECORD",
        ),
        ("One", ONE + "\n" + ONE, r"has 2 segments.*WRONG_FORMAT"),
        ("One", ONE.replace("X_Value", "Zeit"), r"no table below .*X_Value.*NO_NUMBERS"),
        (
            "No",
            NO_TIMES.replace("Delta_X\t2,5E-3", "Delta_X\t"),
            r"states no times.*rate=.*NO_TIME",
        ),
        ("One", ONE.replace("0.6\t2", "0.6\tOK"), r"a.lvm:17: has 'OK' in column 2.*BAD_LINE"),
    ):
        with pytest.raises(jb.JaxbodyError, match=words):
            jb.read_record(
                lvm(path, columns, "," if columns == "No" else ".", table),
                channels={"x": (1, "N" if columns == "No" else "m")},
            )


DATES = {
    "ISO": "t,a\n2024-05-01 12:00:00.000,1\n2024-05-01 12:00:00.010,2\n",
    "German": "t;a\n01.05.2024 12:00;1\n01.05.2024 12:01;2\n",
    "time of day": "t\ta\n12:00:00.0\t1\n12:00:00.1\t2\n",
    "date and time": "date time a\n5/1/2024 12:00:00 1\n5/1/2024 12:00:01 2\n",
    "one": "t,a\n0,1\n0.01,2\n2024-05-01T12:00:00,2\n0.03,2\n",
}


@pytest.mark.parametrize("kind", DATES)
def test_dates_as_times_are_named_as_such(kind, tmp_path):
    (tmp_path / "run.csv").write_text(DATES[kind])
    with pytest.raises(
        jb.JaxbodyError,
        match=r"' is a date or a time of day: write seconds in its place, .*pandas.read_csv",
    ):
        jb.read_record(tmp_path / "run.csv", time=("t", "s"), channels={"a": ("a", "m")})


def cells(*values):
    array = np.empty(len(values), object)
    array[:] = values
    return array


def test_cells_and_structs_of_matlab_are_read_by_the_names_they_have_there(tmp_path):
    path, a, b = tmp_path / "run.mat", np.arange(4.0), np.arange(4.0) ** 2
    run = np.array([(a, 1.0), (b, 2.0)], [("acc", "O"), ("fs", "O")])
    savemat(
        path,
        {
            "data": cells(a, b, "text"),
            "run": run,
            "grid": cells(a, b, a, b).reshape(2, 2),
            "nested": {"part": cells(cells(a, b), "x")},
            "note": "text",
            "z": 1j * a,
            "empty": cells("a", "b"),
        },
    )
    for name, values in (
        ("data{1}", a),
        ("data{2}", b),
        ("run(2).acc", b),
        ("grid{1,2}", b),
        ("nested.part{1}{2}", b),
    ):
        assert (
            jb.read_record(path, rate=10.0, channels={"a": (name, "m")})["a"].tolist()
            == values.tolist()
        )
    for name, words in (
        ("data", r"'data' is a cell array.*such as 'data\{1\}'"),
        ("run", r"'run' is a struct array.*such as 'run\(1\).acc'"),
        ("nested", r"'nested' is a struct .*such as 'nested.part\{1\}\{1\}'"),
        ("data{3}", r"'data\{3\}' is text.*Save it as an array of real numbers"),
        ("z", r"'z' is complex128.*Save it as an array of real numbers"),
        ("empty", r"'empty' is a cell array.*Save it as"),
    ):
        with pytest.raises(jb.JaxbodyError, match=words + r".*NOT_A_NUMBER"):
            jb.read_record(path, rate=10.0, channels={"a": (name, "m")})


def test_cells_of_matlab_7_3_and_text_in_hdf5_are_named(tmp_path):
    h5py = pytest.importorskip("h5py", reason="h5py is not installed: pip install 'jaxbody[files]'")
    with h5py.File(tmp_path / "run.mat", "w", userblock_size=512) as file:
        part = file.create_dataset("#refs#/a", data=np.arange(3.0))
        file.create_dataset("data", data=np.array([part.ref], h5py.ref_dtype), dtype=h5py.ref_dtype)
        file["when"] = "2024-05-01"
    for name, words in (
        ("data", r"'data' is a cell or struct array of MATLAB 7.3.*-v7.*NOT_A_NUMBER"),
        ("when", r"'when' is object.*NOT_A_NUMBER"),
    ):
        with pytest.raises(jb.JaxbodyError, match=words):
            jb.read_record(tmp_path / "run.mat", rate=10.0, channels={"a": (name, "m")})
