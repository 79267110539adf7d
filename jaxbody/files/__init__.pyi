"""What `jaxbody.files` offers, written by `python tests/stubs.py`."""

from jaxbody.files.interchange.data_sheets import read_hard_points as read_hard_points
from jaxbody.files.interchange.data_sheets import read_mounts as read_mounts
from jaxbody.files.interchange.mjcf_readers import read_mjcf as read_mjcf
from jaxbody.files.interchange.mjcf_writers import write_mjcf as write_mjcf
from jaxbody.files.model_files import read_model as read_model
from jaxbody.files.model_files import write_model as write_model
from jaxbody.files.result_files import read_results as read_results
from jaxbody.files.result_files import write_results as write_results
from jaxbody.files.studies.study_files import Study as Study
from jaxbody.files.studies.study_files import read_study as read_study
