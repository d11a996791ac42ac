"""How long each backend takes on each device, how much memory, and how near it comes to the truth meanwhile."""
