"""Batches in chunks over devices, processes and machines: programs as data, lost workers, results
on disk."""
