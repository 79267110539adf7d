"""Views: pictures with matplotlib; scenes in a browser, in a notebook, in one HTML file."""
