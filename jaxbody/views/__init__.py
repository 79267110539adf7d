"""Views in three dimensions: a scene in a browser, in a notebook, in pictures."""
