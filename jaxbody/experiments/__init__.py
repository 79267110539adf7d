"""What was measured on a rig, and what a model predicts in its place."""
