"""The command jaxbody."""
