"""Files of models, studies and other programs: text to checked SI numbers, to models and back."""

from jaxbody.core.compilation.late_imports import late_names

_NAMES = {
    "interchange.data_sheets": ("read_hard_points", "read_mounts"),
    "interchange.mjcf_readers": ("read_mjcf",),
    "interchange.mjcf_writers": ("write_mjcf",),
    "model_files": ("read_model", "write_model"),
    "result_files": ("read_results", "write_results"),
    "studies.study_files": ("Study", "read_study"),
}
__getattr__, __dir__, __all__ = late_names("jaxbody.files", _NAMES)
