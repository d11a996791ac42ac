"""Visualisation: pictures of maps, sheets, panels, cards, refocusing, rendering of new views."""
