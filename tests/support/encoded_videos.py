"""Videos of given images, encoded by PyAV."""

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import av
import numpy as np

_CODECS = {".avi": "mjpeg", ".mpg": "mpeg2video", ".ts": "mpeg2video", ".gif": "gif"}
_FORMATS = {"mjpeg": "yuvj420p", "gif": "rgb8", "ffv1": "bgr0"}


def encoded(
    path: Path,
    images: Sequence[np.ndarray],
    codec: str = "",
    rate: float = 10,
    *,
    options: dict[str, str] | None = None,
    times: Sequence[int] | None = None,
) -> Path:
    """Write images (h, w, 3), at a rate or at times in milliseconds; the codec follows from the suffix."""
    codec = codec or _CODECS.get(path.suffix, "mpeg4")
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=Fraction(rate).limit_denominator(1000))
        stream.height, stream.width = images[0].shape[:2]
        stream.pix_fmt = _FORMATS.get(codec, "yuv420p")
        stream.options = options or {}
        if times is not None:
            stream.codec_context.time_base = Fraction(1, 1000)
        for k, image in enumerate(images):
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format="bgr24")
            if times is not None:
                frame.pts, frame.time_base = times[k], Fraction(1, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path
