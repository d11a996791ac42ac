"""Matching: the surface on which the views agree, with occlusions."""
