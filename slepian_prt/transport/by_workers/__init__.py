"""Transport by the workers of a crew: in blocks as in one process, so that the results are the same."""
