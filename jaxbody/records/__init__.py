"""Measured data: files, formats, units, sampling, repairs."""

from jaxbody.core.compilation.late_imports import late_names

_NAMES = {
    "conditioning": ("derivative", "filtered", "integral", "resample"),
    "record_files": ("read_record", "read_responses"),
    "records": ("Record",),
}
__getattr__, __dir__, __all__ = late_names("jaxbody.records", _NAMES)
