"""Reading, checking and writing of images and videos."""
