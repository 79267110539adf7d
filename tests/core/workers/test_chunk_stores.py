"""Stores: chunks written once, found again, never mixed with those of another call; disks that are
full and folders that are closed."""

import json
import os
import shutil
import subprocess

import numpy as np
import pytest

import jaxbody as jb
from jaxbody.core.workers.chunk_stores import ChunkStore

pytest.importorskip("zarr", reason="needs jaxbody[cluster]")
pytest.importorskip("xarray", reason="needs jaxbody[xarray]")
ARRAYS = {"mass": ((), "float64"), "f": ((2,), "float64"), "n": ((), "int64")}


def store_at(path, plan=None, size=4, arrays=ARRAYS, count=10):
    inputs, results = (
        {name: kind for name, kind in arrays.items() if (name == "mass") == given}
        for given in (True, False)
    )
    return ChunkStore(
        path,
        plan or {"over": "abc", "jax": "0.10"},
        inputs,
        results,
        count=count,
        size=size,
    )


def chunk(i, size=4, count=10):
    rows = np.arange(i * size, min((i + 1) * size, count))
    return {"mass": 1.0 * rows, "f": rows[:, None] + [0.5, 0.25], "n": rows}


def test_what_is_written_is_read_again_and_the_rest_is_nan(tmp_path):
    store = store_at(tmp_path / "s.zarr")
    store.write(2, chunk(2))
    store.write(0, chunk(0))
    store.write(1, {"mass": chunk(1)["mass"]}, lost=True)
    again = store_at(tmp_path / "s.zarr")
    assert again.complete() == {0, 2} and again.lost() == {1}
    data = again.opened("sweep")
    assert set(data.coords) == {"mass"} and data["f"].dims == ("design", "f_0")
    np.testing.assert_array_equal(data["mass"], np.arange(10.0))
    np.testing.assert_array_equal(data["f"][:4], chunk(0)["f"])
    np.testing.assert_array_equal(data["f"][8:], chunk(2)["f"])
    assert np.isnan(data["f"][4:8]).all()
    np.testing.assert_array_equal(data["status"], [0] * 4 + [jb.Status.LOST] * 4 + [0] * 2)


def test_a_chunk_without_its_status_is_not_complete(tmp_path):
    """As after a crash between two files."""
    store = store_at(tmp_path / "s.zarr")
    store.write(1, chunk(1))
    os.remove(tmp_path / "s.zarr" / "status" / "c" / "1")
    again = store_at(tmp_path / "s.zarr")
    assert (
        again.complete() == set()
        and (again.opened("sweep")["status"] == jb.Status.INTERRUPTED).all()
    )


@pytest.mark.parametrize(
    "changed, words",
    [
        (dict(plan={"over": "abd", "jax": "0.10"}), "over abc there, abd here"),
        (dict(plan={"over": "abc", "jax": "0.12"}), "jax 0.10 there, 0.12 here"),
        (dict(plan={"over": "abc", "jax": "0.10", "x64": True}), "x64 None there, True here"),
        (dict(size=5), "chunk 4 there, 5 here"),
        (dict(count=11), "designs 10 there, 11 here"),
    ],
)
def test_a_store_of_another_call_is_refused_with_what_differs(tmp_path, changed, words):
    store_at(tmp_path / "s.zarr")
    with pytest.raises(jb.JaxbodyError, match=words) as error:
        store_at(tmp_path / "s.zarr", **changed)
    assert error.value.code == "OTHER_STORE"


@pytest.mark.parametrize("content", [None, "text", '{"attributes": {"other": 1}}'])
def test_a_folder_or_file_of_something_else_is_refused_and_left_alone(tmp_path, content):
    path = tmp_path / "s.zarr"
    if content is None:
        path.write_text("mine")
    else:
        path.mkdir()
        (path / "zarr.json").write_text(content)
    with pytest.raises(jb.JaxbodyError, match="is no store of jaxbody") as error:
        store_at(path)
    assert error.value.code == "OTHER_STORE" and (
        path.read_text() if content is None else (path / "zarr.json").read_text()
    ) in (
        content,
        "mine",
    )


@pytest.mark.parametrize("name", ["d/dx", "__x", "status", ".."])
def test_a_name_that_cannot_be_a_folder_is_reported(tmp_path, name):
    with pytest.raises(jb.JaxbodyError, match="cannot have an array") as error:
        store_at(tmp_path / "s.zarr", arrays={name: ((), "float64")})
    assert error.value.code == "BAD_NAME" and not (tmp_path / "s.zarr").exists()


def test_of_two_that_make_it_at_once_one_succeeds_and_both_use_it(tmp_path, monkeypatch):
    """The second finds, when it renames its own, that the first has just done so."""
    path, real = tmp_path / "s.zarr", ChunkStore._make

    def late(self, plan, arrays):
        store_at_first = ChunkStore.__new__(ChunkStore)
        store_at_first.__dict__.update(self.__dict__)
        real(store_at_first, plan, arrays)
        real(self, plan, arrays)

    monkeypatch.setattr(ChunkStore, "_make", late)
    store = store_at(path)
    store.write(0, chunk(0))
    assert store.complete() == {0} and sorted(os.listdir(tmp_path)) == ["s.zarr"]


def test_a_folder_that_cannot_be_written_is_reported(tmp_path):
    (tmp_path / "file").write_text("")
    for path in (tmp_path / "file" / "s.zarr", tmp_path / "none" / ("x" * 300)):
        with pytest.raises(jb.JaxbodyError, match="cannot be written") as error:
            store_at(path)
        assert error.value.code == "NOT_SAVED"


@pytest.fixture
def small_disk(tmp_path):
    """A disk of 200 kB; needs the right to mount."""
    folder = tmp_path / "disk"
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=200k", "tmpfs", str(folder)]
    if shutil.which("mount") is None or subprocess.run(command, capture_output=True).returncode:
        pytest.skip("may not mount a small disk here")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


def test_a_full_disk_is_reported_and_what_is_complete_stays(small_disk, rng):
    count, size = 40_000, 1000
    store = store_at(small_disk / "s.zarr", count=count, size=size)
    for i in range(count // size):
        values = {
            "mass": rng.normal(size=size),
            "f": rng.normal(size=(size, 2)),
            "n": np.arange(size),
        }
        try:
            store.write(i, values)
        except jb.JaxbodyError as error:
            assert (
                error.code == "NOT_SAVED"
                and "No space left" in str(error)
                and "the same call continues" in error.hint
            )
            break
        last = values["f"]
    again = store_at(small_disk / "s.zarr", count=count, size=size)
    assert again.complete() == set(range(i)) and 3 < i < 12
    np.testing.assert_array_equal(again.opened("sweep")["f"][(i - 1) * size : i * size], last)


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="of Unix")
def test_a_store_of_another_user_that_is_closed_is_reported(tmp_path):
    store = store_at(tmp_path / "s.zarr")
    store.write(0, chunk(0))
    (tmp_path / "s.zarr" / "status" / "c").chmod(0o555)
    if user := os.geteuid() == 0:  # whom no mode stops
        for folder in [*tmp_path.parents][:3]:
            folder.chmod(folder.stat().st_mode | 0o055)
        os.seteuid(65534)
    try:
        with pytest.raises(jb.JaxbodyError, match="Permission denied") as error:
            store.write(1, chunk(1))
    finally:
        if user:
            os.seteuid(0)
    assert error.value.code == "NOT_SAVED" and store.complete() == {0}


def test_the_plan_can_be_read_by_people(tmp_path):
    store_at(tmp_path / "s.zarr")
    plan = json.loads((tmp_path / "s.zarr" / "zarr.json").read_text())["attributes"]["jaxbody"]
    assert plan == {"format": 1, "over": "abc", "jax": "0.10", "designs": 10, "chunk": 4}
