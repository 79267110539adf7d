"""What headings state of numbers, axes and starting times holds: none is ignored, and what
contradicts it is refused."""

import numpy as np
import pytest
from universal_files import uff_text

import jaxbody as jb

UFF = dict(reason="pyuff is not installed: pip install 'jaxbody[files]'")
RESPONSE = dict(of=4, data_type=5, below="N", axis=18, axis_unit="Hz")


def record(path, text, **options):
    path.write_text(text)
    return jb.read_record(path, channels={"a": "1+Z"}, **options)


def response(path, text):
    path.write_text(text)
    frequencies, measured = jb.records.read_responses(path, {("a", "f"): "1+Z/1+Z"})
    return frequencies.tolist(), measured["a", "f"].tolist()


def test_zeros_that_fill_up_a_line_are_no_points(tmp_path):
    """Uneven frequencies and values, two points in a line of six numbers; four samples in one; two
    samples at uneven times."""
    pytest.importorskip("pyuff", **UFF)
    path = tmp_path / "run.uff"
    uneven = uff_text(
        [(5.0, 0.9, 0.0, 5.03, 1.0, 0.5), (100.0, 0.8, 0.1, 0, 0, 0)], points=3, even=0, **RESPONSE
    )
    assert response(path, uneven) == ([5.0, 5.03, 100.0], [0.9, 1 + 0.5j, 0.8 + 0.1j])
    assert record(path, uff_text([(1, 2, 3, 0, 0, 0)], points=4))["a"].tolist() == [1, 2, 3, 0]
    assert record(
        path, uff_text([(0, 7, 0.2, 5, 0.3, 0), (0, 0, 0, 0)], points=3, even=0), irregular=True
    ).times.tolist() == [0, 0.2, 0.3]


def test_a_set_with_other_than_the_stated_points_is_refused(tmp_path):
    pytest.importorskip("pyuff", **UFF)
    path, rows = tmp_path / "run.uff", [(1, 2, 3, 4, 5, 6)]
    for points, words in (
        (1000, r".*1000, as its heading says.*TRUNCATED"),
        (2, r".*allowed: 2, .*RAGGED_LINE"),
    ):
        with pytest.raises(jb.JaxbodyError, match="has 6 samples" + words):
            record(path, uff_text(rows, points=points))
        with pytest.raises(jb.JaxbodyError, match="has 3 samples" + words):
            response(path, uff_text(rows, points=points, **RESPONSE))
    with pytest.raises(jb.JaxbodyError, match=r"no complete set.*is cut off.*WRONG_FORMAT"):
        record(path, uff_text(rows, points=6)[:-8])
    (tmp_path / "RSN1.AT2").write_text(
        "a\nb\nACCELERATION IN UNITS OF G\nNPTS=  4, DT=  .01 SEC\n .1 .2 .3 .4 0 0\n"
    )
    assert len(jb.read_record(tmp_path / "RSN1.AT2", channels={"a": "motion"}).times) == 4


@pytest.mark.parametrize(
    ("unit", "factor"),
    [("s", 1), ("SEC", 1), ("NONE", 1), ("ms", 1e-3), ("MS", 1e-3), ("us", 1e-6), ("min", 60)],
)
def test_times_of_a_universal_file_have_their_unit(unit, factor, tmp_path):
    pytest.importorskip("pyuff", **UFF)
    read = record(
        tmp_path / "run.uff", uff_text([(1, 2, 3, 4)], points=4, step=0.01 / factor, axis_unit=unit)
    )
    np.testing.assert_allclose(read.times, [0, 0.01, 0.02, 0.03], rtol=1e-5)


@pytest.mark.parametrize(
    ("unit", "factor"),
    [
        ("Hz", 1),
        ("HZ", 1),
        ("NONE", 1),
        ("kHz", 1e3),
        ("rad/s", 0.5 / np.pi),
        ("rpm", 1 / 60),
        ("1/s", 1),
    ],
)
def test_frequencies_of_a_universal_file_have_their_unit(unit, factor, tmp_path):
    pytest.importorskip("pyuff", **UFF)
    read, _ = response(
        tmp_path / "run.uff",
        uff_text([range(6)], points=3, start=1.0, step=0.5, **RESPONSE | {"axis_unit": unit}),
    )
    np.testing.assert_allclose(read, np.array([1.0, 1.5, 2.0]) * factor, rtol=1e-12)


def test_an_axis_of_something_else_is_no_time_and_an_unknown_unit_is_said(tmp_path):
    pytest.importorskip("pyuff", **UFF)
    path, rows = tmp_path / "run.uff", [(1, 2, 3, 4)]
    for changed in (
        {"axis_unit": "Hz"},
        {"of": 0, "axis": 18, "axis_unit": "NONE"},
        {"of": 0, "axis_unit": "mm"},
    ):
        with pytest.raises(
            jb.JaxbodyError,
            match=r"run.uff\['1\+Z'\]: is over '(Hz|mm)', not over time.*NOT_A_RECORD",
        ):
            record(path, uff_text(rows, points=4, **changed))
    with pytest.raises(jb.JaxbodyError, match=r"is over 'm', not over frequency.*NOT_A_RESPONSE"):
        response(path, uff_text([range(6)], points=3, **RESPONSE | {"axis_unit": "m"}))
    with pytest.warns(
        jb.JaxbodyWarning,
        match=r"states 'Takte' as the unit of its axis, which is unknown: read as s.*TIME_UNIT",
    ):
        record(path, uff_text(rows, points=4, axis_unit="Takte"))


@pytest.mark.parametrize(
    ("of", "name"),
    [
        (2, "an auto spectrum"),
        (3, "a cross spectrum"),
        (6, "a coherence"),
        (9, "a power spectral density"),
    ],
)
def test_spectra_are_named_with_what_to_export_instead(of, name, tmp_path):
    pytest.importorskip("pyuff", **UFF)
    path, text = (
        tmp_path / "run.uff",
        uff_text([(1, 2, 3, 4)], of=of, points=4, axis=18, axis_unit="Hz", unit="(m/s2)2"),
    )
    with pytest.raises(
        jb.JaxbodyError,
        match=(
            rf"'1\+Z' is {name} .*Export time responses.*"
            r"jb.vibration.PSD.from_record.*NOT_A_RECORD"
        ),
    ):
        record(path, text)
    with pytest.raises(
        jb.JaxbodyError,
        match=(
            rf"'1\+Z/1\+Z' is {name} .*Export frequency responses, H1 or H2.*"
            r"jb.vibration.PSD.*NOT_A_RESPONSE"
        ),
    ):
        response(path, text)


def tdms(path, **channels):
    nptdms = pytest.importorskip(
        "nptdms", reason="npTDMS is not installed: pip install 'jaxbody[files]'"
    )
    usual = {"wf_start_offset": 0.0, "wf_increment": 0.5, "unit_string": "m/s2"}
    with nptdms.TdmsWriter(path) as file:
        file.write_segment(
            [
                nptdms.ChannelObject("G", name, values, usual | properties)
                for name, (values, properties) in channels.items()
            ]
        )


def test_axes_of_tdms_channels_have_their_unit(tmp_path):
    path, values = tmp_path / "run.tdms", np.arange(6.0)
    tdms(
        path,
        a=(values, {"wf_increment": 10.0, "wf_xunit_string": "ms"}),
        b=(values, {"wf_xunit_string": "Hz"}),
        c=(values, {"wf_increment": 0.0}),
    )
    assert jb.read_record(path, channels={"a": "G/a"}).times.tolist() == [
        0,
        0.01,
        0.02,
        0.03,
        0.04,
        0.05,
    ]
    with pytest.raises(
        jb.JaxbodyError, match=r"run.tdms\['G/b'\]: is over 'Hz', not over time.*NOT_A_RECORD"
    ):
        jb.read_record(path, channels={"b": "G/b"})
    with pytest.raises(jb.JaxbodyError, match=r"states no times.*rate=.*NO_TIME"):
        jb.read_record(path, channels={"c": "G/c"})


def test_tdms_channels_that_start_at_different_times_are_not_one_record(tmp_path):
    """A channel alone begins at its offset; dates in a channel of their own are seconds since
    the first."""
    start, path, values = (
        np.datetime64("2020-01-01T10:00:00.000000"),
        tmp_path / "run.tdms",
        np.arange(6.0),
    )
    late = start + np.timedelta64(1500, "ms")
    tdms(path, a=(values, {"wf_start_time": start}), b=(values, {"wf_start_time": late}),
         c=(values, {"wf_start_time": start, "wf_start_offset": 1.5}), d=(values, {}))  # fmt: skip
    with pytest.raises(
        jb.JaxbodyError,
        match=(
            r"of 'G/a' 6 samples from 0 s on and of 'G/b' 6 samples from 1.5 s on.*DIFFERENT_TIMES"
        ),
    ):
        jb.read_record(path, channels={"a": "G/a", "b": "G/b"})
    assert jb.read_record(path, channels={"c": "G/c"}).times[0] == 1.5
    together = jb.read_record(path, channels={"b": "G/b", "x": "G/b"})
    assert together.times.tolist() == [0, 0.5, 1, 1.5, 2, 2.5]
    dates = start + np.arange(6) * np.timedelta64(500, "ms")
    tdms(path, t=(dates, {}), a=(values, {}))
    assert jb.read_record(path, time="G/t", channels={"a": "G/a"}).times.tolist() == [
        0,
        0.5,
        1,
        1.5,
        2,
        2.5,
    ]


def mdf(path, *groups, unit=None):
    asammdf = pytest.importorskip(
        "asammdf", reason="asammdf is not installed: pip install 'jaxbody[mdf]'"
    )
    with asammdf.MDF(version="4.10") as file:
        for name, axis, kind in groups:
            file.append(
                [
                    asammdf.Signal(
                        np.arange(6.0), axis, name=name, unit="g", master_metadata=("x", kind)
                    )
                ]
            )
            if unit is not None:
                file.groups[-1].channels[0].unit = unit
        file.save(path, overwrite=True)


def test_axes_of_mdf_groups_are_times_in_their_unit_or_refused(tmp_path):
    path, axis = tmp_path / "run.mf4", np.arange(6) / 2
    mdf(path, ("a", 1e3 * axis, 1), unit="ms")
    assert jb.read_record(path, channels={"a": "a"}).times.tolist() == axis.tolist()
    mdf(path, ("a", axis, 1), ("late", axis + 1.5, 1), ("angle", axis, 2), ("number", axis, 4))
    for name, words in (
        ("angle", r"is over 'rad', not over time.*NOT_A_RECORD"),
        ("number", r"states no times.*rate=.*NO_TIME"),
    ):
        with pytest.raises(jb.JaxbodyError, match=words):
            jb.read_record(path, channels={name: name})
    with pytest.raises(
        jb.JaxbodyError, match=r"of 'late' 6 samples from 1.5 s on.*DIFFERENT_TIMES"
    ):
        jb.read_record(path, channels={"a": "a", "late": "late"})
