"""Work on many inputs in batches, by processes of this machine or by a Dask cluster, with the same bytes as result."""
