"""The papers' experiments on pixels, with their own numbers beside ours."""
