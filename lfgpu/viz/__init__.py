"""Visualisation: figures, panels, refocusing, rendering of new views, notebooks."""
