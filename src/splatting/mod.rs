//! Footprints, the sample cache, ageing and warping.
