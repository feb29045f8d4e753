"""Work on many machines by Dask: clusters, what workers must have, values that all share, results as they come."""
