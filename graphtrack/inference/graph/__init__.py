"""The engines on GTSAM: batch, fixed lag and iSAM2."""
