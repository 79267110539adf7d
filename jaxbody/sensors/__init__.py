"""What instruments on bodies read, with gain, bias, delay and lag."""
