"""The recipes in examples/cluster: scripts that shells accept, a manifest whose parts fit together,
a job array whose parts meet."""

import os
import subprocess
import sys
import sysconfig
from pathlib import Path

import kubernetes_validate
import pytest
import yaml

FOLDER = Path(__file__).parents[3] / "examples" / "cluster"
SCRIPTS = sorted(FOLDER.glob("*.sh"))


PARTS = list(yaml.safe_load_all((FOLDER / "dask.yaml").read_text()))


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.name)
def test_shellcheck_has_no_remark_on_the_scripts(script):
    subprocess.run(["bash", "-n", str(script)], check=True, timeout=30)
    subprocess.run(
        [sysconfig.get_path("scripts") + "/shellcheck", str(script)], check=True, timeout=30
    )


@pytest.mark.parametrize("version", ["1.28", kubernetes_validate.latest_version()])
@pytest.mark.parametrize(
    "part", PARTS, ids=lambda part: f"{part['kind']} {part['metadata']['name']}"
)
def test_the_manifest_has_the_schema_of_kubernetes(part, version):
    """Of an old and of the newest version, without unknown words."""
    kubernetes_validate.validate(part, version, strict=True)


def test_a_wrong_word_in_the_manifest_would_be_found():
    job = next(part for part in PARTS if part["kind"] == "Job")
    with pytest.raises(kubernetes_validate.ValidationError):
        kubernetes_validate.validate(
            job | {"spec": job["spec"] | {"backofLimit": 4}},
            kubernetes_validate.latest_version(),
            strict=True,
        )


def test_the_parts_of_the_manifest_fit_together():
    parts = PARTS
    named = {(part["kind"], part["metadata"]["name"]): part for part in parts}
    assert {part["apiVersion"] for part in parts} == {"v1", "apps/v1", "batch/v1"} and len(
        named
    ) == len(parts) == 5
    pods = [part["spec"]["template"] for part in parts if "template" in part["spec"]]
    for kind in ("scheduler", "worker"):
        spec = named["Deployment", f"dask-{kind}"]["spec"]
        assert spec["selector"]["matchLabels"] == spec["template"]["metadata"]["labels"]
    service = named["Service", "dask-scheduler"]["spec"]
    assert (
        service["selector"]
        == named["Deployment", "dask-scheduler"]["spec"]["template"]["metadata"]["labels"]
    )
    containers = [container for pod in pods for container in pod["spec"]["containers"]]
    assert len({container["image"] for container in containers}) == 1  # so that versions agree
    texts = [word for container in containers for word in container["args"]]
    assert all(isinstance(word, str) for word in texts)
    assert texts.count(f"tcp://dask-scheduler:{service['ports'][0]['port']}") == 2
    claims = [
        v["persistentVolumeClaim"]["claimName"]
        for pod in pods
        for v in pod["spec"].get("volumes", ())
    ]
    assert claims == ["sweep"] and ("PersistentVolumeClaim", "sweep") in named


@pytest.mark.long
def test_the_jobs_of_an_array_meet_in_one_store(tmp_path):
    """Two jobs at once, of three chunks each; then all is there."""
    pytest.importorskip("zarr", reason="needs jaxbody[cluster]")
    pytest.importorskip("xarray", reason="needs jaxbody[xarray]")
    command = [
        sys.executable,
        str(FOLDER / "designs.py"),
        "--out",
        str(tmp_path / "s.zarr"),
        "--designs",
        "24000",
        "--jobs",
        "2",
        "--job",
    ]
    environment = os.environ | {"PYTHONPATH": str(FOLDER.parents[1])}
    jobs = [
        subprocess.Popen([*command, str(i)], stdout=subprocess.PIPE, text=True, env=environment)
        for i in range(2)
    ]
    assert [job.wait(timeout=300) for job in jobs] == [0, 0]
    done = subprocess.run(
        [*command, "0"], capture_output=True, text=True, env=environment, timeout=300, check=True
    )
    assert done.stdout == "24000 of 24000 designs, 0 lost\n"
