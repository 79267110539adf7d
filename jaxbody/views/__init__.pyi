"""What `jaxbody.views` offers, written by `python tests/stubs.py`."""

from jaxbody.views.views import View as View
from jaxbody.views.views import view as view
