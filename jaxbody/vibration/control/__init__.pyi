"""What `jaxbody.vibration.control` offers, written by `python tests/stubs.py`."""

from jaxbody.vibration.control.estimators import kalman as kalman
from jaxbody.vibration.control.laws import ControlLaw as ControlLaw
from jaxbody.vibration.control.laws import LinearFeedback as LinearFeedback
from jaxbody.vibration.control.laws import PID as PID
from jaxbody.vibration.control.laws import Proportional as Proportional
from jaxbody.vibration.control.laws import groundhook as groundhook
from jaxbody.vibration.control.laws import on_off_skyhook as on_off_skyhook
from jaxbody.vibration.control.laws import skyhook as skyhook
from jaxbody.vibration.control.laws import state_feedback as state_feedback
from jaxbody.vibration.control.margins import loop_margins as loop_margins
from jaxbody.vibration.control.regulators import lqr as lqr
from jaxbody.vibration.control.riccati_equations import care as care
from jaxbody.vibration.control.riccati_equations import dare as dare
