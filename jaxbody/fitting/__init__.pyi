"""What `jaxbody.fitting` offers, written by `python tests/stubs.py`."""

from jaxbody.fitting.bands import confidence_bands as confidence_bands
from jaxbody.fitting.coverages import interval_coverage as interval_coverage
from jaxbody.fitting.experiments.diagnoses import diagnose as diagnose
from jaxbody.fitting.experiments.experiments import Experiment as Experiment
from jaxbody.fitting.experiments.measured_responses import MeasuredModes as MeasuredModes
from jaxbody.fitting.experiments.measured_responses import MeasuredResponse as MeasuredResponse
from jaxbody.fitting.experiments.measured_stiffnesses import MeasuredStiffness as MeasuredStiffness
from jaxbody.fitting.experiments.measured_suspension_curves import MeasuredCurves as MeasuredCurves
from jaxbody.fitting.experiments.plausibilities import plausibility as plausibility
from jaxbody.fitting.fit_results import Fit as Fit
from jaxbody.fitting.fitters import fit as fit
from jaxbody.fitting.model_comparisons import evidence as evidence
from jaxbody.fitting.model_comparisons import leave_one_out as leave_one_out
from jaxbody.fitting.multistarts import Multistart as Multistart
from jaxbody.fitting.multistarts import multistart as multistart
from jaxbody.fitting.parameters.priors import LogNormal as LogNormal
from jaxbody.fitting.planning.choices import choose as choose
from jaxbody.fitting.planning.criteria import criterion as criterion
from jaxbody.fitting.planning.expected_fits import expected_fit as expected_fit
from jaxbody.fitting.planning.expected_fits import information as information
from jaxbody.fitting.planning.further_measurements import further_measurements as further_measurements
from jaxbody.fitting.posteriors import Posterior as Posterior
from jaxbody.fitting.posteriors import posterior as posterior
from jaxbody.fitting.profiles import profile_likelihood as profile_likelihood
from jaxbody.fitting.shootings import multiple_shooting as multiple_shooting
from jaxbody.fitting.validations import validate as validate
