"""Visual cues of a tracked person: motion, colour and shape, each a saliency over the whole frame."""
