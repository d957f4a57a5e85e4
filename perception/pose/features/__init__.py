"""Features of images: arrays in, arrays out."""
