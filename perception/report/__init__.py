"""From a recording to a folder with everything that is found out about its people."""
