"""Who is who: detections without identities become tracks."""

from graphtrack.association.detections import Detections
from graphtrack.association.offline import Association, associate_detections
from graphtrack.association.scene import SceneParameters
from graphtrack.association.tracks import associate

__all__ = ["Association", "Detections", "SceneParameters", "associate", "associate_detections"]
