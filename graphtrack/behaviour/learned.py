"""Parameters that were learned."""

from __future__ import annotations

from graphtrack.behaviour.parameters import ConversationWeights, GroupParameters

DEFAULT = GroupParameters(
    places=ConversationWeights(bias=12.863, shared=0.831, crowd=-3.054, far=-2.781, caution=-0.5),
    bodies=ConversationWeights(bias=9.127, shared=5.338, crowd=-3.536, far=-1.124, rank=-0.307, caution=0.5),
    heads=ConversationWeights(
        bias=8.282, shared=5.03, crowd=-3.32, far=-0.767, rank=-0.506, look=11.482, caution=0.5
    ),
)
"""By ``graphtrack fit --groups`` from SALSA's rows up to t = 1000 s; see docs/behaviour.md."""
