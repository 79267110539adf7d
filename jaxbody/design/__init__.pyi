"""What `jaxbody.design` offers, written by `python tests/stubs.py`."""

from jaxbody.design.fronts import Front as Front
from jaxbody.design.fronts import pareto as pareto
from jaxbody.design.sensitivity_analyses import sensitivities as sensitivities
from jaxbody.design.sweeps import sweep as sweep
from jaxbody.design.tolerance_analyses import robust as robust
from jaxbody.design.tolerance_analyses import tolerances as tolerances
from jaxbody.design.tuners import tune as tune
from jaxbody.design.tuning_results import Tuning as Tuning
