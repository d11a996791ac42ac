"""Synthesis: the map from which the reference view predicts all other views best (Sajjadi et al. 2016)."""
