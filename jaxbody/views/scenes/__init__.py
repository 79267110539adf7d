"""What is drawn of a model and its motions in three dimensions, as plain arrays that know
no renderer."""
