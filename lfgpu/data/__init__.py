"""Light fields, their geometry, and results. Imports no other package of lfgpu above it."""
