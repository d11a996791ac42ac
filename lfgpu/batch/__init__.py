"""`lfgpu batch`: many light fields, all of which come out; what runs them is Dask (`cluster.py`, the only one that
imports it), what is done with each is in `work.py`, what became of each in the `manifest.py`.
"""
