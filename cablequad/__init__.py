"""The analytic model of n quadrotors under one load on flexible cables, and its control: pure functions of values.

World frame NED, body frames FRD, SI units, symbols of Goodarzi & Lee. No clock, file, socket or message in here.
"""
