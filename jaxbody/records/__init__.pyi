"""What `jaxbody.records` offers, written by `python tests/stubs.py`."""

from jaxbody.records.record_files import read_record as read_record
from jaxbody.records.record_files import read_responses as read_responses
from jaxbody.records.records import Record as Record
