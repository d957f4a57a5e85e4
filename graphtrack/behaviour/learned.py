"""Parameters that were learned."""

from __future__ import annotations

from graphtrack.behaviour.parameters import ConversationWeights, FacingWeights, GroupParameters

DEFAULT = GroupParameters(
    places=ConversationWeights(bias=12.863, shared=0.831, crowd=-3.054, far=-2.781, caution=-0.5),
    bodies=ConversationWeights(bias=9.127, shared=5.338, crowd=-3.536, far=-1.124, rank=-0.307, caution=0.5),
    heads=ConversationWeights(
        bias=8.282, shared=5.03, crowd=-3.32, far=-0.767, rank=-0.506, look=11.482, caution=0.5
    ),
    companions=FacingWeights(at_0=-0.39, at_30=0.901, at_60=1.413, at_90=1.416, at_120=0.747, at_160=-0.098),
    others=FacingWeights(at_0=-0.875, at_30=-0.043, at_60=0.019, at_90=0.107, at_120=0.175, at_160=-0.438),
)
"""By ``graphtrack fit --groups`` from SALSA's rows up to t = 1000 s; see docs/behaviour.md."""
