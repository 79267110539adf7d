"""Views: pictures with matplotlib; scenes in a browser, in a notebook, in one HTML file."""

from jaxbody.core.compilation.late_imports import late_names

_NAMES = {
    "views": ("View", "view"),
}
__getattr__, __dir__, __all__ = late_names("jaxbody.views", _NAMES)
