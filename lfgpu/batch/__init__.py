"""`lfgpu batch`: depth for many light fields.

`items.py` finds them, `work.py` estimates one of them, `cluster.py` runs the jobs with Dask (no other module imports
Dask), `manifest.py` records the outcomes, `run.py` puts this together, and `report.py` writes the page.
"""
