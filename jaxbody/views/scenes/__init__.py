"""The drawn parts of a model and its motions in three dimensions, as plain arrays that do not
depend on a renderer."""
