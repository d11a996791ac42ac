"""Reports: what was found, as pages that can be sent and printed, and in notebooks."""
