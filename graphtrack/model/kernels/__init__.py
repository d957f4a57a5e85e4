"""Compiled twins of the terms: one module beside each, with its cost, gradient and curvature for one frame.

They are what the chain solver adds up. A kernel takes the states of one frame (or of two that follow each
other), adds to the gradient and to the blocks of the Hessian, and returns its cost. ``exact`` chooses the
true second derivative; without it the curvature is one that is never negative, for when a full Newton step
leads nowhere.
"""
