"""lfgpu: depth from 4D light fields by analysis through synthesis."""
