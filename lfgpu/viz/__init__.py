"""Looking: figures, panels, refocusing, rendering of new views, notebooks."""
