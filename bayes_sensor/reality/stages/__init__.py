"""Stages of the rig, each stepped through time: input at the nodes in, state at the nodes out.

``t`` (n,) s are increasing nodes, unevenly spaced, with a node at every jump of an input.  Between
nodes an input runs in a straight line and a linear stage follows it exactly (exponential
integrator, Hochbruck and Ostermann, Acta Numerica 19, 2010); coupled or bent stages take classical
Runge-Kutta steps inside, as many as stability wants.
"""
