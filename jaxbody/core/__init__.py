"""What all share: errors and statuses, numbers from users, results that print, units, compilation. No mechanics."""
