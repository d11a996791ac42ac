"""Light fields, their geometry and results: what everything else works on. It imports nothing above it."""
