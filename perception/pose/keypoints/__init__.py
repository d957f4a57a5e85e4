"""Points of the body that pose networks give, and where body and head point by them."""
