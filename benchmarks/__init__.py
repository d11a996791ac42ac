"""Time, memory and error of every backend on every device."""
