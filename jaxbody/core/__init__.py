"""Foundations of all packages: errors and statuses, checks of arguments, printed results, units.
No mechanics."""
