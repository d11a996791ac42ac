"""Running a method: on one light field, in tiles, on all views, on streams, as a file for other programs."""
