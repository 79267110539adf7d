"""What `jaxbody.records` offers, written by `python tests/stubs.py`."""

from jaxbody.records.conditioning import derivative as derivative
from jaxbody.records.conditioning import filtered as filtered
from jaxbody.records.conditioning import integral as integral
from jaxbody.records.conditioning import resample as resample
from jaxbody.records.record_files import read_record as read_record
from jaxbody.records.record_files import read_responses as read_responses
from jaxbody.records.records import Record as Record
