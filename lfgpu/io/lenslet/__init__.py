"""Raw captures of lenslet cameras as light fields."""
