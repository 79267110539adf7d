"""What `jaxbody.views` offers, written by `python tests/stubs.py`."""

from jaxbody.views.scenes.shapes import Shape as Shape
from jaxbody.views.views import View as View
from jaxbody.views.views import view as view
