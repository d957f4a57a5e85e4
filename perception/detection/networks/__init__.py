"""People found by networks of one's own, in ONNX files that OpenCV runs."""
