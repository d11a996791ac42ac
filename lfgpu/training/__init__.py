"""Learning an aggregation from light fields that are generated: scenes, cameras, the network, its training.

Only this room imports PyTorch, and nothing that runs a trained network imports this room.
"""
