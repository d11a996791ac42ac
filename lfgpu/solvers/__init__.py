"""Minimisers: settings come in as arguments, state stays inside, the result says in a sentence why it stopped."""
